"""Rigid bodies whose surface is an exact sphere: they roll, spin and are pressed into others."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.smooth.smooth_patches import SmoothPatches
from dolfinx_nts.search.spheres.sphere_frame import SphereFrame
from helpers.collision import check_balances, collide
from helpers.models.box_meshes import boxes, distribute
from helpers.models.rigid import spin
from helpers.models.round import rings
from helpers.once import once
from helpers.scene import gathered

CENTRE, RADIUS = np.array([0.52, 0.48, 0.805]), 0.3
OMEGA, SPEED = np.array([0.5, -3.0, 2.0]), np.array([0.4, 0.1, -1.5])


def round_off(X, centre):
    """Put the nodes of a cube onto a ball."""
    arms = X - X.mean(axis=0)
    length = np.linalg.norm(arms, axis=1, keepdims=True)
    return centre + RADIUS * arms / np.where(length > 0, length, np.inf)


def scene(
    comm,
    scheme=nts.EnergyMomentum,
    enforcement=None,
    friction=None,
    *,
    dt=0.01,
    guide=None,
    obstacle=None,
    both_rigid=False,
):
    """A ball of eight cells above a block, another ball or an obstacle."""
    data = boxes([(4, 4, 2), (2, 2, 2)], [(1.0, 1.0, 0.5), (1.0, 1.0, 1.0)])
    lower, upper = (np.unique(data.cells[data.body == number]) for number in (0, 1))
    data.X[upper] = round_off(data.X[upper], CENTRE)
    if both_rigid:
        corners = data.X[lower] * [1, 1, 2]
        data.X[lower] = round_off(corners, CENTRE - [0.1, 0.15, 2 * RADIUS - 0.02])
    mesh, cells, facets, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(1e3, 0.3, 10.0))
    if both_rigid:
        block = nts.RigidBody(V, cells, tag["body 0"], 80.0)
    ball = nts.RigidBody(V, cells, tag["body 1"], 50.0, guide)
    nodes = nts.boundary_of(block) if both_rigid else nts.Surface(V, facets, tag["top 0"])
    sphere = nts.boundary_of(ball, smooth=nts.RigidSphere(CENTRE, RADIUS))
    law = enforcement or nts.LagrangeMultiplier()
    pair = nts.ContactPair(nodes, obstacle or sphere, law, friction, method="node-to-segment")
    bcs = []
    if scheme is nts.QuasiStatic:
        foot = fem.locate_dofs_topological(V, 2, facets.find(tag["bottom 0"]))
        bcs = [fem.dirichletbc(np.zeros(3), foot, V)]
    stepper = scheme([block, ball], [pair], dt=dt, bcs=bcs)
    if scheme is not nts.QuasiStatic:
        stepper.set_velocity(ball, spin(OMEGA, CENTRE, SPEED))
    return stepper


SLIDING = nts.Coulomb(0.3)
LAWS = {
    "elastic": {},
    "friction": {"friction": SLIDING},
    "plastic": {"enforcement": nts.LagrangeMultiplier("plastic")},
    "resolved": {"enforcement": nts.LagrangeMultiplier("resolved"), "friction": SLIDING},
    "springs": {"enforcement": nts.Penalty(1e4), "friction": SLIDING},
    "rigid": {"both_rigid": True},
    "restitution": {
        "both_rigid": True,
        "enforcement": nts.LagrangeMultiplier("restitution", e=0.5),
    },
    "springs between rigid": {
        "both_rigid": True,
        "enforcement": nts.Penalty(1e4),
        "friction": SLIDING,
    },
}


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("law", ["elastic", "friction", *(once(x, id=x) for x in [*LAWS][2:])])
def test_ball_strikes_with_exact_energy_and_momenta(comm, law):
    first, last, given, active = collide(scene(comm, **LAWS[law]), 25)
    check_balances(first, last, given)
    assert active > 0
    if law in ("elastic", "rigid"):
        assert abs(given) < 1e-10 * first.total_energy
    if "friction" in LAWS[law] or law == "restitution":
        assert given < -0.01 * first.total_energy


@pytest.mark.serial
def test_a_frictionless_ball_keeps_its_spin():
    """All normals of a sphere pass through its centre, unlike normals of facets."""
    stepper = scene(MPI.COMM_SELF)
    nodes = stepper.bodies[1].nodes

    def spin_of(stepper):
        x, v = stepper.x[nodes], np.array(stepper.v.x.array).reshape(-1, 3)[nodes]
        x, v = x - x.mean(axis=0), v - v.mean(axis=0)
        inertia = np.trace(x.T @ x) * np.eye(3) - x.T @ x
        return np.linalg.solve(inertia, np.cross(x, v).sum(axis=0))

    before = spin_of(stepper)
    *_, active = collide(stepper, 25)
    assert active > 0
    # The mesh has the inertia of a cube, so that there is no precession.
    assert np.abs(spin_of(stepper) - before).max() < 1e-11


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("friction", [once(None, id="frictionless"), SLIDING])
def test_guided_ball_presses_as_an_obstacle_does(comm, agree, friction):
    motion = nts.Motion(lambda t: (max(t - 0.1, 0.0), 0.0, -0.8 * min(t, 0.1)))
    guide, states = nts.Guide(motion=motion), []
    alone = nts.RigidSphere(CENTRE, RADIUS).moving(motion)
    for obstacle in (None, alone):
        stepper = scene(
            comm, nts.QuasiStatic, friction=friction, dt=0.05, guide=guide, obstacle=obstacle
        )
        for _ in range(4):
            report = stepper.advance()
        states.append(stepper.x[stepper.bodies[0].nodes])
    assert report.num_active > 1
    assert agree(np.abs(states[0] - states[1]).max(initial=0.0) < 1e-9)


@pytest.mark.serial
def test_friction_at_the_end_of_a_step_acts_along_the_sphere_there(rng):
    stepper = scene(MPI.COMM_SELF, friction=SLIDING)
    while not stepper.advance().num_active > 3:
        pass
    (contact,) = stepper.contacts
    candidates, X = contact.search.candidates, stepper.x
    node = contact.history.active.nonzero()[0].astype(np.int32)
    points = NodalPoints(contact.nodes.nodes[node])
    segment = candidates.find(contact.history.key[node])
    dofs = points.dofs(candidates.segments[segment])
    travel, turn = rng.normal(size=(2, 3))
    own, ball, t = (
        rng.normal(size=X.shape),
        stepper.bodies[1].nodes,
        rng.normal(size=(len(node), 2)),
    )
    middle = X[ball].mean(axis=0)

    def moved(h):
        """Random displacements of the block's nodes, and a rigid motion of the ball."""
        x, angle = X + h * own, h * np.linalg.norm(turn)
        k = turn / np.linalg.norm(turn)
        arm = X[ball] - middle
        arm = (
            arm * np.cos(angle)
            + np.cross(k, arm) * np.sin(angle)
            + np.outer(arm @ k, k) * (1 - np.cos(angle))
        )
        x[ball] = middle + h * travel + arm
        return candidates.scatter.forward(x)

    def slip(h):
        return candidates.slip("objective", points, moved(0.0), moved(h), segment).at_end()

    def force(h):
        return np.einsum("mi,mid->md", t, slip(h).force)

    h, d = 0.05, 1e-6
    normal = candidates.contact("static", points, moved(0.0), moved(h), segment).force[:, :3]
    assert np.abs(np.einsum("mi,mi->m", force(h)[:, :3], normal)).max() < 1e-12
    np.testing.assert_allclose(np.linalg.norm(force(h)[:, :3], axis=1), np.hypot(*t.T))
    rate = ((moved(h + d) - moved(h - d)) / (2 * d))[dofs].reshape(len(node), -1)
    derivative = np.einsum("mde,me->md", slip(h).tangent(t), rate)
    np.testing.assert_allclose((force(h + d) - force(h - d)) / (2 * d), derivative, atol=1e-6)


