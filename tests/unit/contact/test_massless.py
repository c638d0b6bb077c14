"""Contact pairs in which impact can be resolved."""

from functools import partial

from mpi4py import MPI

import pytest

import dolfinx_nts as nts
from helpers import scenes

RESOLVED = nts.LagrangeMultiplier("resolved")
blocks = partial(scenes.blocks, enforcement=RESOLVED, layers=2)

pytestmark = pytest.mark.serial


def with_pairs(*changes, scheme=nts.EnergyMomentum):
    """Make a stepper whose pairs are replaced by the results of functions."""

    def make(bodies, pairs, dt):
        return scheme(
            bodies, [change(pair) for pair, change in zip(pairs, changes, strict=True)], dt=dt
        )

    return make


@pytest.mark.parametrize("scheme", [nts.GeneralizedAlpha, nts.Midpoint, nts.QuasiStatic])
def test_other_schemes_are_refused(scheme):
    with pytest.raises(ValueError, match="expected EnergyMomentum with impact 'resolved', given"):
        blocks(MPI.COMM_WORLD, scheme)


def test_springs_of_friction_are_refused():
    words = "expected, with impact 'resolved', friction without springs, given Coulomb"
    with pytest.raises(ValueError, match=words) as caught:
        blocks(MPI.COMM_WORLD, friction=nts.Coulomb(0.3, eps_T=1e3))
    assert "or use impact 'elastic'" in str(caught.value)


def test_self_contact_is_refused():
    def own(pair):
        return nts.ContactPair(pair.nodes, pair.nodes, RESOLVED, method="node-to-segment")

    with pytest.raises(ValueError, match="two surfaces, given one that touches itself"):
        scenes.blocks(MPI.COMM_WORLD, with_pairs(own), layers=2)


def test_nodes_without_mass_have_no_other_contact():
    def opposite(pair):
        return nts.ContactPair(pair.segments, pair.nodes, RESOLVED, method="node-to-segment")

    def both(bodies, pairs, dt):
        return nts.EnergyMomentum(bodies, [pairs[0], opposite(pairs[0])], dt=dt)

    with pytest.raises(ValueError, match="in no other contact, given 16 nodes of surface 2"):
        blocks(MPI.COMM_WORLD, both)


TWO_LAYERS = "expected two layers of nodes below a surface"


def test_bodies_with_one_layer_of_cells_are_refused():
    with pytest.raises(ValueError, match=TWO_LAYERS):
        scenes.blocks(MPI.COMM_WORLD, enforcement=RESOLVED, layers=1)


def test_one_layer_of_cells_of_degree_two_touches_on_one_side_only():
    scenes.blocks(MPI.COMM_WORLD, enforcement=RESOLVED, layers=1, degree=2)

    def all_around(bodies, pairs, dt):
        plane = nts.RigidPlane((0, 0, -9), (0, 0, 1))
        pair = nts.ContactPair(
            nts.boundary_of(bodies[1]), plane, RESOLVED, method="node-to-segment"
        )
        return nts.EnergyMomentum(bodies, [pair], dt=dt)

    with pytest.raises(ValueError, match=TWO_LAYERS):
        scenes.blocks(MPI.COMM_WORLD, all_around, layers=1, degree=2)
