"""Moving obstacles: work, force and torque, and the same scenes in the frame of the tool."""

import logging

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers.once import once
from helpers.scene import gathered
from reference.bulk import rotation

# Tolerance of ledger and momenta, relative to the work and impulse of the tool.
BALANCE = 1e-10
# Between two runs that differ by Newton's method only, relative to a size of about one.
SAME = 1e-9
RUBBER = nts.NeoHookean(E=1e5, nu=0.3, rho=1e3)


class Block:
    """A block below z = 0, 1 m wide and 0.5 m high."""

    def __init__(self, comm, cells=(4, 4, 2)):
        """Make the mesh, the body and its surface."""

        def build(model):
            parts.add_box(model, "block", corner=(-0.5, -0.5, -0.5), size=(1, 1, 0.5), cells=cells)

        mesh, tags, facets, tag = nts.read_mesh(build, comm)
        self.comm, self.V = comm, fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        self.body = nts.Body(self.V, tags, tag["block"], RUBBER)
        self.rigid = nts.RigidBody(self.V, tags, tag["block"], RUBBER.rho)
        self.skin = nts.boundary_of(self.body)
        self.top = nts.Surface(self.V, facets, tag["block_top"])

    def stepper(self, obstacle, *laws, scheme=nts.EnergyMomentum, dt=0.01, surface=None, **options):
        laws = laws or (nts.LagrangeMultiplier(),)
        pair = nts.ContactPair(self.skin if surface is None else surface, obstacle, *laws)
        return scheme([self.body], [pair], dt=dt, **options)

    def bottom(self, moved):
        """Displacement of the bottom, and a function that sets it to that by a map of points."""
        u = fem.Function(self.V)
        dofs = fem.locate_dofs_geometrical(self.V, lambda x: np.isclose(x[2], -0.5))

        def update(t):
            u.interpolate(lambda x: moved(t, x.T).T - x)

        return [fem.dirichletbc(u, dofs)], update


VELOCITY, SPIN = np.array([0.3, 0.1, -0.5]), np.array([2.0, 3.0, 1.0])


def pressed(obstacle):
    """Obstacle that comes down, is dragged along and turns about its centre."""
    centre = 0.05, 0.02, 0.51
    return obstacle.moving(nts.Motion(lambda t: t * VELOCITY, lambda t: t * SPIN, centre))


BALL = nts.RigidSphere((0.05, 0.02, 0.51), 0.5)
CORNERS = np.array([[-2, -2, 0.01], [2, -2, 0.01], [-2, 2, 0.01], [2, 2, 0.02]])
TILE = nts.RigidSurface(CORNERS, [[0, 1, 2, 3]], outside=(0, 0, -5))
SPRINGS, RUBS = nts.Penalty(eps_N=1e5), nts.Coulomb(mu=0.3)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("obstacle", "laws"),
    [
        once(BALL, (None, RUBS)),
        (TILE, (nts.LagrangeMultiplier("plastic"), RUBS)),
        once(nts.RigidPlane((0, 0, 0.01), (0, 0, -1)), (SPRINGS, RUBS)),
    ],
    ids=["elastic", "plastic", "springs"],
)
def test_work_and_impulses_of_the_tool_balance_energy_and_momenta(comm, obstacle, laws):
    block = Block(comm)
    stepper = block.stepper(pressed(obstacle), *laws, surface=block.top)
    diagnostics = nts.Diagnostics(stepper)
    first = diagnostics.balance()
    work, reported, lost, impulses, touched = 0.0, 0.0, 0.0, np.zeros((2, 3)), 0
    for step in stepper.run(until=0.2):
        (on,) = diagnostics.obstacles().values()
        force, torque = on.force, on.torque
        centre = np.array([0.05, 0.02, 0.51]) + (step.t - step.dt / 2) * VELOCITY
        impulses += step.dt * np.array([force, torque + np.cross(centre, force)])
        # About a fixed axis the torque does its work on twice the tangent of half the angle.
        rate = np.linalg.norm(SPIN)
        work -= step.dt * force @ VELOCITY + torque @ SPIN / rate * 2 * np.tan(rate * step.dt / 2)
        contact = step.contact_work
        reported += contact.obstacles
        lost += sum(contact) - contact.obstacles - contact.springs
        touched += step.num_active > 0
    last = diagnostics.balance()
    assert touched > 3 and work > 10
    assert abs(reported - work) < BALANCE * work
    assert abs(last.total_energy - first.total_energy - work - lost) < BALANCE * work
    for name, impulse in zip(("linear_momentum", "angular_momentum"), impulses, strict=True):
        gained = getattr(last, name) - getattr(first, name)
        np.testing.assert_allclose(gained, -impulse, atol=BALANCE * np.linalg.norm(impulses))