@pytest.mark.several_ranks
def test_motion_is_the_same_on_any_number_of_ranks(comm):
    steppers = [scene(on, friction=SLIDING) for on in (comm, MPI.COMM_SELF)]
    for stepper in steppers:
        *_, active = collide(stepper, 12)
        assert active > 0
    places = [gathered(each.u.function_space, each.x) for each in steppers]
    assert np.abs(places[0] - places[1]).max() < 1e-9


@pytest.mark.serial
@pytest.mark.parametrize(
    ("scheme", "dt", "tol"),
    [
        (nts.Midpoint, 0.01, 1e-3),
        (nts.GeneralizedAlpha, 0.01, 0.01),
        (nts.CentralDifference, 0.002, 1e-3),
    ],
)
def test_other_schemes_keep_linear_momentum_and_nearly_the_energy(comm, scheme, dt, tol):
    stepper = scene(comm, scheme, nts.Penalty(1e3), SLIDING, dt=dt)
    first, last, given, active = collide(stepper, round(0.2 / dt))
    energy = last.total_energy - first.total_energy
    assert active > 0 and given < 0
    assert abs(energy - last.contact_energy - given) < tol * first.total_energy
    change = last.linear_momentum - first.linear_momentum
    assert np.linalg.norm(change) < 1e-11 * np.linalg.norm(first.linear_momentum)


