"""Contact pairs that mortar and edge contact support."""

from mpi4py import MPI

import pytest

import dolfinx_nts as nts
from helpers import scenes
from helpers.models import plane

pytestmark = pytest.mark.serial


@pytest.fixture(scope="module")
def surfaces():
    (pair,) = scenes.blocks(MPI.COMM_WORLD).stepper.pairs
    return pair.nodes, pair.segments


def test_unknown_method_is_refused(surfaces):
    known = "'node-to-segment' or 'mortar' or 'edge-to-edge'"
    with pytest.raises(ValueError, match=f"expected method {known}, given"):
        nts.ContactPair(*surfaces, method="segment-to-segment")


def test_friction_by_convective_coordinates_is_refused(surfaces):
    friction = nts.Coulomb(0.3, law="convective")
    with pytest.raises(ValueError, match="friction by the law 'objective', given") as caught:
        nts.ContactPair(*surfaces, nts.Penalty(1.0), friction, "mortar")
    assert "or use method 'node-to-segment'" in str(caught.value)


def test_obstacles_and_a_surface_against_itself_are_refused(surfaces):
    nodes, _ = surfaces
    with pytest.raises(ValueError, match="Surface as segments, given RigidPlane"):
        nts.ContactPair(
            nodes,
            nts.RigidPlane((0, 0, 0), (0, 0, 1)),
            method="mortar",
            enforcement=nts.LagrangeMultiplier(),
        )
    with pytest.raises(ValueError, match="two surfaces, given one"):
        nts.ContactPair(nodes, nodes, method="mortar", enforcement=nts.LagrangeMultiplier())


def test_explicit_integration_is_refused(surfaces):
    scene = scenes.blocks(MPI.COMM_WORLD)
    (pair,) = scene.stepper.pairs
    pair = nts.ContactPair(
        pair.nodes, pair.segments, method="mortar", enforcement=nts.LagrangeMultiplier()
    )
    with pytest.raises(ValueError, match="given 'mortar', which the implicit steppers support"):
        nts.CentralDifference(scene.stepper.bodies, [pair])


def test_text_of_a_pair_has_its_method(surfaces):
    pair = nts.ContactPair(*surfaces, method="mortar")
    assert "method='mortar'" in repr(pair)
    assert str(pair) == "surface-to-surface contact by Penalty"


def test_all_pairs_use_it_between_bodies_only():
    bodies = scenes.blocks(MPI.COMM_WORLD).stepper.bodies
    floor = nts.RigidPlane((0, 0, -1), (0, 0, 1))
    pairs = nts.all_pairs(
        bodies,
        obstacles=[floor],
        self_contact=bodies[:1],
        method="mortar",
        enforcement=nts.LagrangeMultiplier(),
    )
    assert [pair.method for pair in pairs] == ["mortar", "node-to-segment", "node-to-segment"]


@pytest.fixture(scope="module")
def boundaries():
    return [nts.boundary_of(body) for body in scenes.blocks(MPI.COMM_WORLD).stepper.bodies]


LAWS = {
    "impact 'elastic', 'plastic' or 'restitution', given": nts.LagrangeMultiplier("resolved"),
    "LagrangeMultiplier or Penalty as enforcement": nts.Tied(),
}


@pytest.mark.parametrize("message", LAWS)
def test_unsupported_laws_of_edge_contact_are_refused(boundaries, message):
    with pytest.raises(ValueError, match=f"with method 'edge-to-edge', {message}"):
        nts.ContactPair(*boundaries, LAWS[message], method="edge-to-edge")


