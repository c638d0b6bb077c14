"""Mass and stiffness damping: decay, ledger and momenta."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models import box_meshes
from helpers.models.boxed import CLOSED, RHO, SOLVED, VOLUME, Box, Ledger, check_loss, swirl
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

# Each case has kernels of its own, which take most of its time.
schemes = pytest.mark.parametrize(
    ("scheme", "cell"), [(nts.EnergyMomentum, "hexahedron"), once(nts.Midpoint, "tetrahedron")]
)


def rubber(**damping):
    return nts.SaintVenantKirchhoff(1.0e3, 0.3, RHO, **damping)


@schemes
def test_mass_damping_slows_a_rigid_body_by_its_rate(comm, cell, scheme):
    # dv/dt = -a v at the middle of the step: v_n+1 (1 + a dt/2) = v_n (1 - a dt/2).
    a, dt, v = 3.0, 0.05, np.array([2.0, -1.0, 0.5])
    box = Box(comm, cell, rubber(mass_damping=a))
    stepper = scheme([box.body], dt=dt)
    stepper.set_velocity(box.body, v)
    ledger = Ledger(stepper)
    ledger.run(6)
    rate = (1 - a * dt / 2) / (1 + a * dt / 2)
    np.testing.assert_allclose(stepper.v.x.array.reshape(-1, 3), [rate**6 * v] * (
        len(stepper.x)), atol=SOLVED)  # fmt: skip
    damped = RHO * VOLUME * v @ v / 2 * (1 - rate**12)
    assert ledger.total("damping_work") == pytest.approx(-damped, rel=SOLVED)
    assert ledger.error <= CLOSED


STIFFNESS, BOTH = {"stiffness_damping": 0.01}, {"mass_damping": 1.0, "stiffness_damping": 0.2}


@pytest.mark.parametrize(
    # Each two of the three meet.
    ("scheme", "cell", "damping"),
    [
        (nts.EnergyMomentum, "hexahedron", STIFFNESS),
        once(nts.EnergyMomentum, "tetrahedron", BOTH),
        once(nts.Midpoint, "tetrahedron", STIFFNESS),
        once(nts.Midpoint, "hexahedron", BOTH),
    ],
)
def test_damping_only_takes_energy_and_all_of_it_is_accounted_for(comm, cell, scheme, damping):
    check_loss(comm, cell, rubber(**damping), scheme)


@schemes
def test_stiffness_damping_leaves_momenta_of_a_spinning_body(comm, cell, scheme):
    box = Box(comm, cell, rubber(stiffness_damping=0.05))
    stepper = scheme([box.body], dt=0.02)
    stepper.set_velocity(box.body, swirl)
    ledger = Ledger(stepper)
    ledger.run(12)
    start, end = ledger.start, ledger.diagnostics.balance()
    for name in ("linear_momentum", "angular_momentum"):
        before, after = getattr(start, name), getattr(end, name)
        np.testing.assert_allclose(after, before, atol=1e-12 * np.linalg.norm(before))
    # Vibrations have decayed, rotation remains.
    assert ledger.total("damping_work") < -1
    assert abs(ledger.reports[-1].damping_work) < 0.1 * abs(ledger.reports[0].damping_work)


@pytest.mark.serial
def test_steadily_turning_body_is_not_slowed_by_stiffness_damping(comm):
    # Stiff compared to the spin, so that it rotates rigidly; C is constant.
    stiff = nts.SaintVenantKirchhoff(1.0e7, 0.3, RHO, stiffness_damping=1.0)
    box = Box(comm, material=stiff)
    stepper = nts.EnergyMomentum([box.body], dt=0.01)
    centre = np.array([[0.5], [0.4], [0.3]])
    spin = lambda X: np.cross([0.0, 0.0, 2.0], (X - centre).T).T  # noqa: E731
    stepper.set_velocity(box.body, spin)
    ledger = Ledger(stepper)
    ledger.run(5)
    assert abs(ledger.total("damping_work")) <= 1e-4 * ledger.start.kinetic_energy
    turned = ledger.diagnostics.angular_momentum()
    np.testing.assert_allclose(turned, ledger.start.angular_momentum, atol=1e-9)


def test_damping_agrees_with_its_body(comm):
    data = box_meshes.boxes([(2, 2, 2), (2, 2, 2)], [(1.0, 0.8, 0.6), (1.0, 0.8, 0.6)])
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    materials = rubber(), rubber(mass_damping=2.0)
    bodies = [nts.Body(V, cells, tag[f"body {i}"], m) for i, m in enumerate(materials)]
    stepper = nts.EnergyMomentum(bodies, dt=0.1)
    for body in bodies:
        stepper.set_velocity(body, (1.0, 0.0, 0.0))
    ledger = Ledger(stepper)
    ledger.run(3)
    free, damped = (ledger.diagnostics.body_velocity(body)[0] for body in bodies)
    assert free == pytest.approx(1.0, rel=SOLVED)
    assert damped == pytest.approx((0.9 / 1.1) ** 3, rel=SOLVED)
    assert ledger.error <= CLOSED


@pytest.mark.serial
def test_mode_of_a_bar_decays_as_stiffness_damping_says(comm):
    r"""Lowest mode of a clamped bar: q'' + b w^2 q' + w^2 q = 0.

    w is the frequency of n linear cells; the means of a step replace q and q'.
    """
    n, length, E, dt, b = 8, 2.0, 900.0, 0.004, 0.01
    material = nts.SaintVenantKirchhoff(E, 0.0, 1.0, stiffness_damping=b)
    box = Box(comm, material=material, shape=(n, 1, 1), size=(length, 0.1, 0.1))
    bcs = [fem.dirichletbc(np.zeros(3), box.dofs(0), box.V)]
    stepper = nts.EnergyMomentum([box.body], dt=dt, bcs=bcs)
    k, cell, v = np.pi / (2 * length), length / n, 1e-5
    stepper.set_velocity(box.body, lambda X: v * np.array([np.sin(k * X[0]), 0 * X[0], 0 * X[0]]))
    w2 = E / cell**2 * 6 * (1 - np.cos(k * cell)) / (2 + np.cos(k * cell))
    # q' - (q_1 - q_0)/dt = 0 and q'' + b w^2 q' + w^2 q = 0 at the middle.
    left = np.array([[1, -dt / 2], [dt * w2 / 2, 1 + dt * b * w2 / 2]])
    right = np.array([[1, dt / 2], [-dt * w2 / 2, 1 - dt * b * w2 / 2]])
    step, state = np.linalg.solve(left, right), np.array([0.0, v])
    X = box.positions(stepper)
    for _ in range(40):
        stepper.advance()
        state = step @ state
        tip = (box.positions(stepper) - X)[np.isclose(X[:, 0], length), 0]
        # Second order in the amplitude of 1e-6 is left out.
        np.testing.assert_allclose(tip, state[0], atol=1e-5 * v / np.sqrt(w2))


@pytest.mark.serial
@pytest.mark.parametrize("name", ["mass_damping", "stiffness_damping"])
def test_impossible_damping_is_refused(name):
    with pytest.raises(ValueError, match=f"expected {name} >= 0, given -1"):
        rubber(**{name: -1.0})
    with pytest.raises(ValueError, match=f"finite number for {name}, given nan"):
        rubber(**{name: np.nan})
