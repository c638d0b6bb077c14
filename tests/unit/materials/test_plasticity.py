"""J2 plasticity at a point: radial return against a NumPy twin, and dissipation in any step."""

from itertools import product

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_square
from scipy.optimize import brentq

import dolfinx_nts as nts
from dolfinx_nts.fem.jit import compile_expression
from dolfinx_nts.materials.hardening import Hardening
from dolfinx_nts.materials.radial_return import RadialReturn
from dolfinx_nts.materials.volumetric_split import parts

pytestmark = pytest.mark.serial

MU = 1.0
LAWS = {
    "perfect": Hardening(0.01, 0.0, 0.0, 0.0),
    "linear": Hardening(0.01, 0.05, 0.0, 0.0),
    "saturating": Hardening(0.01, 0.002, 0.02, 16.0),
    "soft": Hardening(0.5, 0.1, 0.0, 0.0),
}
one = np.eye(3)


class Point:
    """Radial return of the package at a point."""

    def __init__(self, law):
        """Compile the return."""
        mesh = create_unit_square(MPI.COMM_SELF, 1, 1)
        self._tensors = [fem.Constant(mesh, one) for _ in range(2)]
        self._alpha, self._mesh = fem.Constant(mesh, 0.0), mesh
        flow = RadialReturn(*self._tensors, self._alpha, MU, law)
        parts = [flow.metric[i, j] for i in range(3) for j in range(3)]
        values = ufl.as_vector([flow.factor, flow.increment, *parts])
        self._values = compile_expression(values, np.array([[0.3, 0.3]]))

    def flow(self, C, G, alpha):
        """Scaling factor of the deviator, plastic increment, and plastic metric."""
        for constant, value in zip([*self._tensors, self._alpha], (C, G, alpha), strict=True):
            constant.value = value
        t, x, *parts = self._values.eval(self._mesh, np.zeros(1, dtype=np.int32)).ravel()
        return t, x, np.reshape(parts, (3, 3))


def twin(C, G, alpha, law):
    """Radial return by spectral decomposition and bisection: factor, increment, metric."""
    C = C / np.linalg.det(C) ** (1 / 3)
    U = np.linalg.cholesky(C).T
    b, directions = np.linalg.eigh(U @ G @ U.T)
    mean = b.mean()
    q = np.sqrt(1.5) * MU * np.linalg.norm(b - mean)

    def stress(a):
        return law.yield_stress + law.modulus * a + law.increase * (1 - np.exp(-law.rate * a))

    if q <= stress(alpha):
        return 1.0, 0.0, G
    skew = np.prod(b - mean) / np.mean((b - mean) ** 2)
    rate = (mean + np.cbrt(b.prod()) + skew * (1 + stress(alpha) / q)) / 2
    x = brentq(lambda x: q - 3 * MU * rate * x - stress(alpha + x), 0, q / (3 * MU * rate))
    t = stress(alpha + x) / q
    roots = np.roots([1, *np.poly(-t * (b - mean))[1:3], np.prod(t * (b - mean)) - b.prod()])
    new = max(root.real for root in roots if abs(root.imag) < 1e-9) + t * (b - mean)
    back = np.linalg.inv(U) @ directions
    return t, x, back @ np.diag(new) @ back.T


def energy(C, G):
    """Deviatoric elastic energy."""
    return MU / 2 * (np.linalg.det(C) ** (-1 / 3) * np.vdot(C, G) - 3)


def states(rng, law, travel):
    """Tensor C and an admissible metric at the start of a step, and C at its end.

    The step is as long as ``travel`` strains at which the material yields, but at most 0.6.
    """
    F_n = one + 0.3 * rng.uniform(-1, 1, (3, 3))
    F_n /= np.cbrt(np.linalg.det(F_n))
    C_n = F_n.T @ F_n
    strain, yields = rng.normal(size=(3, 3)), law.yield_stress / (3 * MU)
    strain = strain + strain.T - 2 * np.trace(strain) / 3 * one
    strain *= rng.choice([0.0, 1.0, 2.0]) * yields / np.linalg.norm(strain)
    w, v = np.linalg.eigh(2 * strain)
    F_inv = np.linalg.inv(F_n)
    G = F_inv @ v @ np.diag(np.exp(w)) @ v.T @ F_inv.T
    G = twin(C_n, G, 0.0, law._replace(modulus=0.0, increase=0.0))[2]
    h = rng.normal(size=(3, 3))
    F = (one + min(travel * yields, 0.6) * h / np.linalg.norm(h)) @ F_n
    return C_n, G, F.T @ F