@pytest.mark.serial
@pytest.mark.parametrize(
    ("scheme", "laws", "dt"),
    [
        (nts.EnergyMomentum, (nts.LagrangeMultiplier("resolved"),), 0.01),
        (nts.GeneralizedAlpha, (SPRINGS, RUBS), 0.01),
        (nts.CentralDifference, (SPRINGS, RUBS), None),
        (nts.QuasiStatic, (None, RUBS), 0.01),
    ],
    ids=["resolved", "alpha", "explicit", "static"],
)
def test_the_table_accounts_for_the_tool_in_other_schemes(comm, scheme, laws, dt, tmp_path):
    block, path = Block(comm), comm.bcast(tmp_path) / "run"
    held = {"bcs": block.bottom(lambda t, x: x)[0]}
    stepper = block.stepper(pressed(BALL), *laws, scheme=scheme, dt=dt, surface=block.top, **held)
    with nts.Recorder(path, stepper) as record:
        for step in stepper.run(until=0.12):
            record.write(step)
    if comm.rank == 0:
        rows = np.genfromtxt(path.with_suffix(".csv"), delimiter=",", names=True)
        work = rows["energy_obstacles"][-1]
        assert work > 1 and rows["external_work"][-1] == work
        assert np.abs(rows["energy_unaccounted"]).max() < BALANCE * work
        # The energy error of the scheme is small compared to the work of the tool.
        assert rows["total_energy"][-1] - rows["total_energy"][0] == pytest.approx(
            work - rows["friction_dissipation"][-1], rel=0.2
        )
        assert rows["obstacle_moving_rigid_sphere_force_z"][-1] == pytest.approx(
            -rows["contact_force_z"][-1]
        )


def test_moving_wall_is_equivalent_to_moving_body(comm):
    wall = nts.RigidPlane((0, 0, 0.08), (0.1, 0.05, -1))

    def positions(comm, obstacle, velocity):
        block = Block(comm, cells=(2, 2, 1))
        stepper = block.stepper(obstacle, None, RUBS)
        stepper.set_velocity(block.body, velocity)
        assert max(report.num_active for report in stepper.run(until=0.3)) > 1
        return gathered(block.V, stepper.x)

    coming = positions(comm, wall.moving(nts.Motion(lambda t: t * VELOCITY)), np.zeros(3))
    # All ranks together compute the same as each rank alone.
    going = positions(MPI.COMM_SELF, wall, -VELOCITY)
    np.testing.assert_allclose(coming, going + 0.3 * VELOCITY, atol=SAME)


def tool(t):
    """Rotation and shift of a tool that is pressed in, tilted and dragged."""
    return rotation([1, 2, 3], 0.4 * t), np.array([0.1 * t, 0.05 * t, -0.4 * t])


@pytest.mark.serial
@pytest.mark.parametrize("obstacle", [BALL, TILE], ids=["ball", "tile"])
def test_moving_tool_is_equivalent_to_moving_body(comm, obstacle):
    block, other = Block(comm), Block(comm)
    turning = nts.Motion(lambda t: tool(t)[1], lambda t: tool(t)[0])
    options = {"scheme": nts.QuasiStatic, "dt": 0.05}
    bcs, _ = block.bottom(lambda t, x: x)
    stepper = block.stepper(obstacle.moving(turning), surface=block.top, bcs=bcs, **options)
    # In the frame of the tool the bottom makes the inverse motion.
    bcs, update = other.bottom(lambda t, x: (x - tool(t)[1]) @ tool(t)[0])
    seen = other.stepper(obstacle, surface=other.top, bcs=bcs, update=update, **options)
    works = []
    for step, reverse in zip(stepper.run(until=0.25), seen.run(until=0.25), strict=True):
        R, shift = tool(step.t)
        np.testing.assert_allclose(seen.x @ R.T + shift, stepper.x, atol=SAME)
        force = next(iter(nts.Diagnostics(stepper).obstacles().values())).force
        at_rest = next(iter(nts.Diagnostics(seen).obstacles().values())).force
        scale = np.linalg.norm(force)
        np.testing.assert_allclose(R @ at_rest, force, atol=1e-7 * scale)
        works.append((step.contact_work.obstacles, reverse.support_work))
    # Forces at the end of a step do their work with an error of the order of the step.
    assert step.num_active > 3 and sum(w for w, _ in works) > 1
    assert sum(w for w, _ in works) == pytest.approx(sum(w for _, w in works), rel=0.05)


