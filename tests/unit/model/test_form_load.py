"""Loads by forms of the user: against the built-in ones and closed forms."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models.boxed import CLOSED, RHO, SIZE, SOLVED, VOLUME, Box, Ledger, swirl
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

cells_ = pytest.mark.parametrize("cell", ["hexahedron", once("tetrahedron")])
schemes = pytest.mark.parametrize("scheme", [nts.EnergyMomentum, once(nts.Midpoint)])


@cells_
@schemes
def test_a_source_term_is_a_body_force(comm, cell, scheme):
    box, f = Box(comm, cell), np.array([2.0, -1.0, 4.0])
    source = ufl.inner(fem.Constant(box.mesh, f), ufl.TestFunction(box.V)) * ufl.dx
    positions = []
    for load in (nts.FormLoad(box.V, source), nts.BodyForce(box.body, f)):
        stepper = scheme([box.body], dt=0.05, loads=[load])
        stepper.set_velocity(box.body, swirl)
        ledger = Ledger(stepper)
        ledger.run(4)
        assert ledger.error <= CLOSED
        positions.append(box.positions(stepper))
    np.testing.assert_allclose(*positions, rtol=0, atol=SOLVED)


@cells_
@schemes
def test_the_energy_of_springs_and_body_is_constant(comm, cell, scheme):
    # Springs k u on the floor have the energy k/2 int |u|^2. It is quadratic, so the force in the
    # middle of a step does exactly the work of its change.
    box, k = Box(comm, cell), 300.0
    ds = ufl.Measure("ds", subdomain_data=box.facets, subdomain_id=box.tag["bottom 0"])
    load = nts.FormLoad(box.V, lambda u, eta, t: -k * ufl.inner(u, eta) * ds)
    stepper = scheme([box.body], dt=0.02, loads=[load])
    stepper.set_velocity(box.body, swirl)
    ledger = Ledger(stepper)
    ledger.run(10)
    stored = fem.assemble_scalar(fem.form(k / 2 * ufl.inner(stepper.u, stepper.u) * ds))
    stored = comm.allreduce(stored)
    assert stored > 0.01 * ledger.scale
    assert abs(ledger.total("load_work") + stored) <= SOLVED * ledger.scale
    assert ledger.error <= CLOSED


@cells_
def test_a_follower_load_has_its_tangent(comm, cell):
    # The pressure of the package, written by hand; at the end of a step both
    # are the same form.
    box, p = Box(comm, cell), 40.0
    top = box.surface("top 0")
    ds = ufl.Measure("ds", subdomain_data=box.facets, subdomain_id=box.tag["top 0"])
    N = ufl.FacetNormal(box.mesh)

    def work(u, eta, t):
        F = ufl.Identity(3) + ufl.grad(u)
        return -p * t * ufl.inner(ufl.cofac(F) * N, eta) * ds(degree=2)

    positions, iterations = [], []
    for load in (nts.FormLoad(box.V, work), nts.Pressure(top, lambda t: p * t)):
        clamped = fem.dirichletbc(np.zeros(3), box.dofs(2), box.V)
        stepper = nts.QuasiStatic([box.body], dt=0.5, loads=[load], bcs=[clamped])
        iterations.append([stepper.advance().newton_iterations for _ in range(2)])
        positions.append(box.positions(stepper))
    np.testing.assert_allclose(*positions, rtol=0, atol=SOLVED)
    assert iterations[0] == iterations[1]
    depth = SIZE[2] - positions[0][:, 2].max()
    assert depth > 0.01  # there is a load


@pytest.mark.serial
def test_time_is_that_in_the_middle_of_a_step(comm):
    # Linear in time, for which the middle is exact.
    box, b = Box(comm), np.array([2.0, -1.0, 4.0])

    def work(u, eta, t):
        return t * ufl.inner(ufl.as_vector(b.tolist()), eta) * ufl.dx

    stepper = nts.EnergyMomentum([box.body], dt=0.05, loads=[nts.FormLoad(box.V, work)])
    ledger = Ledger(stepper)
    ledger.run(6)
    np.testing.assert_allclose(
        ledger.diagnostics.linear_momentum(), VOLUME * b * 0.3**2 / 2, atol=SOLVED
    )


@pytest.mark.serial
def test_constants_are_set_between_steps(comm):
    box = Box(comm)
    f = fem.Constant(box.mesh, np.zeros(3))
    load = nts.FormLoad(box.V, ufl.inner(f, ufl.TestFunction(box.V)) * ufl.dx)

    def update(t):
        f.value[:] = (0, 0, 10.0 if t < 0.15 else 0.0)

    stepper = nts.EnergyMomentum([box.body], dt=0.1, loads=[load], update=update)
    for _ in range(3):
        stepper.advance()
    p = nts.Diagnostics(stepper).linear_momentum()
    np.testing.assert_allclose(p, (0, 0, 10.0 * VOLUME * 0.1), atol=SOLVED)


def test_explicit_steps_take_forms_too(comm):
    box, g = Box(comm), np.array([0.5, -1.0, -9.81])

    def work(u, eta, t):
        return RHO * ufl.inner(ufl.as_vector(g.tolist()), eta) * ufl.dx

    stepper = nts.CentralDifference([box.body], loads=[nts.FormLoad(box.V, work)])
    ledger = Ledger(stepper)
    ledger.run(5)
    weight = RHO * VOLUME * g
    np.testing.assert_allclose(
        ledger.diagnostics.linear_momentum(), weight * stepper.t, atol=SOLVED
    )
    fall = g * stepper.t**2 / 2
    assert ledger.total("load_work") == pytest.approx(weight @ fall, rel=SOLVED)


def test_wrong_forms_are_refused(comm, refused):
    box, other = Box(comm), Box(comm)
    eta, du = ufl.TestFunction(box.V), ufl.TrialFunction(box.V)
    one = fem.Constant(box.mesh, 1.0)
    with refused(TypeError, "expected a form of virtual work, given float"):
        nts.FormLoad(box.V, 3.0)
    with refused(TypeError, "expected a form of virtual work, given Indexed"):
        nts.FormLoad(box.V, lambda u, eta, t: eta[0])
    with refused(ValueError, "given one with 0 arguments"):
        nts.FormLoad(box.V, one * ufl.dx)
    with refused(ValueError, "given one with 2 arguments"):
        nts.FormLoad(box.V, ufl.inner(eta, du) * ufl.dx)
    with refused(ValueError, "expected a form linear in the test function of the bodies' space"):
        nts.FormLoad(other.V, eta[0] * ufl.dx)


@pytest.mark.parametrize(
    "factor",
    [
        lambda t: math.sin(t),
        lambda t: math.sin(2 * t),
        lambda t: np.sin(t),
        lambda t: np.interp(t, [0.0, 1.0], [0.0, 1.0]),
        lambda t: float(t.value),
        lambda t: min(t, 1.0),
        lambda t: 1.0 if t > 1 else 2.0,
    ],
    ids=["math", "product", "numpy", "interp", "value", "min", "if"],
)
@pytest.mark.serial
def test_a_load_by_the_number_of_the_time_is_refused(comm, factor):
    # It would keep its value at the first time for ever.
    box = Box(comm, "hexahedron")
    with pytest.raises((TypeError, ValueError), match="a virtual work is a UFL expression"):
        nts.FormLoad(box.V, lambda u, eta, t: factor(t) * eta[0] * ufl.dx)


@pytest.mark.serial
def test_a_function_of_other_arguments_is_refused(comm):
    box = Box(comm, "hexahedron")
    with pytest.raises(TypeError, match=r"work\(u, eta, t\), too many positional arguments"):
        nts.FormLoad(box.V, lambda u, eta: eta[0] * ufl.dx)