def test_surfaces_without_sharp_edges_are_refused(surfaces, boundaries):
    with pytest.raises(ValueError, match="convex edges of 30 degrees or more with"):
        nts.ContactPair(*surfaces, method="edge-to-edge")
    floor = nts.RigidPlane((0, 0, 0), (0, 0, 1))
    with pytest.raises(
        ValueError, match="a Surface or a RigidSurface as segments, given RigidPlane"
    ):
        nts.ContactPair(
            boundaries[0], floor, method="edge-to-edge", enforcement=nts.LagrangeMultiplier()
        )
    flat = nts.RigidSurface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], outside=(0, 0, 1))
    with pytest.raises(ValueError, match="given a RigidSurface without any"):
        nts.ContactPair(
            boundaries[0], flat, method="edge-to-edge", enforcement=nts.LagrangeMultiplier()
        )
    flat = nts.RigidSurface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], outside=(0, 0, 1))
    with pytest.raises(ValueError, match="given a RigidSurface without any"):
        nts.ContactPair(
            boundaries[0], flat, method="edge-to-edge", enforcement=nts.LagrangeMultiplier()
        )
    with pytest.raises(ValueError, match="two surfaces, given one"):
        nts.ContactPair(
            boundaries[0],
            boundaries[0],
            method="edge-to-edge",
            enforcement=nts.LagrangeMultiplier(),
        )
    square = plane.blocks()
    with pytest.raises(ValueError, match="edges cross in space only"):
        nts.ContactPair(
            square.nodes,
            square.segments,
            method="edge-to-edge",
            enforcement=nts.LagrangeMultiplier(),
        )
    with pytest.raises(
        ValueError, match="edges=True for bodies in space only, given a mesh of the plane"
    ):
        nts.all_pairs(
            [square.lower, square.upper],
            edges=True,
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )


def test_edges_are_allowed_once_in_addition_to_nodes(boundaries):
    bodies = scenes.blocks(MPI.COMM_WORLD).stepper.bodies
    pairs = nts.all_pairs(
        bodies, edges=True, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    assert [pair.method for pair in pairs] == ["node-to-segment", "edge-to-edge"]
    assert str(pairs[1]) == "edge-to-edge contact by LagrangeMultiplier"
    open_edges = nts.all_pairs(bodies, edges=True)[1]
    assert str(open_edges) == "edge-to-edge contact by the default of the stepper"
    nts.EnergyMomentum(bodies, pairs, dt=0.01)
    with pytest.raises(ValueError, match="expected each pair once"):
        nts.EnergyMomentum(bodies, [*pairs, pairs[1]], dt=0.01)


NOT_SMOOTH = {
    "method 'node-to-segment' or 'mortar', given 'edge-to-edge'": {"method": "edge-to-edge"},
    "friction by the law 'objective', given": {
        "enforcement": nts.Penalty(1.0),
        "friction": nts.Coulomb(0.3, law="convective"),
    },
    "LagrangeMultiplier or Penalty as enforcement, given Tied": {"enforcement": nts.Tied()},
}


@pytest.fixture(scope="module")
def smooth():
    """Bodies, the nodes of the upper one, and the smooth boundary of the lower one."""
    stepper = scenes.blocks(MPI.COMM_WORLD).stepper
    (pair,) = stepper.pairs
    return stepper.bodies, pair.nodes, nts.boundary_of(stepper.bodies[0], smooth=True)


@pytest.mark.parametrize("message", NOT_SMOOTH)
def test_unsupported_laws_of_smooth_segments_are_refused(smooth, message):
    with pytest.raises(ValueError, match=f"with smooth segments, {message}") as caught:
        nts.ContactPair(*smooth[1:], **NOT_SMOOTH[message])
    assert "or use segments without smooth=True" in str(caught.value)


def test_smooth_segments_touch_neither_themselves_nor_in_explicit_steps(smooth):
    bodies, nodes, segments = smooth
    with pytest.raises(ValueError, match="two surfaces, given one that touches itself"):
        nts.ContactPair(
            segments, segments, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        )
    pair = nts.ContactPair(nodes, segments, nts.Penalty(), method="node-to-segment")
    with pytest.raises(ValueError, match="without smooth=True with CentralDifference, given the"):
        nts.CentralDifference(bodies, [pair])
    assert "smooth=True" in repr(segments) and "smooth" not in repr(nodes)


def test_smooth_surfaces_that_touch_each_other_are_asked_for_on_both_sides(smooth):
    _, nodes, segments = smooth
    assert (
        nts.ContactPair(
            segments, nodes, method="mortar", enforcement=nts.LagrangeMultiplier()
        ).nodes
        is segments
    )
    with pytest.raises(ValueError, match="with smooth segments, LagrangeMultiplier or Penalty"):
        nts.ContactPair(segments, nodes, nts.Tied(), method="mortar")
