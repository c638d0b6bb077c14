"""Gradients of runs: Taylor remainders, differences of runs, adjoint and tangent-linear steps."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.contact.implicit.mortar.frozen_points import FrozenPoints
from helpers.gradients import ADJOINT, DIFFERENCES, boxes, check, impact
from helpers.models import box_meshes
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

NODES, MORTAR = {"method": "node-to-segment"}, {"method": "mortar"}


def layers(comm, *, gap=0.0, dt=0.01, **contact):
    """A flat box above a clamped one that is wider, with its gap, without conditions on the top.

    Returns the stepper, the bodies, the moduli and the factor by which the upper box swells, at
    first 0.
    """
    data = box_meshes.boxes([(2, 2, 1), (2, 2, 2)], [(1.2, 1.2, 0.4), (0.6, 0.6, 0.5)])
    data.X[np.unique(data.cells[data.body == 1])] += np.array([0.23, 0.31, 0.4 + gap])
    mesh, cells, facets, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    mu, stretch = fem.Constant(mesh, 500.0), fem.Constant(mesh, 0.0)

    def material(stretch):
        def psi(C):
            J2 = ufl.det(C / stretch**2)
            return mu / 2 * (ufl.tr(C / stretch**2) - 3 - ufl.ln(J2)) + 100.0 * ufl.ln(J2) ** 2

        return nts.Hyperelastic(psi, rho=10.0, one_point=())

    bodies = [
        nts.Body(V, cells, tag[name], material(factor))
        for name, factor in (("body 0", 1.0), ("body 1", 1 + stretch))
    ]
    below, above = (nts.Surface(V, facets, tag[name]) for name in ("top 0", "bottom 1"))
    floor = fem.locate_dofs_geometrical(V, lambda X: np.isclose(X[2], 0.0))
    bcs = [fem.dirichletbc(np.zeros(3), floor, V)]
    pair = nts.ContactPair(above, below, **contact)
    stepper = nts.EnergyMomentum(bodies, [pair], dt=dt, bcs=bcs)
    return stepper, bodies, mu, stretch


def tension(comm, scheme):
    """Gradient of a clamped box under gravity with respect to all kinds of controls."""
    V, _, _, (body,), (mu, kappa) = boxes(comm, [(2, 2, 2)], [(1.0, 0.8, 0.6)])
    gravity = fem.Constant(V.mesh, (1.0, 2.0, -9.81))
    weight = nts.FormLoad(V, lambda u, eta, t: ufl.inner(gravity, eta) * ufl.dx)
    floor = fem.locate_dofs_geometrical(V, lambda X: np.isclose(X[2], 0.0))
    bcs = [fem.dirichletbc(np.zeros(3), floor, V)]
    stepper = scheme([body], dt=0.01, bcs=bcs, loads=[weight])
    u, v = stepper.u, stepper.v
    J = ufl.inner(u, u) * ufl.dx + 0.01 * ufl.inner(v, v) * ufl.dx + 1e-6 * mu**2 * ufl.dx
    controls = [mu, kappa, gravity]
    if scheme is not nts.QuasiStatic:
        stepper.set_velocity(body, lambda X: 0.5 * X[2] * np.array([X[1], X[0] * X[2], 1 + X[0]]))
        controls += [u, v]
    return stepper, controls, J


@pytest.mark.parametrize(
    "scheme",
    [nts.EnergyMomentum, nts.GeneralizedAlpha, once(nts.Midpoint), once(nts.QuasiStatic)],
)
def test_derivatives_without_contact(comm, rng, scheme):
    stepper, controls, J = tension(comm, scheme)
    gradient = nts.Gradient(stepper, controls, J, until=0.04)
    x = gradient.controls
    check(gradient, rng.standard_normal(x.size) * np.where(np.abs(x) > 1, np.abs(x), 0.1))


@pytest.mark.parametrize(
    ("scheme", "contact"),
    [
        (nts.EnergyMomentum, {"enforcement": nts.Penalty(2e3), **NODES}),
        (nts.EnergyMomentum, {**NODES}),
        (nts.EnergyMomentum, {**MORTAR}),
        once(nts.EnergyMomentum, {"friction": nts.Coulomb(0.3), **NODES}),
        once(nts.EnergyMomentum, {"friction": nts.Coulomb(0.3), **MORTAR}),
        once(nts.Midpoint, {"enforcement": nts.Penalty(2e3), **NODES}),
        (nts.GeneralizedAlpha, {**NODES}),
        once(nts.GeneralizedAlpha, {**MORTAR}),
        once(nts.GeneralizedAlpha, {"friction": nts.Coulomb(0.3), **NODES}),
        once(nts.EnergyMomentum, {"degree": 2, "enforcement": nts.Penalty(2e3), **NODES}),
        once(nts.EnergyMomentum, {"degree": 2, "steps": 6, **MORTAR}),
        once(nts.EnergyMomentum, {"obstacle": nts.RigidPlane((0.0, 0.0, 0.4), (0.1, 0.05, 1.0))}),
    ],
)
def test_derivatives_through_contact_with_respect_to_the_material(comm, scheme, contact):
    stepper, controls, J, until = impact(comm, scheme, **contact)
    gradient = nts.Gradient(stepper, controls, J, until=until)
    # Without an adjoint the directions are differentiated one by one, to the error of differences.
    has_adjoint = contact.get("method") != "mortar" and "friction" not in contact
    check(gradient, np.array([200.0, -300.0]), exact=ADJOINT if has_adjoint else 1e-8)


@pytest.mark.parametrize("method", [NODES, MORTAR], ids=["nodes", "mortar"])
def test_derivatives_through_small_slip(comm, method):
    """The upper box swells, and nodes slide by less than a thousandth of a facet in a step."""
    stepper, (_, upper), mu, stretch = layers(comm, friction=nts.Coulomb(0.1), **method)
    stepper.set_velocity(upper, (0.02, 0.01, -0.1))
    stretch.value = 1e-3
    slides = []

    def objective(t):
        history = stepper.contacts[0].history
        slides.append(comm.allreduce(int((history.active & history.sliding).sum())))
        return ufl.inner(stepper.u, stepper.u) * ufl.dx if t > 0.095 else None

    gradient = nts.Gradient(stepper, [mu, stretch], objective, until=0.1)
    x = gradient.controls
    slopes = gradient.gradient(x)
    assert np.count_nonzero(slides) >= 5
    for slope, h in zip(slopes, np.diag(1e-5 * x), strict=True):
        difference = gradient.value(x + h) - gradient.value(x - h)
        assert np.isclose(difference, 2 * slope * h.sum(), rtol=DIFFERENCES, atol=0)


@pytest.mark.parametrize("method", [NODES, MORTAR], ids=["nodes", "mortar"])
def test_derivatives_if_the_gap_closes_at_the_end_of_a_step(comm, method):
    """Round-off decides whether the nodes touch in the first step or in the second one."""

    def slopes(gap):
        friction = nts.Coulomb(0.1)
        stepper, (_, upper), mu, stretch = layers(comm, gap=gap, friction=friction, **method)
        stepper.set_velocity(upper, (0.0, 0.0, -1.0))
        stretch.value = 1e-12
        moment = ufl.inner(stepper.u, stepper.u) * ufl.dx
        return nts.Gradient(stepper, [mu], moment, until=0.05).gradient()

    closes, nearly = slopes(0.01), slopes(0.01 * (1 + 1e-5))
    assert np.allclose(closes, nearly, rtol=1e-3, atol=0)


@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.GeneralizedAlpha])
def test_derivatives_through_contact_with_respect_to_the_initial_state(comm, rng, scheme):
    stepper, _, J, until = impact(comm, scheme, enforcement=nts.Penalty(2e3), **NODES)
    gradient = nts.Gradient(stepper, [stepper.u, stepper.v], J, until=until)
    direction = rng.standard_normal(gradient.controls.size)
    direction[: len(direction) // 2] *= 0.01
    check(gradient, 0.1 * direction)


def test_derivatives_of_the_acceleration_of_a_first_step(comm):
    """It depends on loads and stress at the start; the objective contains the last one."""
    data = box_meshes.boxes([(2, 2, 2)], [(1.0, 0.8, 0.6)])
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    force, mu = (fem.Constant(mesh, value) for value in (30.0, 500.0))

    def psi(C):
        J2 = ufl.det(C)
        return mu / 2 * (ufl.tr(C) - 3 - ufl.ln(J2)) + 100.0 * ufl.ln(J2) ** 2

    soft = nts.Body(V, cells, tag["body 0"], nts.Hyperelastic(psi, rho=10.0, one_point=()))
    pull = nts.FormLoad(V, lambda u, eta, t: (1 + t) * force * eta[0] * ufl.dx)
    floor = fem.locate_dofs_geometrical(V, lambda X: np.isclose(X[2], 0.0))
    bcs = [fem.dirichletbc(np.zeros(3), floor, V)]
    stepper = nts.GeneralizedAlpha([soft], dt=0.01, bcs=bcs, loads=[pull])
    stepper.set_displacement(soft, lambda X: 0.1 * X[2] * np.array([X[1], X[0], X[2]]))
    J = ufl.inner(stepper.a, stepper.a) * ufl.dx
    gradient = nts.Gradient(stepper, [force, mu, stepper.u], J, until=0.03)
    direction = np.full(gradient.controls.size, 0.01)
    direction[:2] = 5.0, 100.0
    check(gradient, direction)


def test_springs_with_force_at_the_start_of_generalized_alpha_are_refused(comm, refused):
    stepper, controls, J, until = impact(comm, nts.GeneralizedAlpha, **NODES)
    stepper.set_displacement(stepper.bodies[1], (0.0, 0.0, -0.06))
    gradient = nts.Gradient(stepper, controls, J, until=until)
    with refused(ValueError, "expected open contact at the start of a run"):
        gradient.value()


def test_energy_and_momentum_after_an_impact_do_not_depend_on_the_material(comm):
    """The body has left the other one, so that springs have no energy."""
    stepper, (mu, kappa), _, until = impact(
        comm, steps=30, clamped=False, enforcement=nts.Penalty(2e3), **NODES
    )
    F = ufl.Identity(3) + ufl.grad(stepper.u)
    J2 = ufl.det(F) ** 2
    psi = mu / 2 * (ufl.tr(F.T * F) - 3 - ufl.ln(J2)) + kappa / 8 * ufl.ln(J2) ** 2
    v, dx = stepper.v, ufl.Measure("dx", metadata={"quadrature_degree": 2})
    stored, kinetic = psi * dx, 5.0 * ufl.inner(v, v) * dx
    objectives = kinetic, stored + kinetic, 10.0 * v[2] * dx, 10.0 * v[0] * dx
    gradients = [nts.Gradient(stepper, [mu], each, until=until) for each in objectives]
    of_kinetic, *of_conserved = (gradient.gradient()[0] for gradient in gradients)
    assert not comm.allreduce(stepper.contacts[0].history.active.sum())
    assert abs(of_kinetic) > 0 and np.abs(of_conserved).max() < 1e-9 * abs(of_kinetic)


@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, once(nts.GeneralizedAlpha)])
def test_gradient_with_few_stored_steps_is_the_same(comm, scheme):
    stepper, controls, J, until = impact(comm, scheme, enforcement=nts.Penalty(2e3), **NODES)
    both = [nts.Gradient(stepper, controls, J, until=until, stored_steps=n) for n in (None, 3)]
    every, few = (gradient.gradient() for gradient in both)
    assert np.abs(every).min() > 0 and np.allclose(every, few, rtol=ADJOINT, atol=0)


def test_sum_of_functionals_at_the_ends_of_steps(comm):
    stepper, controls, J, until = impact(comm, enforcement=nts.Penalty(2e3), **NODES)
    ends = [nts.Gradient(stepper, controls, J, until=t) for t in (0.04, until)]
    both = nts.Gradient(
        stepper, controls, lambda t: J if np.isclose(t, [0.04, until]).any() else None, until=until
    )
    each = [gradient.gradient() for gradient in ends]
    assert np.allclose(both.gradient(), np.sum(each, axis=0), rtol=1e-9, atol=0)


@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, once(nts.GeneralizedAlpha)])
def test_gradient_in_the_middle_of_a_run(comm, scheme):
    stepper, controls, J, until = impact(comm, scheme, enforcement=nts.Penalty(2e3), **NODES)
    for _ in stepper.run(until=0.04):
        pass
    check(nts.Gradient(stepper, controls, J, until=until), np.array([200.0, -300.0]))


@pytest.mark.several_ranks
@pytest.mark.parametrize("method", [NODES, MORTAR], ids=["nodes", "mortar"])
def test_gradient_does_not_depend_on_the_ranks(comm, agree, method):
    several, alone = (
        nts.Gradient(*impact(each, enforcement=nts.Penalty(2e3), **method)[:3], until=0.08)
        for each in (comm, MPI.COMM_SELF)
    )
    assert agree(np.allclose(several.gradient(), alone.gradient(), rtol=1e-8, atol=0))


def test_parts_without_derivatives_are_refused(comm, refused):
    stepper, controls, J, until = impact(comm, **NODES)
    with refused(TypeError, "expected as control a fem.Constant"):
        nts.Gradient(stepper, [1.0], J, until=until)
    with refused(ValueError, "at least one control"):
        nts.Gradient(stepper, [], J, until=until)
    unused = fem.Constant(stepper.u.function_space.mesh, 1.0)
    with refused(ValueError, "occurs in none"):
        nts.Gradient(stepper, [unused], J, until=until)
    with refused(ValueError, "expected the end of the run after"):
        nts.Gradient(stepper, controls, J, until=0.0)
    with refused(TypeError, "expected as objective"):
        nts.Gradient(stepper, controls, 1.0, until=until)
    with refused(TypeError, "expected an implicit stepper"):
        nts.Gradient(nts.CentralDifference(stepper.bodies, dt=1e-4), controls, J, until=until)
    stepper, controls, J, until = impact(comm, enforcement=nts.LagrangeMultiplier(), **NODES)
    with refused(ValueError, "expected contact by springs"):
        nts.Gradient(stepper, controls, J, until=until)


def test_steps_that_choose_contact_points_again_are_refused_in_the_run(comm, refused, monkeypatch):
    stepper, controls, J, until = impact(comm, **MORTAR)
    gradient = nts.Gradient(stepper, controls, J, until=until)
    value = gradient.value()

    def is_due(points, x, near, converged):
        return converged and points._renewals == 0

    with monkeypatch.context() as patch:
        patch.setattr(FrozenPoints, "_is_due", is_due)
        with refused(ValueError, "contact points are chosen once"):
            gradient.value(1.01 * gradient.controls)
    assert gradient.value(gradient.controls / 1.01) == pytest.approx(value, rel=1e-12)


def test_many_controls_through_mortar_contact_are_refused(comm, refused):
    stepper, _, J, until = impact(comm, steps=3, **MORTAR)
    gradient = nts.Gradient(stepper, [stepper.v], J, until=until)
    with refused(ValueError, "at most 50 controls"):
        gradient.gradient()
    assert np.isfinite(gradient.derivative(np.ones(gradient.controls.size)))