@pytest.mark.parametrize("name", LAWS)
def test_the_return_agrees_with_a_twin_and_keeps_the_plastic_volume(name):
    rng, law, flown = np.random.default_rng(3), LAWS[name], 0
    point = Point(law)
    for travel, alpha, _ in product((1, 10, 100), (0.0, 0.2), range(30)):
        _, G, C = states(rng, law, travel)
        t, x, metric = point.flow(C, G, alpha)
        exact = twin(C, G, alpha, law)
        flown += x > 0
        assert t == pytest.approx(exact[0], abs=1e-10)
        assert x == pytest.approx(exact[1], abs=1e-11)
        np.testing.assert_allclose(metric, exact[2], atol=1e-9)
        assert np.linalg.det(metric) == pytest.approx(np.linalg.det(G), rel=1e-11)
    assert flown > 50


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("travel", [0.3, 1, 3, 10, 100])
def test_no_step_gains_energy_by_plastic_flow(name, travel):
    # Any step of the energy-momentum scheme, with the stress t S of which the work is
    # t (W(C, G_n) - W_n), from any admissible state.
    rng, law, flown, least = np.random.default_rng(5), LAWS[name], 0, np.inf
    for _ in range(200):
        C_n, G, C = states(rng, law, travel)
        t, *_ = twin((C_n + C) / 2, G, 0.0, law)
        _, x, after = twin(C, G, 0.0, law)
        before, trial, end = energy(C_n, G), energy(C, G), energy(C, after)
        least = min(least, (t * (trial - before) + before - end) / law.yield_stress)
        flown += x > 0
    assert flown > 20
    assert least >= -1e-13


def test_the_conserving_stress_with_a_metric_does_the_work_of_the_energy():
    rng, material = np.random.default_rng(1), nts.J2Plasticity(2.6, 0.3, 1.0, yield_stress=0.01)
    C_n, G, C = (ufl.as_matrix(value.tolist()) for value in states(rng, LAWS["soft"], 0.4))
    S = material.conserving_stress(C_n, C, metric=G)
    change = material.psi(C, metric=G) - material.psi(C_n, metric=G)
    work = float((ufl.inner(S, C - C_n) / 2)(()))
    assert work == pytest.approx(float(change(())), rel=1e-11)


@pytest.mark.parametrize("nu", [0.0, 0.2, 0.35])
def test_changes_of_volume_have_one_point_whatever_the_poisson_ratio(nu):
    # Flow keeps the volume, so that cells with all points would lock.
    law = nts.J2Plasticity(1.0, nu, 1.0, yield_stress=0.1)
    assert law.splits_volume
    most, volumetric = parts(law, splits=True)
    assert (most.left_out, volumetric.left_out) == ({"mu", "kappa"}, {"mu"})


def test_logged_parameters_and_refused_arguments():
    law = nts.J2Plasticity(1.0, 0.3, 2.0, yield_stress=0.1, hardening=0.2, saturation=(0.3, 4.0))
    assert "yield_stress=0.1, hardening=0.2, saturation=(0.3, 4" in repr(law)
    assert law.hardening == (0.1, 0.2, 0.3, 4.0)
    numbers = {"E": 1.0, "nu": 0.3, "rho": 1.0, "yield_stress": 0.1}
    signs = {"E": 0.0, "nu": 0.5, "rho": -1.0, "yield_stress": 0.0, "hardening": -0.1,
             "saturation": (0.0, 1.0), "mass_damping": -1.0}  # fmt: skip
    for wrong in ({name: value} for name, value in signs.items()):
        with pytest.raises(ValueError, match=r"expected .*, given"):
            nts.J2Plasticity(**numbers | wrong)
    for wrong in ({"saturation": 0.5}, {"yield_stress": "0.1"}):
        with pytest.raises(TypeError, match=r"expected .*, given"):
            nts.J2Plasticity(**numbers | wrong)
    with pytest.raises(ValueError, match="expected SaintVenantKirchhoff, or NeoHookean"):
        nts.PlaneStress(law)
