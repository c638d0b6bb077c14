"""Default laws and methods of contact pairs, by schemes and surfaces."""

from mpi4py import MPI

import pytest

import dolfinx_nts as nts
from helpers import scenes
from helpers.models import rigid

pytestmark = pytest.mark.serial

FLOOR = nts.RigidPlane((0, 0, -0.1), (0, 0, 1))
SPRINGS, MULTIPLIERS = nts.Penalty, nts.LagrangeMultiplier


@pytest.fixture(scope="module")
def scene():
    return scenes.blocks(MPI.COMM_WORLD)


@pytest.fixture(scope="module")
def surfaces(scene):
    (pair,) = scene.stepper.pairs
    return pair.nodes, pair.segments


def used(scheme, scene, pair, **options):
    """Law and method of a pair in a stepper."""
    options.setdefault("dt", 0.01)
    (own,) = scheme(scene.stepper.bodies, [pair], **options).pairs
    return type(own.enforcement), own.method


def test_two_surfaces_have_springs_by_mortar_with_inertia_and_multipliers_in_statics(
    scene, surfaces
):
    pair = nts.ContactPair(*surfaces)
    assert (type(pair.enforcement), pair.method) == (SPRINGS, "mortar")
    for scheme in (nts.EnergyMomentum, nts.Midpoint, nts.GeneralizedAlpha):
        assert used(scheme, scene, pair) == (SPRINGS, "mortar")
    assert used(nts.QuasiStatic, scene, pair) == (MULTIPLIERS, "mortar")
    assert used(nts.CentralDifference, scene, pair, dt=None) == (SPRINGS, "node-to-segment")


@pytest.mark.parametrize(
    "laws",
    [
        {"enforcement": nts.LagrangeMultiplier("plastic"), "method": "node-to-segment"},
        {"enforcement": nts.Penalty(10.0), "method": "mortar"},
    ],
    ids=["multipliers", "springs"],
)
def test_given_laws_are_kept(scene, surfaces, laws):
    pair = nts.ContactPair(*surfaces, **laws)
    for scheme in (nts.EnergyMomentum, nts.QuasiStatic):
        (own,) = scheme(scene.stepper.bodies, [pair], dt=0.01).pairs
        assert own is pair
        assert (own.enforcement, own.method) == (laws["enforcement"], laws["method"])


def test_law_or_method_alone_may_be_given(scene, surfaces):
    pair = nts.ContactPair(*surfaces, method="node-to-segment")
    assert used(nts.EnergyMomentum, scene, pair) == (SPRINGS, "node-to-segment")
    assert used(nts.QuasiStatic, scene, pair) == (MULTIPLIERS, "node-to-segment")
    pair = nts.ContactPair(*surfaces, nts.LagrangeMultiplier())
    assert used(nts.EnergyMomentum, scene, pair) == (MULTIPLIERS, "mortar")


def test_unsupported_mortar_pairs_default_to_node_to_segment(scene, surfaces, refused):
    nodes, segments = surfaces
    for pair in (
        nts.ContactPair(nodes, FLOOR),
        nts.ContactPair(nodes, nodes),
        nts.ContactPair(nodes, segments, nts.Tied()),
        nts.ContactPair(nodes, segments, friction=nts.Coulomb(0.3, law="convective")),
        nts.ContactPair(nodes, nts.boundary_of(scene.stepper.bodies[0], smooth=True)),
    ):
        assert pair.method == "node-to-segment"
    assert used(nts.EnergyMomentum, scene, nts.ContactPair(nodes, FLOOR))[0] is SPRINGS
    rubbed = nts.ContactPair(nodes, segments, friction=nts.Coulomb(0.3, law="convective"))
    assert used(nts.Midpoint, scene, rubbed)[0] is SPRINGS
    with refused(ValueError, "Midpoint with convective friction, given QuasiStatic"):
        nts.QuasiStatic(scene.stepper.bodies, [rubbed], dt=1.0)


def test_nodes_of_rigid_bodies_and_edges_have_springs():
    scene = rigid.impact(MPI.COMM_WORLD)
    soft, hard = (nts.boundary_of(body) for body in scene.stepper.bodies)
    pairs = nts.ContactPair(hard, soft), nts.ContactPair(soft, hard)
    edges = nts.ContactPair(soft, hard, method="edge-to-edge")
    found = [used(nts.EnergyMomentum, scene, pair) for pair in (*pairs, edges)]
    assert found == [
        (SPRINGS, "node-to-segment"),
        (SPRINGS, "mortar"),
        (SPRINGS, "edge-to-edge"),
    ]


def test_what_was_chosen_is_logged(scene, surfaces, caplog):
    caplog.set_level("INFO", "dolfinx_nts")
    used(nts.EnergyMomentum, scene, nts.ContactPair(*surfaces))
    used(nts.CentralDifference, scene, nts.ContactPair(*surfaces), dt=None)
    used(nts.QuasiStatic, scene, nts.ContactPair(*surfaces, nts.Penalty(1.0), None, "mortar"))
    chosen = [record.message for record in caplog.records if "none was given" in record.message]
    assert [message.split(": ")[1] for message in chosen] == [
        "surface-to-surface contact by Penalty",
        "contact by Penalty",
    ]


def test_a_pair_without_laws_is_read_as_it_was_declared(scene, surfaces):
    """Its pressures, its conditions and its two steppers are those of the declaration."""
    pair = nts.ContactPair(*surfaces)
    stepper = nts.EnergyMomentum(scene.stepper.bodies, [pair], dt=0.02)
    for body in scene.stepper.bodies:
        stepper.set_velocity(body, scene.stepper.v)
    (*_, last) = stepper.run(until=[1.0, nts.ContactForce(pair, at_least=1e-6)])
    assert last.t < 1.0
    assert pair.pressure.max() > 0
    assert "Penalty" in str(pair)
    static = nts.QuasiStatic(scene.stepper.bodies, [pair], dt=1.0)
    assert type(static.pairs[0].enforcement) is MULTIPLIERS
    with pytest.raises(ValueError, match="given one of 2"):
        assert pair.pressure is None
