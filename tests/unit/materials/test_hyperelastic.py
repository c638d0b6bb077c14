"""Strain energy, stress and conserving stress, evaluated by compiled code."""

import math
from collections.abc import Callable
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_cube

import dolfinx_nts as nts
from dolfinx_nts.fem.jit import compile_expression
from dolfinx_nts.materials.strain_energy import strain_basis
from reference.bulk import rotation, taylor_order

pytestmark = pytest.mark.serial

EPS = np.finfo(float).eps
MU, LMBDA = 3.0, 5.0

# Where no correction is made, three Gauss points leave a defect of 3e-14 mu
# for each |dC| at |dC| = 0.01 (7th order of a smooth energy), theory of the
# average; measured with this energy, ten times as much is allowed.
DEFECT = 3e-13 * MU
# Energies are sums of about ten terms of the size of mu.
ENERGY_ROUNDING = 20 * EPS * MU


def neo_hookean(C: Any, mu: Any, lmbda: Any) -> Any:
    """Compressible neo-Hookean energy, not a polynomial of C."""
    J2 = ufl.det(C)
    return mu / 2 * (ufl.tr(C) - 3 - ufl.ln(J2)) + lmbda / 8 * ufl.ln(J2) ** 2


def young(lmbda: float, mu: float) -> tuple[float, float]:
    """Young's modulus and Poisson's ratio of Lame's numbers."""
    return mu * (3 * lmbda + 2 * mu) / (lmbda + mu), lmbda / (2 * (lmbda + mu))


MATERIALS = {
    "svk": nts.SaintVenantKirchhoff(*young(LMBDA, MU), rho=1.0),
    "neo-hookean": nts.Hyperelastic(neo_hookean, rho=1.0, mu=MU, lmbda=LMBDA),
    "log": nts.NeoHookean(*young(LMBDA, MU), rho=1.0),
    "quadratic": nts.NeoHookean(*young(LMBDA, MU), rho=1.0, volumetric="quadratic"),
    "mooney-rivlin": nts.MooneyRivlin(0.3 * MU, 0.2 * MU, LMBDA, rho=1.0),
    "yeoh": nts.Yeoh(0.5 * MU, -0.05 * MU, 0.01 * MU, LMBDA, rho=1.0),
}
materials = pytest.mark.parametrize("name", MATERIALS)

