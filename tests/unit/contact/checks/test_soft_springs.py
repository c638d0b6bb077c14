"""Deep penetration into soft springs, and passing of an obstacle, are reported once."""

import re

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers import scenes
from helpers.models import box_meshes
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks


@pytest.mark.parametrize(
    ("scheme", "dt"),
    [(nts.EnergyMomentum, scenes.BLOCK_STEP), (nts.CentralDifference, scenes.BLOCK_STEP / 50)],
)
@pytest.mark.parametrize(("eps_N", "warns"), [once(None, False), (1e-9, True)])
def test_springs_that_do_not_stop_nodes_are_reported_once(comm, caplog, scheme, dt, eps_N, warns):
    old = scenes.blocks(comm).stepper
    pair = nts.ContactPair(
        old.pairs[0].nodes, old.pairs[0].segments, nts.Penalty(eps_N), method="node-to-segment"
    )
    stepper = scheme(old.bodies, [pair], dt=dt)
    for body in old.bodies:
        stepper.set_velocity(body, old.v)
    depth, limit = 0.0, 0.25 * pair.segment_size
    while stepper.t < 10 * scenes.BLOCK_STEP and depth < 1.4 * limit:
        stepper.advance()
        depth = max(depth, comm.allreduce(-pair.gap(stepper.x).min(initial=0.0), op=scenes.MPI.MAX))
    assert (depth > limit) == warns
    messages = [text for text in caplog.messages if "are compressed by up to" in text]
    assert len(messages) == (warns and comm.rank == 0)
    text = "use a stiffer Penalty (contact by Penalty, eps_N = 1e-09 N/m) or a LagrangeMultiplier"
    assert all(text in message for message in messages)


def cube(comm, obstacle, eps_N, dt, scheme, is_rigid=True):
    """A cube of 1 m, 1 kg and 2 x 2 x 2 cells that falls on an obstacle."""
    data = box_meshes.boxes([(2, 2, 2)], [(1.0, 1.0, 1.0)])
    data.X[:] += [-0.5, -0.5, 0.01]
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    body = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(1e3, 0.3, 1.0))
    if is_rigid:
        body = nts.RigidBody(V, cells, tag["body 0"], 1.0)
    pair = nts.ContactPair(
        nts.boundary_of(body), obstacle, nts.Penalty(eps_N), method="node-to-segment"
    )
    stepper = scheme([body], [pair], dt=dt)
    stepper.set_velocity(body, (0.0, 0.0, -1.0))
    return stepper


@pytest.mark.serial
def test_explicit_steps_report_a_depth_that_lasts_a_few_steps(comm, caplog):
    # Nine springs of 1 N/m: w = 3/s and a depth of 1/w, for pi/w, in which there are 20 steps.
    plane = nts.RigidPlane((0, 0, 0), (0, 0, 1))
    stepper = cube(comm, plane, 1.0, np.pi / 60, nts.CentralDifference)
    deepest = min(stepper.x[:, 2].min() for _ in stepper.run(until=1.2))
    assert deepest == pytest.approx(-1 / 3, rel=0.01) and stepper.step < 50
    assert np.allclose(stepper.v.x.array.reshape(-1, 3), [0, 0, 1], rtol=0, atol=0.01)
    (message,) = [text for text in caplog.messages if "are compressed by up to" in text]
    assert "body 0 and a RigidPlane" in message


@pytest.mark.serial
@pytest.mark.parametrize("scheme", [nts.CentralDifference, nts.EnergyMomentum])
@pytest.mark.parametrize("is_rigid", [True, False], ids=["rigid", "deformable"])
def test_nodes_do_not_sink_through_a_sphere_by_soft_springs(comm, scheme, is_rigid):
    ball = nts.RigidSphere(centre=(0.1, 0.0, -0.3), radius=0.3)
    stepper = cube(comm, ball, 0.5, 0.004, scheme, is_rigid)
    with pytest.raises(nts.ConvergenceError, match="sank") as error:
        list(stepper.run(1.0, nts.StepControl(smallest=stepper.dt)))
    assert re.search("stiffer springs", str(error.value))
    assert "RigidSphere" in str(error.value) and "eps_N = 0.5 N/m" in str(error.value)
    depth = 0.3 - np.linalg.norm(stepper.x - [0.1, 0.0, -0.3], axis=1).min()
    assert 0.13 < depth <= 0.15


OBSTACLES = {
    "plane": nts.RigidPlane((0, 0, 0), (0, 0, 1)),
    "sphere": nts.RigidSphere((0, 0, -0.4), 0.4),
    "cylinder": nts.RigidCylinder((0, 0, -0.4), (0, 1, 0), 0.4),
}
WHOLE = "block has passed completely into a RigidPlane"
DEEP = "nodes (that sank into a surface|sank too deep)"


@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, once(nts.CentralDifference)])
@pytest.mark.parametrize("target", ["plane", once("sphere"), "cylinder"])
def test_bodies_that_sink_through_an_obstacle_end_the_run(comm, refused, scheme, target):
    text = WHOLE if target == "plane" else DEEP

    def fill(model):
        parts.add_box(model, "block", corner=(-0.1, -0.1, 0), size=(0.2,) * 3, cells=(2, 2, 1))

    mesh, cells, _, tag = nts.read_mesh(fill, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, cells, tag["block"], nts.NeoHookean(1e5, 0.3, 1e3))
    pair = nts.ContactPair(
        nts.boundary_of(block), OBSTACLES[target], nts.Penalty(eps_N=1.0), method="node-to-segment"
    )
    stepper = scheme([block], [pair], dt=2e-3)
    stepper.set_velocity(block, (0.0, 0.0, -2.0))
    with refused(nts.ConvergenceError, f"{text}.*stiffer springs"):
        list(stepper.run(until=0.4))
    # Explicit steppers check bodies as a whole every 50 steps.
    late = 0.1 if scheme is nts.CentralDifference and target == "plane" else 0.0
    assert 0.09 < stepper.t < 0.11 + late