@pytest.mark.at_most_two_ranks
def test_gaps_refer_to_the_current_position_of_the_tool(comm):
    block = Block(comm, cells=(1, 1, 1))
    floor = nts.RigidPlane((0, 0, -1), (0, 0, 1))
    moving = floor.moving(nts.Motion(lambda t: (0, 0, t), lambda t: (t, 0, 0), (0, 0, -1)))
    stepper = block.stepper(moving)
    for _ in range(2):
        stepper.advance()
    normal = rotation([1, 0, 0], 0.02) @ [0, 0, 1]
    gap = (stepper.x[block.skin.nodes] - [0, 0, -1 + 0.02]) @ normal
    np.testing.assert_allclose(stepper.pairs[0].gap(stepper.x), gap, atol=1e-14)
    least = comm.allreduce(gap.min(initial=np.inf), op=MPI.MIN)
    assert nts.Diagnostics(stepper).min_gap() == pytest.approx(least)


def drum(radius, num_facets):
    """A faceted drum along y that touches z = 0 from above with the middle of a facet."""
    angle = 2 * np.pi * (np.arange(num_facets) - 0.5) / num_facets
    round_ = radius / np.cos(np.pi / num_facets) * np.array([np.sin(angle), -np.cos(angle)])
    ends = [
        np.stack([round_[0], np.full(num_facets, y), radius + round_[1]], axis=1) for y in (-2, 2)
    ]
    first = np.arange(num_facets)
    second = np.roll(first, -1)
    facets = np.stack([first, second, num_facets + first, num_facets + second], axis=1)
    points = np.concatenate(ends)
    axis = np.array([0, 0, radius])
    return nts.RigidSurface(points, facets, outside=3 * points[facets].mean(axis=1) - 2 * axis)


def pressed_and_turned(comm, tool, degrees):
    """Block below a tool that comes down by 0.03 m in a step of statics, and turns in the next."""
    motion = nts.Motion(
        lambda t: (0, 0, -0.03 * min(t, 1.0)),
        lambda t: (0, np.radians(degrees) * max(t - 1, 0.0), 0),
        centre=(0, 0, 1),
    )
    block = Block(comm, cells=(8, 2, 4))
    bcs, update = block.bottom(lambda t, X: X)
    how = {"scheme": nts.QuasiStatic, "dt": 1.0, "bcs": bcs, "update": update}
    stepper = block.stepper(tool.moving(motion), surface=block.top, **how)
    for _ in range(3):
        assert stepper.advance().num_active > 0
    return block, stepper


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("tool", "degrees"),
    [
        (nts.RigidSphere((0, 0, 1), 1.0), 80),
        once(nts.RigidCylinder((0, 0, 1), (0, 1, 0), 1.0), 45),
    ],
    ids=["sphere", "cylinder"],
)
def test_a_round_tool_with_a_large_rotation_presses_as_one_at_rest(comm, tool, degrees):
    ends = [pressed_and_turned(comm, tool, turn)[1].u.x.array for turn in (0, degrees)]
    assert abs(ends[1] - ends[0]).max(initial=0.0) < SAME


@pytest.mark.at_most_two_ranks
def test_a_faceted_drum_with_a_large_rotation_passes_no_node(comm):
    """Heights over the planes of all facets, which are where they were after turns by three."""
    block, stepper = pressed_and_turned(comm, drum(1.0, 24), 45)
    angle = 2 * np.pi * np.arange(24) / 24
    normals = np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=1)
    x = stepper.x[block.top.nodes] - [0, 0, 0.97]
    assert (x @ normals.T - 1).max(axis=1).min(initial=1.0) > -SAME


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(
    ("scheme", "spin", "reason"),
    [
        (nts.EnergyMomentum, 0.0, "have turned by more than 90 degrees"),
        (nts.CentralDifference, 0.0, "pass through a surface that they face: .*; a dt of "),
        once(nts.CentralDifference, 170.0, "pass through a surface that they face: .*; a dt of "),
    ],
)
def test_a_tool_that_would_go_through_nodes_in_a_step_is_caught(
    comm, refused, scheme, spin, reason, agree
):
    # The node at the middle of the top would be in the ball, behind its centre.
    motion = nts.Motion(lambda t: (0, 0, -100 * t), lambda t: (0, spin * t, 0), (0, 0, 0.25))
    ball = nts.RigidSphere((0, 0, 0.25), 0.2).moving(motion)
    stepper = Block(comm).stepper(ball, SPRINGS, scheme=scheme, dt=0.0044)
    with refused(nts.ConvergenceError, reason):
        stepper.advance()
    assert agree(stepper.t == 0 and not stepper.u.x.array.any())
    step = next(iter(stepper.run(0.0044, nts.StepControl())))
    assert step.rejected > 0 and stepper.t < 0.0044