Evaluate = Callable[[str, str, np.ndarray, np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def evaluate() -> Evaluate:
    """Evaluate a quantity of a material at C_n, C; compiled once."""
    mesh = create_unit_cube(MPI.COMM_WORLD, 2, 2, 2)
    C_n, C = (fem.Constant(mesh, np.eye(3)) for _ in range(2))
    point = np.full((1, 3), 0.25)
    compiled = {}
    for name, material in MATERIALS.items():
        numbers = material.parameters
        quantities = {
            "psi": ufl.as_vector([material.psi(C, **numbers)]),
            "stress": material.stress(C, **numbers),
            "conserving": material.conserving_stress(C_n, C, **numbers),
        }
        for quantity, expression in quantities.items():
            compiled[name, quantity] = compile_expression(expression, point)

    def at(name: str, quantity: str, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        C_n.value[:], C.value[:] = before, after
        value = compiled[name, quantity].eval(mesh, np.zeros(1, dtype=np.int32)).ravel()
        return value[0] if value.size == 1 else value.reshape(3, 3)

    return at


def tensor(rng: np.random.Generator) -> np.ndarray:
    """Random right Cauchy-Green tensor with stretches from 0.7 to 1.4."""
    Q = rotation(rng.normal(size=3), rng.uniform(0, 3))
    return Q @ np.diag(rng.uniform(0.7, 1.4, 3) ** 2) @ Q.T


def symmetric(rng: np.random.Generator) -> np.ndarray:
    """Random symmetric direction of norm one."""
    A = rng.normal(size=(3, 3))
    return (A + A.T) / np.linalg.norm(A + A.T)


@materials
def test_stress_is_twice_the_derivative_of_the_energy(name, evaluate, rng):
    for _ in range(3):
        C, D = tensor(rng), symmetric(rng)
        S = evaluate(name, "stress", C, C)
        np.testing.assert_allclose(S, S.T, atol=1e2 * EPS * LMBDA)
        slope = np.sum(S * D) / 2
        order = taylor_order(lambda at: evaluate(name, "psi", at, at), C, 2 * D, 2 * slope)
        assert order > 1.9


def test_svk_stress_agrees_with_the_closed_form(evaluate, rng):
    C = tensor(rng)
    E = (C - np.eye(3)) / 2
    expected = LMBDA * np.trace(E) * np.eye(3) + 2 * MU * E
    np.testing.assert_allclose(evaluate("svk", "stress", C, C), expected, rtol=1e2 * EPS)


@materials
@pytest.mark.parametrize(
    "size", [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.0099, 0.0101, 0.03, 0.1, 0.5], ids=str
)
def test_work_of_the_conserving_stress_is_the_change_of_energy(name, size, evaluate, rng):
    for _ in range(4):
        C_n, D = tensor(rng), symmetric(rng)
        C = C_n + size * D
        if np.linalg.eigvalsh(C).min() < 0.1:
            C = C_n - size * D
        S = evaluate(name, "conserving", C_n, C)
        change = evaluate(name, "psi", C, C) - evaluate(name, "psi", C_n, C_n)
        work = np.sum(S * (C - C_n)) / 2
        assert abs(work - change) <= DEFECT * size + ENERGY_ROUNDING


@materials
@pytest.mark.parametrize("size", [0.0, 1e-14, 1e-12, 1e-10, 1e-8], ids=str)
def test_conserving_stress_of_a_body_at_rest_is_the_stress_without_noise(name, size, evaluate, rng):
    # Differs by half of dC times the second derivatives, of order mu.
    for _ in range(4):
        C_n = tensor(rng)
        C = C_n + size * symmetric(rng)
        noise = evaluate(name, "conserving", C_n, C) - evaluate(name, "stress", C_n, C_n)
        assert np.abs(noise).max() <= 1e2 * (EPS + size) * LMBDA


@materials
@pytest.mark.parametrize("size", [1e-3, 0.3], ids=str)
def test_conserving_stress_is_the_same_backwards_in_time(name, size, evaluate, rng):
    C_n = tensor(rng)
    C = C_n + size * symmetric(rng)
    S = evaluate(name, "conserving", C_n, C)
    # The correction divides rounding of the energy by |dC|.
    rounding = 1e2 * EPS * LMBDA / size
    np.testing.assert_allclose(evaluate(name, "conserving", C, C_n), S, atol=rounding)


def test_conserving_stress_has_no_jump_where_the_correction_starts(evaluate, rng):
    C_n, D = tensor(rng), symmetric(rng)
    below, above = (
        evaluate("neo-hookean", "conserving", C_n, C_n + (1e-2 + shift) * D)
        for shift in (-1e-13, 1e-13)
    )
    assert np.abs(above - below).max() <= DEFECT + ENERGY_ROUNDING / 1e-2


def test_hyperelastic_refuses_bad_numbers_and_energies():
    with pytest.raises(ValueError, match="rho > 0, given -1"):
        nts.Hyperelastic(neo_hookean, rho=-1.0, mu=MU, lmbda=LMBDA)
    with pytest.raises(ValueError, match="finite number for mu, given nan"):
        nts.Hyperelastic(neo_hookean, rho=1.0, mu=np.nan, lmbda=LMBDA)
    with pytest.raises(ValueError, match=r"scalar strain energy psi\(C\), given shape \(3, 3\)"):
        nts.Hyperelastic(lambda C: C, rho=1.0)
    with pytest.raises(TypeError, match=r"expected a function psi\(C\), given float"):
        nts.Hyperelastic(1.0, rho=1.0)
    with pytest.raises(ValueError, match=r"a minimum at C = 1, .* negative eigenvalue, -24 Pa"):
        nts.Hyperelastic(lambda C: -((ufl.tr(C) - 3) ** 2), rho=1.0)
    with pytest.raises(ValueError, match=r"resists a change of volume, given a bulk modulus of 0"):
        nts.Hyperelastic(lambda C: MU / 2 * (ufl.det(C) ** (-1 / 3) * ufl.tr(C) - 3), rho=1.0)


@pytest.mark.parametrize(
    "psi",
    [
        lambda C: math.exp(ufl.tr(C) - 3),
        lambda C: np.log(ufl.det(C)) ** 2,
        lambda C: max(ufl.tr(C) - 3, 0) ** 2,
        lambda C: ufl.tr(C) - 3 if ufl.tr(C) > 3 else 0 * ufl.tr(C),
    ],
    ids=["math", "numpy", "max", "if"],
)
def test_energy_of_python_numbers_is_refused_with_functions_of_ufl(psi):
    with pytest.raises((TypeError, ValueError), match=r"instead of functions of math.*use ufl\."):
        nts.Hyperelastic(psi, rho=1.0)


@pytest.mark.parametrize(
    "psi",
    [
        lambda C: abs(ufl.tr(C) - 3),
        lambda C: ufl.sqrt(ufl.tr(C) - 3),
        lambda C: abs(ufl.det(C) - 1) ** 1.5,
        lambda C: ufl.max_value(ufl.tr(C) - 3, 0) ** 2,
        lambda C: 1 / (ufl.tr(C) - 3),
        lambda C: ufl.ln(ufl.det(C) - 1),
    ],
    ids=["abs", "sqrt", "power", "one-sided", "pole", "ln"],
)
def test_energy_without_second_derivative_is_refused(psi):
    with pytest.raises(ValueError, match=r"expected psi\(C\) twice differentiable at C = 1, given"):
        nts.Hyperelastic(psi, rho=1.0)


@pytest.mark.parametrize(
    ("psi", "stress"),
    [
        (lambda C: 3 * ufl.tr(C), r"\[\[6.0, 0.0, 0.0\], \[0.0, 6.0, 0.0\], \[0.0, 0.0, 6.0\]\]"),
        (
            lambda C: 1e3 * (ufl.tr(C) - 3) ** 2 + C[0, 1] + C[1, 0],
            r"\[\[0.0, 2.0, 0.0\], \[2.0, 0.0, 0.0\], \[0.0, 0.0, 0.0\]\]",
        ),
    ],
)
def test_energy_with_a_stress_at_rest_is_refused_with_the_stress(psi, stress):
    with pytest.raises(ValueError, match=f"without stress at C = 1, given S = {stress} Pa"):
        nts.Hyperelastic(psi, rho=1.0)


def test_small_stress_at_rest_by_rounded_numbers_is_accepted():
    nts.Hyperelastic(lambda C: 1e3 * (ufl.tr(C) - 3) ** 2 + 1e-4 * ufl.tr(C), rho=1.0)


def test_energy_and_stress_without_numbers_agree_with_the_material():
    C = ufl.Identity(3) * 1.1
    for material in MATERIALS.values():
        given = material.parameters
        assert material.psi(C)(()) == material.psi(C, **given)(()) > 0
        traces = [ufl.tr(material.stress(C, **numbers))(()) for numbers in ({}, given)]
        assert traces[0] == traces[1] > 0
        with pytest.raises(TypeError, match="does not support item assignment"):
            given["mu"] = 1.0


def test_stiff_exponentials_are_accepted():
    nts.Hyperelastic(lambda C: ufl.exp(500 * (ufl.tr(C) - 3) ** 2), rho=1.0)


@pytest.mark.parametrize(
    ("material", "resists"),
    [
        (nts.SaintVenantKirchhoff(1e5, 0.3, 1e3), False),
        (nts.NeoHookean(1e5, 0.3, 1e3), True),
        (nts.Hyperelastic(lambda C: (ufl.det(C) - 1) ** 2, rho=1.0), False),
        (nts.Hyperelastic(lambda C: ufl.tr(C) + 1 / ufl.det(C), rho=1.0), True),
    ],
)
def test_energies_know_whether_they_resist_collapse(material, resists):
    assert material.resists_collapse == resists


@pytest.mark.parametrize(
    "material",
    [
        nts.SaintVenantKirchhoff(*young(LMBDA, MU), rho=1.0),
        nts.NeoHookean(*young(LMBDA, MU), rho=1.0, volumetric="quadratic"),
        nts.Hyperelastic(neo_hookean, rho=1.0, mu=MU, lmbda=LMBDA),
        nts.MooneyRivlin(0.3 * MU, 0.2 * MU, LMBDA + 2 / 3 * MU, rho=1.0),
        nts.Yeoh(0.5 * MU, 0.1, 0.2, LMBDA + 2 / 3 * MU, rho=1.0),
    ],
)
def test_moduli_at_rest_agree_with_lame(material):
    """2 mu E + lambda tr(E) 1 in an orthonormal basis of the strains."""
    trace = np.einsum("aii->a", strain_basis())
    expected = 2 * MU * np.eye(6) + LMBDA * np.outer(trace, trace)
    np.testing.assert_allclose(material.moduli, expected, rtol=0, atol=50 * EPS * expected.max())
    assert material.least_modulus == pytest.approx(2 * MU)
    assert material.poisson_ratio == pytest.approx(LMBDA / (2 * (LMBDA + MU)))


def test_energy_of_the_deformation_gradient_is_refused():
    def psi(F, mu):
        return mu / 2 * (ufl.inner(F, F) - 3 - 2 * ufl.ln(ufl.det(F)))

    with pytest.raises(TypeError, match=r"expected an energy of the right Cauchy-Green tensor C"):
        nts.Hyperelastic(psi, rho=1.0, mu=1.0)
