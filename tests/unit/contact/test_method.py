"""Which contact pairs the mortar method can do."""

from mpi4py import MPI

import pytest

import dolfinx_nts as nts
from helpers import scenes

pytestmark = pytest.mark.serial


@pytest.fixture(scope="module")
def surfaces():
    (pair,) = scenes.blocks(MPI.COMM_WORLD).stepper.pairs
    return pair.nodes, pair.segments


def test_unknown_method_is_refused(surfaces):
    with pytest.raises(ValueError, match="expected method 'node-to-segment' or 'mortar', given"):
        nts.ContactPair(*surfaces, method="segment-to-segment")


def test_friction_by_convective_coordinates_is_refused(surfaces):
    friction = nts.Coulomb(0.3, law="convective")
    with pytest.raises(ValueError, match="friction by the law 'objective', given") as caught:
        nts.ContactPair(*surfaces, nts.Penalty(1.0), friction, "mortar")
    assert "method 'node-to-segment' can do this" in str(caught.value)


def test_obstacles_and_a_surface_against_itself_are_refused(surfaces):
    nodes, _ = surfaces
    with pytest.raises(ValueError, match="Surface as segments, given RigidPlane"):
        nts.ContactPair(nodes, nts.RigidPlane((0, 0, 0), (0, 0, 1)), method="mortar")
    with pytest.raises(ValueError, match="two surfaces, given one"):
        nts.ContactPair(nodes, nodes, method="mortar")


def test_explicit_integration_is_refused(surfaces):
    scene = scenes.blocks(MPI.COMM_WORLD)
    (pair,) = scene.stepper.pairs
    pair = nts.ContactPair(pair.nodes, pair.segments, method="mortar")
    with pytest.raises(ValueError, match="given 'mortar', which the implicit steppers can do"):
        nts.CentralDifference(scene.stepper.bodies, [pair])


def test_printed_pair_tells_its_method(surfaces):
    pair = nts.ContactPair(*surfaces, method="mortar")
    assert "method='mortar'" in repr(pair)
    assert str(pair) == "surface-to-surface contact by LagrangeMultiplier"


def test_all_pairs_use_it_between_bodies_only():
    bodies = scenes.blocks(MPI.COMM_WORLD).stepper.bodies
    floor = nts.RigidPlane((0, 0, -1), (0, 0, 1))
    pairs = nts.all_pairs(bodies, obstacles=[floor], self_contact=bodies[:1], method="mortar")
    assert [pair.method for pair in pairs] == ["mortar", "node-to-segment", "node-to-segment"]
