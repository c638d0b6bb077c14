"""Springs into which nodes sink deep are told once, others are not; bodies do not sink through."""

import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers import scenes


# Explicit steppers look at them every 50 steps.
@pytest.mark.parametrize(
    ("scheme", "dt"),
    [(nts.EnergyMomentum, scenes.BLOCK_STEP), (nts.CentralDifference, scenes.BLOCK_STEP / 50)],
)
@pytest.mark.parametrize(("eps_N", "warns"), [(None, False), (1e-9, True)])
def test_springs_that_do_not_stop_nodes_are_told_once(comm, caplog, scheme, dt, eps_N, warns):
    old = scenes.blocks(comm).stepper
    pair = nts.ContactPair(old.pairs[0].nodes, old.pairs[0].segments, nts.Penalty(eps_N))
    stepper = scheme(old.bodies, [pair], dt=dt)
    for body in old.bodies:
        stepper.set_velocity(body, old.v)
    depth, limit = 0.0, 0.25 * pair.segment_size
    while stepper.t < 10 * scenes.BLOCK_STEP and depth < 1.4 * limit:
        stepper.advance()
        depth = max(depth, comm.allreduce(-pair.gap(stepper.x).min(initial=0.0), op=scenes.MPI.MAX))
    assert (depth > limit) == warns
    told = [text for text in caplog.messages if "let nodes sink in by" in text]
    assert len(told) == (warns and comm.rank == 0)
    text = "take a stiffer Penalty (contact by Penalty, eps_N = 1e-09 N/m) or a LagrangeMultiplier"
    assert all(text in message for message in told)


OBSTACLES = {
    "plane": nts.RigidPlane((0, 0, 0), (0, 0, 1)),
    "sphere": nts.RigidSphere((0, 0, -0.4), 0.4),
    "cylinder": nts.RigidCylinder((0, 0, -0.4), (0, 1, 0), 0.4),
}
WHOLE = "block has sunk into a RigidPlane as a whole"
DEEP = r"(nodes have sunk into a Rigid\w* by 0.20\d m|nodes sank too deep)"


@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.CentralDifference])
@pytest.mark.parametrize("target", OBSTACLES)
def test_bodies_that_sink_through_an_obstacle_end_the_run(comm, refused, scheme, target):
    text = WHOLE if target == "plane" else DEEP

    def fill(model):
        parts.add_box(model, "block", corner=(-0.1, -0.1, 0), size=(0.2,) * 3, cells=(2, 2, 1))

    mesh, cells, _, tag = nts.read_mesh(fill, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, cells, tag["block"], nts.NeoHookean(1e5, 0.3, 1e3))
    pair = nts.ContactPair(nts.boundary_of(block), OBSTACLES[target], nts.Penalty(eps_N=1.0))
    stepper = scheme([block], [pair], dt=2e-3)
    stepper.set_velocity(block, (0.0, 0.0, -2.0))
    with refused(nts.ConvergenceError, f"{text}.*stiffer springs"):
        list(stepper.run(until=0.4))
    # Explicit steppers look at bodies as a whole every 50 steps.
    late = 0.1 if scheme is nts.CentralDifference and target == "plane" else 0.0
    assert 0.09 < stepper.t < 0.11 + late