@pytest.mark.serial
@pytest.mark.parametrize("friction", [None, SLIDING], ids=["frictionless", "friction"])
def test_disc_of_the_plane_strikes_a_ring(comm, friction):
    lower, upper = rings(comm, rigid=True).bodies
    disc = nts.RigidSphere((0.2, 2.0), 1.0)
    rim = nts.boundary_of(
        upper, where=lambda x: np.hypot(x[0] - 0.2, x[1] - 2.0) > 0.9, smooth=disc
    )
    pair = nts.ContactPair(
        nts.boundary_of(lower),
        rim,
        friction=friction,
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    stepper = nts.EnergyMomentum([lower, upper], [pair], dt=0.01)
    stepper.set_velocity(upper, lambda x: np.array([0.3 + 0 * x[0], -1 + 0 * x[0]]))
    first, last, given, active = collide(stepper, 25)
    check_balances(first, last, given)
    assert active > 0 and (friction is None or given < -1e-4 * first.total_energy)


@pytest.mark.serial
def test_a_resumed_run_is_the_whole_one_and_needs_the_sphere(comm, tmp_path):
    def record(stepper, num_steps):
        with nts.Recorder(tmp_path / "run", stepper, checkpoint_every=2, resume=True) as recorder:
            for step in stepper.run(until=num_steps * stepper.dt):
                recorder.write(step)

    whole, part, rest = (scene(comm, friction=SLIDING) for _ in range(3))
    collide(whole, 10)
    record(part, 6)
    assert part.contacts[0].history.active.any()
    record(rest, 10)
    assert np.array_equal(rest.x, whole.x)
    other = scene(comm, friction=SLIDING, obstacle=nts.RigidSphere(CENTRE, RADIUS))
    with pytest.raises(ValueError, match="pair 1"):
        record(other, 12)


@pytest.mark.at_most_two_ranks
def test_invalid_spheres_of_rigid_bodies_are_refused(comm, refused):
    ball = scene(comm).bodies[1]
    for centre, radius, given in (
        (CENTRE, 0.31, {}),
        (CENTRE + 0.01, RADIUS, {}),
        (CENTRE, RADIUS, {"hollow": True}),
        (CENTRE[:2], RADIUS, {}),
    ):
        with refused(ValueError, "expected (a RigidSphere|facets) of"):
            nts.boundary_of(ball, smooth=nts.RigidSphere(centre, radius, **given))


@pytest.mark.at_most_two_ranks
def test_a_sphere_that_deforms_is_refused(comm, refused):
    data = boxes([(2, 2, 2)], [(1.0, 1.0, 1.0)])
    data.X[:] = round_off(data.X, CENTRE)
    mesh, cells, _, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    soft = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(1e3, 0.3, 10.0))
    sphere = nts.RigidSphere(CENTRE, RADIUS)
    upper, lower = (
        nts.boundary_of(soft, where=lambda x, side=side: side * (x[2] - CENTRE[2]) > 0.1, **shape)
        for side, shape in ((1, {}), (-1, {"smooth": sphere}))
    )
    with refused(ValueError, "as the shape of one RigidBody"):
        nts.EnergyMomentum(
            [soft],
            [
                nts.ContactPair(
                    upper, lower, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
                )
            ],
            dt=0.01,
        )


@pytest.mark.serial
def test_an_overlap_with_a_sphere_is_reported_without_patches(monkeypatch, caplog):
    """A sphere is outside of its facets: nothing that touches it may be inside these."""
    monkeypatch.delattr(SmoothPatches, "of")
    *_, active = collide(scene(MPI.COMM_SELF, enforcement=nts.Penalty(20.0)), 15)
    assert active > 0
    assert any("inside body 0" in message for message in caplog.messages)


def test_another_shape_than_a_sphere_is_refused(refused):
    data = boxes([(1, 1, 1)], [(1.0, 1.0, 1.0)])
    mesh, cells, _, tag = distribute(MPI.COMM_WORLD, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    ball = nts.RigidBody(V, cells, tag["body 0"], 1.0)
    with refused(TypeError, "expected smooth=True, False or a RigidSphere, given 'yes'"):
        nts.boundary_of(ball, smooth="yes")


@pytest.mark.serial
def test_facets_in_a_plane_cannot_carry_a_sphere(refused):
    mesh, _, facets, tag = distribute(MPI.COMM_SELF, boxes([(1, 1, 1)], [(1.0, 1.0, 1.0)]))
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    sphere = nts.RigidSphere((0.5, 0.5, 0.5), np.sqrt(0.75))
    with refused(ValueError, "vertices in more than one plane"):
        SphereFrame(nts.Surface(V, facets, tag["top 0"], smooth=sphere))