@pytest.mark.at_most_two_ranks
def test_a_tool_that_turns_too_far_cuts_the_step(comm, refused):
    drum = nts.RigidCylinder((0, 0, 0), (0, 1, 0), 3.0, hollow=True)
    stepper = Block(comm, cells=(1, 1, 1)).stepper(
        drum.moving(nts.Motion(rotation=lambda t: (0, 200 * t, 0)))
    )
    with refused(nts.ConvergenceError, r"moving RigidCylinder rotates by 115 degrees in it, more"):
        stepper.advance()
    step = next(iter(stepper.run(0.01, nts.StepControl())))
    assert step.rejected == 1 and stepper.t == pytest.approx(0.005)


@pytest.mark.at_most_two_ranks
def test_a_motion_that_fails_on_one_rank_fails_on_all_and_leaves_the_state(comm, refused):
    def shift(t):
        return (0.0, 0.0, np.nan if t > 0.015 and comm.rank == comm.size - 1 else 0.0)

    floor = nts.RigidPlane((0, 0, -1), (0, 0, 1)).moving(nts.Motion(shift))
    block = Block(comm, cells=(1, 1, 1))
    stepper = block.stepper(floor)
    stepper.advance()
    with refused(ValueError, r"three finite numbers for a translation at t = 0.02, given \(0.0"):
        stepper.advance()
    assert stepper.step == 1 and stepper.t == 0.01
    inside = floor.moving(nts.Motion(lambda t: (0, 0, 0.6 - t)))
    with refused(ValueError, r"outside of obstacles, given 4 nodes .* 0.1 inside a moving Rigid"):
        block.stepper(inside).advance()


@pytest.mark.at_most_two_ranks
def test_overlap_of_a_tool_with_a_body_without_pair_is_reported(comm, caplog):
    block = Block(comm)
    below = nts.boundary_of(block.body, where=lambda x: x[2] < -0.49)
    ball = nts.RigidSphere((0, 0, 0.21), 0.2).moving(nts.Motion(lambda t: (0, 0, -t)))
    stepper = block.stepper(ball, surface=below)
    caplog.set_level(logging.WARNING, "dolfinx_nts")
    assert not any(step.num_active for step in stepper.run(until=0.2))
    texts = [r.getMessage() for r in caplog.records if r.module == "overlap_watch"]
    (text,) = comm.bcast(texts)
    assert "block is up to 0.1" in text and "inside RigidSphere" in text
    (overlap,) = nts.Diagnostics(stepper).overlaps()
    assert overlap.depth == pytest.approx(0.19, abs=1e-12)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("speed", [once(0.0), 0.5])
@pytest.mark.parametrize("angle", [once(0.0), -np.pi / 2])
def test_obstacle_that_has_turned_returns_e_times_the_speed(comm, speed, angle):
    # A plane, declared vertical or horizontal, that is horizontal below a rigid block.
    normal = rotation([0, 1, 0], angle).T @ [0, 0, 1]
    plane = nts.RigidPlane(-0.52 * normal, normal).moving(
        nts.Motion(translation=lambda t: (0, 0, speed * t), rotation=lambda t: (0, angle, 0))
    )
    block = Block(comm, cells=(1, 1, 1))
    pair = nts.ContactPair(
        block.skin, plane, nts.LagrangeMultiplier("restitution", e=0.4), method="node-to-segment"
    )
    stepper = nts.EnergyMomentum([block.rigid], [pair], dt=0.01)
    stepper.set_velocity(block.rigid, (0.1, 0.0, speed - 1.0))
    for _ in range(5):
        stepper.advance()
    v = stepper.v.x.array.reshape(-1, 3)
    assert np.abs(v - [0.1, 0.0, speed + 0.4]).max(initial=0.0) < 1e-11
