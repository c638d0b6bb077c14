"""Strain energies by name: closed forms, moduli, free flight, bad numbers."""

import numpy as np
import pytest
import ufl

import dolfinx_nts as nts
from dolfinx_nts.materials.evaluation import Evaluation
from dolfinx_nts.materials.library import MooneyRivlin, NeoHookean, Yeoh
from helpers.models.boxed import Box, Ledger, swirl
from reference.bulk import rotation

pytestmark = pytest.mark.at_most_two_ranks

EPS = np.finfo(float).eps
E, NU, RHO = 1.0e3, 0.3, 10.0
MU, LMBDA = E / 2.6, E * NU / (1.3 * 0.4)
KAPPA = 700.0


def isochoric(C):
    """Isochoric invariants and volume ratio."""
    J2 = np.linalg.det(C)
    C_bar = C / np.cbrt(J2)
    return np.trace(C_bar), np.trace(np.linalg.inv(C_bar)), np.sqrt(J2)


def neo_hookean(U):
    """Energy with a function U of the volume ratio."""

    def psi(C):
        J = np.sqrt(np.linalg.det(C))
        return MU / 2 * (np.trace(C) - 3) - MU * np.log(J) + LMBDA / 2 * U(J) ** 2

    return psi


def mooney_rivlin(C):
    I1, I2, J = isochoric(C)
    return 80 * (I1 - 3) + 30 * (I2 - 3) + KAPPA / 2 * (J - 1) ** 2


def yeoh(C):
    I1, _, J = isochoric(C)
    return 90 * (I1 - 3) + 20 * (I1 - 3) ** 2 + 5 * (I1 - 3) ** 3 + KAPPA / 2 * (J - 1) ** 2


# Material, energy, shear modulus and Lame's first number of small strains.
CASES = {
    "neo-hookean log": (NeoHookean(E, NU, RHO), neo_hookean(np.log), MU, LMBDA),
    "neo-hookean quadratic": (
        NeoHookean(E, NU, RHO, volumetric="quadratic"),
        neo_hookean(lambda J: J - 1),
        MU,
        LMBDA,
    ),
    "mooney-rivlin": (MooneyRivlin(80.0, 30.0, KAPPA, RHO), mooney_rivlin, 220.0, KAPPA - 440 / 3),
    "yeoh": (Yeoh(90.0, 20.0, 5.0, KAPPA, RHO), yeoh, 180.0, KAPPA - 120.0),
}
cases = pytest.mark.parametrize("name", CASES)


@pytest.mark.serial
@cases
def test_energy_agrees_with_its_closed_form(name, at, rng):
    material, psi, *_ = CASES[name]
    evaluate = at(lambda C: ufl.as_vector([material.psi(C, **material.parameters)]))
    for _ in range(4):
        Q = rotation(rng.normal(size=3), rng.uniform(0, 3))
        C = Q @ np.diag(rng.uniform(0.6, 1.6, 3) ** 2) @ Q.T
        assert evaluate(C)[0] == pytest.approx(psi(C), rel=1e2 * EPS, abs=1e3 * EPS * E)


@pytest.mark.serial
@cases
def test_small_strains_meet_hookes_law(name, at, rng):
    material, _, mu, lmbda = CASES[name]
    stress = at(lambda C: material.stress(C, **material.parameters))
    I = np.eye(3)  # noqa: E741
    assert np.abs(stress(I)).max() <= 1e2 * EPS * E
    linear = at(lambda C: material.linear_stress((C - ufl.Identity(3)) / 2, **material.parameters))
    A, h = rng.normal(size=(3, 3)), 1e-6
    strain = (A + A.T) / 2
    hooke = lmbda * np.trace(strain) * I + 2 * mu * strain
    np.testing.assert_allclose(linear(I + 2 * strain).reshape(3, 3), hooke, atol=1e2 * EPS * E)
    slope = (stress(I + 2 * h * strain) - stress(I - 2 * h * strain)).reshape(3, 3) / (2 * h)
    np.testing.assert_allclose(slope, hooke, atol=1e-7 * E)


@pytest.mark.serial
def test_stress_is_symmetric_for_an_energy_that_names_entries_of_C(at, rng):
    material = nts.Hyperelastic(
        lambda C: 3 * C[0, 1] ** 2 + 5 * C[2, 0] ** 2 + (C[1, 1] - 1) ** 2, rho=1.0
    )
    S = at(material.stress)(np.array([[1.2, 0.3, 0.1], [0.3, 0.9, 0.2], [0.1, 0.2, 1.1]]))
    np.testing.assert_allclose(S.reshape(3, 3), [[0, 1.8, 1], [1.8, -0.4, 0], [1, 0, 0]], atol=EPS)


@pytest.mark.serial
@pytest.mark.parametrize(
    "material",
    [NeoHookean(E, NU, RHO), NeoHookean(E, NU, RHO, mass_damping=2.0)],
    ids=["free", "damped"],
)
def test_neo_hookean_body_flies_and_turns_with_exact_energy_and_momenta(comm, material):
    # Strains of 20 % in a step, and a rotation of some radians.
    box = Box(comm, material=material)
    stepper = nts.EnergyMomentum([box.body], dt=0.05)
    stepper.set_velocity(box.body, swirl)
    ledger = Ledger(stepper)
    ledger.run(20)
    assert ledger.error <= 1e-12
    start, end = ledger.start, ledger.diagnostics.balance()
    if not material.is_damped:
        assert abs(end.total_energy / start.total_energy - 1) <= 1e-11
        for name in ("linear_momentum", "angular_momentum"):
            before, after = getattr(start, name), getattr(end, name)
            np.testing.assert_allclose(after, before, atol=1e-12 * np.linalg.norm(before))
    edge = np.diff(box.positions(stepper)[[0, 2]], axis=0)[0] / 1.0
    assert np.degrees(np.arccos(edge[0] / np.linalg.norm(edge))) > 45


