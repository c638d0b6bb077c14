"""Gradients of forces of supports and of contact."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from helpers.gradients import ADJOINT, ALONG, boxes, check, impact, pressed
from helpers.models import plane, rings
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

NODES, MORTAR = {"method": "node-to-segment"}, {"method": "mortar"}
STICKY = {"friction": nts.Coulomb(0.3)}
FLOOR = {"obstacle": nts.RigidPlane((0.0, 0.0, 0.4), (0.0, 0.0, 1.0))}


def curved(t, *forces):
    """Function of all components of forces."""
    return sum((1 + t) * (f[2] - 3.0) ** 2 + f[0] * ufl.sqrt(1 + f[1] ** 2) for f in forces)


def held(comm, scheme, *, exchanged=False, **contact):
    """Stepper of a clamped box and of one that moves as a whole, with controls and last time."""
    shapes, sizes = [(3, 3, 1), (2, 2, 2)], [(1.2, 1.2, 0.4), (0.6, 0.6, 0.5)]
    V, facets, tag, bodies, moduli = boxes(comm, shapes, sizes)
    sides = [nts.Surface(V, facets, tag[name]) for name in ("bottom 1", "top 0")]
    sides = sides[::-1] if exchanged else sides
    pair = nts.ContactPair(*sides, enforcement=nts.Penalty(), **contact)
    floor = fem.locate_dofs_geometrical(V, lambda X: np.isclose(X[2], 0.0))
    control, motion = (fem.Constant(V.mesh, np.array([0.02, 0.01, -0.12])) for _ in range(2))
    dt = 0.25 if scheme is nts.QuasiStatic else 0.01

    def update(t):
        motion.value[:] = t / (4 * dt) * control.value

    moved = fem.dirichletbc(motion, bodies[1].nodes, V)
    bcs = [fem.dirichletbc(np.zeros(3), floor, V), moved]
    stepper = scheme(bodies, [pair], dt=dt, bcs=bcs, update=update)
    return stepper, [control, *moduli], 4 * dt


@pytest.mark.parametrize(
    ("kind", "contact"),
    [
        ("scaled", NODES),
        ("scaled", {**MORTAR, **STICKY, "to": ALONG}),
        once("constant", MORTAR),
        once("part", NODES),
        once("scaled", {**NODES, **STICKY, "to": ALONG}),
        once("scaled", {**NODES, "degree": 2}),
    ],
)
def test_derivatives_of_forces_in_equilibrium(comm, rng, kind, contact):
    stepper, controls, _, until = pressed(comm, nts.QuasiStatic, kind, **contact)
    forces = [*stepper.supports.conditions[:2], stepper.pairs[0].nodes]
    gradient = nts.Gradient(stepper, controls, curved, until=until, forces=forces)
    direction = 0.01 * rng.standard_normal(gradient.controls.size)
    direction[-2:] = 200.0, -300.0
    has_adjoint = contact["method"] != "mortar" and "friction" not in contact
    check(gradient, direction, exact=ADJOINT if has_adjoint else 1e-8)


@pytest.mark.parametrize(
    ("scheme", "contact"),
    [
        (nts.EnergyMomentum, NODES),
        (nts.GeneralizedAlpha, FLOOR),
        (nts.EnergyMomentum, {**MORTAR, **STICKY}),
        once(nts.EnergyMomentum, FLOOR),
        once(nts.Midpoint, NODES),
        once(nts.GeneralizedAlpha, MORTAR),
        once(nts.GeneralizedAlpha, {**NODES, **STICKY}),
    ],
)
def test_derivatives_of_forces_in_an_impact(comm, scheme, contact):
    stepper, controls, _, until = impact(comm, scheme, **contact)
    has_adjoint = contact is NODES or contact is FLOOR
    if has_adjoint:
        controls = [*controls, stepper.v]
    forces = [stepper.supports.conditions[0], stepper.bodies[1]]
    gradient = nts.Gradient(stepper, controls, curved, until=until, forces=forces)
    velocity = np.tile([0.1, 0.1, -0.2], (gradient.controls.size - 2) // 3)
    direction = np.array([200.0, -300.0, *velocity])
    check(gradient, direction, exact=ADJOINT if has_adjoint else 1e-8)


@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, once(nts.GeneralizedAlpha)])
@pytest.mark.parametrize(
    ("contact", "exchanged"), [(NODES, False), (MORTAR, True), once(NODES, True)]
)
def test_derivatives_of_forces_on_a_body_with_a_prescribed_motion(comm, scheme, contact, exchanged):
    stepper, controls, until = held(comm, scheme, exchanged=exchanged, **contact)
    forces = [*stepper.supports.conditions, stepper.bodies[1]]
    gradient = nts.Gradient(stepper, controls, curved, until=until, forces=forces)
    direction = np.array([-0.02, 0.01, 0.02, 20.0, -30.0])
    check(gradient, direction, exact=ADJOINT if contact is NODES else 1e-8)


@pytest.mark.parametrize("exchanged", [False, True])
def test_forces_on_a_body_without_inertia_are_in_balance(comm, exchanged):
    stepper, (_, mu, _), until = held(comm, nts.QuasiStatic, exchanged=exchanged, **NODES)
    forces = [*stepper.supports.conditions, stepper.bodies[1]]
    objectives = (
        lambda t, floor, tool, contact: contact[2] + tool[2],
        lambda t, floor, tool, contact: floor[2] + tool[2],
        lambda t, floor, tool, contact: floor[2],
    )
    gradients = [nts.Gradient(stepper, [mu], J, until=until, forces=forces) for J in objectives]
    values = np.array([(each.value(), each.gradient()[0]) for each in gradients])
    assert np.abs(values[2]).min() > 0.01
    assert np.abs(values[:2] / values[2]).max() < 1e-9


@pytest.mark.serial
@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
def test_derivatives_of_forces_in_a_body_of_revolution(comm, method):
    scene = rings.ball_on_plate(size=0.2)
    pairs = scene.pairs(method=method, enforcement=nts.Penalty())
    depth = fem.Constant(scene.V.mesh, -0.03)
    middle = fem.locate_dofs_geometrical(scene.V, lambda x: x[1] > 0.9 * rings.R)
    below = fem.locate_dofs_geometrical(scene.V, lambda x: np.isclose(x[1], -rings.HEIGHT))
    moved = fem.dirichletbc(depth, 2 * middle + 1, scene.V.sub(1))
    bcs = [moved, fem.dirichletbc(np.zeros(2), below, scene.V)]
    stepper = nts.QuasiStatic(scene.bodies, pairs, dt=1.0, bcs=bcs)
    forces = [*bcs, scene.ball]
    gradient = nts.Gradient(
        *(stepper, [depth], lambda t, *f: sum(each[0] ** 2 for each in f)),
        until=1.0,
        forces=forces,
    )
    check(gradient, np.array([0.02]), exact=1e-8)
    assert gradient.value() > 1.0


@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
def test_derivatives_of_forces_in_the_plane(comm, method):
    scene = plane.blocks(angle=0.3)
    pair = nts.ContactPair(scene.nodes, scene.segments, nts.Penalty(), method=method)
    motion = fem.Constant(scene.V.mesh, scene.turn @ np.array([0.01, -0.05]))
    ends = [lambda x, y=y: np.isclose((scene.turn.T @ x[:2])[1], y) for y in (1.02, -0.5)]
    top, bottom = (fem.locate_dofs_geometrical(scene.V, end) for end in ends)
    bcs = [fem.dirichletbc(motion, top, scene.V), fem.dirichletbc(np.zeros(2), bottom, scene.V)]
    stepper = nts.QuasiStatic([scene.lower, scene.upper], [pair], dt=1.0, bcs=bcs)
    gradient = nts.Gradient(
        *(stepper, [motion], lambda t, *f: sum(each[0] * each[1] for each in f)),
        until=1.0,
        forces=[*bcs, scene.nodes],
    )
    check(gradient, np.array([0.01, 0.02]), exact=1e-8)


@pytest.mark.parametrize("method", [NODES, MORTAR], ids=["nodes", "mortar"])
def test_forces_are_those_of_reports_and_diagnostics(comm, agree, method):
    scheme, found = nts.QuasiStatic, []

    def record(t, *forces):
        found.append([force.value.copy() for force in forces])
        return forces[0][0]

    stepper, controls, _, until = pressed(comm, scheme, **method)
    forces = [*stepper.supports.conditions, stepper.pairs[0].nodes]
    nts.Gradient(stepper, controls, record, until=until, forces=forces).value()
    other, _, _, until = pressed(comm, scheme, **method)
    steps = list(zip(other.run(until), found, strict=True))
    for step, (held, moved, _) in steps:
        assert agree(np.array_equal([held, moved], [r.force for r in step.reactions]))
    contact = nts.Diagnostics(other).contact_force()
    assert agree(np.allclose(found[-1][2], contact, rtol=1e-12, atol=1e-10))


@pytest.mark.several_ranks
@pytest.mark.parametrize("method", [NODES, MORTAR], ids=["nodes", "mortar"])
def test_gradients_of_forces_do_not_depend_on_the_ranks(comm, agree, method):
    several, alone = (
        nts.Gradient(
            *(stepper, controls, curved),
            until=0.5,
            forces=[*stepper.supports.conditions, stepper.bodies[0]],
        )
        for stepper, controls, *_ in (
            pressed(each, nts.QuasiStatic, "scaled", **method) for each in (comm, MPI.COMM_SELF)
        )
    )
    assert agree(np.isclose(several.value(), alone.value(), rtol=1e-9, atol=0))
    assert agree(np.allclose(several.gradient(), alone.gradient(), rtol=1e-7, atol=0))


@pytest.mark.parametrize("stored_steps", [None, once(2)])
def test_forces_in_functionals_and_scalars_with_controls(comm, stored_steps):
    """The objective has controls in scalars, and products of forces with fields."""
    stepper, (_, mu, kappa), _, until = pressed(comm, nts.QuasiStatic, **NODES)
    u, dx = stepper.u, ufl.dx

    def mixed(t, force):
        if t < 0.3:
            return None
        if t < 0.6:
            return ufl.sqrt(ufl.inner(force, force)) * mu + kappa**2
        return force[2] ** 2 * (u[2] + mu * ufl.inner(u, u)) * dx

    gradient = nts.Gradient(
        *(stepper, [mu, kappa], mixed),
        until=until,
        forces=[stepper.supports.conditions[1]],
        stored_steps=stored_steps,
    )
    check(gradient, np.array([200.0, -300.0]))


def test_wrong_forces_are_refused(comm, refused):
    stepper, controls, J, until = pressed(comm, nts.QuasiStatic, **NODES)
    moved = stepper.supports.conditions[1]

    def gradient(objective, *forces):
        return nts.Gradient(stepper, controls, objective, until=until, forces=forces)

    with refused(TypeError, "expected as objective with forces a function of the time"):
        gradient(J, moved)
    with refused(TypeError, "expected in forces a condition of bcs, or a Surface"):
        gradient(curved, stepper.pairs[0])
    V = stepper.u.function_space
    with refused(ValueError, "conditions of bcs of the stepper, given one not in bcs"):
        gradient(curved, fem.dirichletbc(np.zeros(3), np.arange(2, dtype=np.int32), V))
    far = nts.Surface.where(V, lambda X: np.isclose(X[2], 0.0))
    with refused(ValueError, "surfaces or bodies with contact in the stepper"):
        gradient(curved, far)
    with refused(ValueError, r"a scalar of forces and Constants, given one of shape \(3,\):"):
        gradient(lambda t, force: force, moved).value()
    with refused(ValueError, r"a scalar of forces and Constants, .* shape \(\) with Function"):
        gradient(lambda t, force: force[0] * stepper.u[0], moved).value()
    with refused(TypeError, "return a form, a scalar of the forces or None"):
        gradient(lambda t, force: float(force.value[0]), moved).value()
