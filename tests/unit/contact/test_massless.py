"""In which contact pairs impact can be resolved."""

from functools import partial

from mpi4py import MPI

import pytest

import dolfinx_nts as nts
from helpers import scenes

RESOLVED = nts.LagrangeMultiplier("resolved")
blocks = partial(scenes.blocks, enforcement=RESOLVED, layers=2)

pytestmark = pytest.mark.serial


def with_pairs(*changes, scheme=nts.EnergyMomentum):
    """Make a stepper whose pairs are replaced by what functions make of them."""

    def make(bodies, pairs, dt):
        return scheme(
            bodies, [change(pair) for pair, change in zip(pairs, changes, strict=True)], dt=dt
        )

    return make


@pytest.mark.parametrize("scheme", [nts.Midpoint, nts.QuasiStatic])
def test_other_schemes_are_refused(scheme):
    with pytest.raises(ValueError, match="expected EnergyMomentum with impact 'resolved', given"):
        blocks(MPI.COMM_WORLD, scheme)


def test_generalized_alpha_is_refused():
    with pytest.raises(ValueError, match=r"given LagrangeMultiplier\(impact='resolved'\)"):
        blocks(MPI.COMM_WORLD, nts.GeneralizedAlpha)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"friction": nts.Coulomb(0.3, eps_T=1e3)}, "friction without springs, given Coulomb"),
        ({"degree": 2}, "elements of degree 1, given degree 2"),
    ],
)
def test_springs_of_friction_and_degree_two_are_refused(options, words):
    with pytest.raises(ValueError, match=f"expected, with impact 'resolved', {words}") as caught:
        blocks(MPI.COMM_WORLD, **options)
    assert "impact 'elastic' can do this" in str(caught.value)


def test_self_contact_is_refused():
    def own(pair):
        return nts.ContactPair(pair.nodes, pair.nodes, RESOLVED)

    with pytest.raises(ValueError, match="two surfaces, given one that touches itself"):
        scenes.blocks(MPI.COMM_WORLD, with_pairs(own), layers=2)


def test_nodes_without_mass_have_no_other_contact():
    def opposite(pair):
        return nts.ContactPair(pair.segments, pair.nodes, RESOLVED)

    def both(bodies, pairs, dt):
        return nts.EnergyMomentum(bodies, [pairs[0], opposite(pairs[0])], dt=dt)

    with pytest.raises(
        ValueError, match="only as nodes of such pairs, given 16 nodes of surface 2"
    ):
        blocks(MPI.COMM_WORLD, both)


def test_bodies_with_one_layer_of_cells_are_refused():
    with pytest.raises(ValueError, match="expected two layers of nodes below a surface"):
        scenes.blocks(MPI.COMM_WORLD, enforcement=RESOLVED, layers=1)