def test_body_of_an_anisotropic_energy_with_a_field_conserves_energy(comm):
    # Fibres along a direction that varies in space.
    box = Box(comm)
    X = ufl.SpatialCoordinate(box.mesh)
    a = ufl.as_vector([ufl.cos(X[1]), ufl.sin(X[1]), 0])

    def psi(C, mu):
        E_GL = (C - ufl.Identity(3)) / 2
        return mu * ufl.inner(E_GL, E_GL) + mu * (ufl.inner(a, C * a) - 1) ** 2

    material = nts.Hyperelastic(psi, rho=RHO, mu=500.0)
    body = nts.Body(box.V, box.cells, box.tag["body 0"], material)
    stepper = nts.EnergyMomentum([body], dt=0.02)
    stepper.set_velocity(body, lambda X: swirl(X) / 2)
    ledger = Ledger(stepper)
    ledger.run(8)
    assert abs(ledger.gained) <= 1e-11 * ledger.scale


@pytest.mark.serial
@pytest.mark.serial
def test_energy_is_checked_once_for_materials_with_the_same_parameters(monkeypatch):
    evaluations, value = [], Evaluation.value
    monkeypatch.setattr(
        Evaluation, "value", lambda self, at: evaluations.append(at) or value(self, at)
    )

    def count(make):
        evaluations.clear()
        material = make()
        return len(evaluations), material.moduli

    for law in (nts.NeoHookean, nts.SaintVenantKirchhoff):
        first, moduli = count(lambda law=law: law(E=1.2345e4, nu=0.3, rho=1.0))
        again, same = count(lambda law=law: law(E=1.2345e4, nu=0.3, rho=2.0, mass_damping=1.0))
        other, softer = count(lambda law=law: law(E=1.2346e4, nu=0.3, rho=1.0))
        assert first == other > 10 and again == 0
        np.testing.assert_array_equal(moduli, same)
        assert np.abs(moduli / 1.2345 - softer / 1.2346).max() < 1e-9 * moduli.max()

    # A function of a script may return another energy when it is called again.
    modulus = [10.0]

    def psi(C):
        J2 = ufl.det(C)
        return modulus[0] * (ufl.tr(C) - 3 - ufl.ln(J2)) + ufl.ln(J2) ** 2

    _, soft = count(lambda: nts.Hyperelastic(psi, rho=1.0))
    modulus[0] = 20.0
    _, stiff = count(lambda: nts.Hyperelastic(psi, rho=1.0))
    assert stiff[1, 1] == pytest.approx(2 * soft[1, 1])


def test_impossible_materials_are_refused():
    with pytest.raises(ValueError, match="Young's modulus E > 0, given -1"):
        NeoHookean(-1.0, 0.3, 1.0)
    with pytest.raises(
        ValueError, match=r"volumetric to be one of \['log', 'quadratic'\], given 'cubic'"
    ):
        NeoHookean(1.0, 0.3, 1.0, volumetric="cubic")
    with pytest.raises(ValueError, match=r"c10 \+ c01 > 0, given -1"):
        MooneyRivlin(1.0, -2.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="kappa > 0, given 0"):
        Yeoh(1.0, 0.0, 0.0, 0.0, 1.0)


@pytest.mark.serial
@pytest.mark.parametrize(("E", "nu"), [(2.0e3, 0.3), (1.0, 0.0), (5.0, -0.5), (1.0e5, 0.49)])
def test_young_and_poisson_agree_with_uniaxial_stress(E, nu):
    # Strain (e, -nu e, -nu e) has the stress (E e, 0, 0) in Hooke's law.
    material = nts.SaintVenantKirchhoff(E, nu, rho=1.0)
    strain = 0.1 * np.array([1.0, -nu, -nu])
    C = ufl.as_matrix(np.diag(1 + 2 * strain).tolist())
    S = material.stress(C, **material.parameters)
    stress = [float(S[i, i](())) for i in range(3)]
    rounding = 1e2 * EPS * E / (1 - 2 * nu)
    np.testing.assert_allclose(stress, [0.1 * E, 0, 0], atol=rounding)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"E": 0.0}, "Young's modulus E > 0, given 0"),
        ({"E": -1.0}, "Young's modulus E > 0, given -1"),
        ({"E": np.nan}, "Young's modulus E > 0, given nan"),
        ({"E": np.inf}, "Young's modulus E > 0, given inf"),
        ({"nu": 0.5}, r"-1 < nu < 0.5, given 0.5"),
        ({"nu": -1.0}, r"-1 < nu < 0.5, given -1"),
        ({"nu": np.nan}, r"-1 < nu < 0.5, given nan"),
        ({"rho": 0.0}, "rho > 0, given 0"),
        ({"rho": -2.0}, "rho > 0, given -2"),
        ({"rho": np.nan}, "finite number for rho, given nan"),
        ({"rho": np.inf}, "finite number for rho, given inf"),
    ],
)
def test_svk_refuses_impossible_numbers(numbers, message):
    with pytest.raises(ValueError, match=message):
        nts.SaintVenantKirchhoff(**({"E": 1.0, "nu": 0.3, "rho": 1.0} | numbers))
