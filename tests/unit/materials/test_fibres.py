"""Fibres: closed forms of stretch, conserving stress across slack, objectivity, free flight."""

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.fem.jit import compile_expression
from helpers.models.boxed import CLOSED, RHO, Box, Ledger, swirl
from helpers.once import once
from reference.bulk import rotation

pytestmark = pytest.mark.at_most_two_ranks

EPS = np.finfo(float).eps
MU, KAPPA, K1, K2 = 300.0, 2.0e3, 200.0, 2.0
FIBRES = [(1.0, 0.0, 0.0), (0.0, 2.0, 0.0)]


def law(fibres=FIBRES, dispersion=0.0, **options):
    return nts.HolzapfelGasserOgden(
        MU, KAPPA, K1, K2, RHO, fibres=fibres, dispersion=dispersion, **options
    )


def principal_stress(stretch, dispersion):
    """First Piola-Kirchhoff stress of stretches along the axes, fibres along the first two."""
    J = np.prod(stretch)
    bar = stretch**2 * J ** (-2 / 3)
    # Derivative of each squared isochoric stretch with respect to each stretch.
    slope = np.diag(2 * bar / stretch) - 2 / 3 * np.outer(bar, 1 / stretch)
    P = MU / 2 * slope.sum(axis=0) + KAPPA * (J - 1) * J / stretch
    for a in range(2):
        strain = dispersion * (bar.sum() - 3) + (1 - 3 * dispersion) * (bar[a] - 1)
        if strain > 0:
            along = dispersion * slope.sum(axis=0) + (1 - 3 * dispersion) * slope[a]
            P += K1 * strain * np.exp(K2 * strain**2) * along
    return P


@pytest.mark.serial
@pytest.mark.parametrize("dispersion", [0.0, 0.2])
@pytest.mark.parametrize(
    "stretch", [(1.3, 0.9, 0.85), (1.25, 1.25, 0.7), (0.8, 0.85, 1.5)], ids=["uni", "bi", "slack"]
)
def test_stress_of_stretches_agrees_with_the_closed_form(at, stretch, dispersion):
    material, stretch = law(dispersion=dispersion), np.array(stretch)
    S = at(material.stress)(np.diag(stretch**2)).reshape(3, 3)
    P = principal_stress(stretch, dispersion)
    np.testing.assert_allclose(np.diag(stretch) @ S, np.diag(P), atol=1e4 * EPS * KAPPA)


@pytest.mark.serial
def test_a_rotation_of_body_and_fibres_rotates_the_stress(at, rng):
    # C is independent of rotations after the deformation.
    Q = rotation(rng.normal(size=3), 1.1)
    A = rng.normal(size=(3, 3))
    C = np.eye(3) + 0.1 * (A + A.T)
    plain, turned = law(), law([tuple(Q @ fibre) for fibre in FIBRES])
    S, other = (at(m.stress)(T).reshape(3, 3) for m, T in ((plain, C), (turned, Q @ C @ Q.T)))
    np.testing.assert_allclose(Q @ S @ Q.T, other, atol=1e4 * EPS * KAPPA)


@pytest.mark.serial
@pytest.mark.parametrize("size", [0.3, 1e-2, 1e-5, 1e-9, 0.0])
def test_conserving_stress_has_the_work_of_the_energy(comm, rng, size):
    material = law(dispersion=0.1)
    mesh = Box(comm, shape=(comm.size, 1, 1)).mesh
    C_n, C = (fem.Constant(mesh, np.eye(3)) for _ in range(2))
    S = material.conserving_stress(C_n, C)
    parts = [S[i, j] for i in range(3) for j in range(3)]
    values = ufl.as_vector([*parts, material.psi(C_n), material.psi(C)])
    expression = compile_expression(values, np.full((1, 3), 0.25))
    for _ in range(20):
        A, B = (M + M.T for M in rng.normal(size=(2, 3, 3)))
        # About the state in which fibres become taut.
        mean = np.eye(3) + 0.3 * size * A
        C_n.value[:], C.value[:] = mean - size * B / 6, mean + size * B / 6
        *S, psi_n, psi = expression.eval(mesh, np.zeros(1, dtype=np.int32)).ravel()
        work = np.vdot(S, C.value - C_n.value) / 2
        assert abs(work - psi + psi_n) <= 1e2 * EPS * KAPPA * (1 + abs(psi / KAPPA))
        if size == 0.0:
            assert np.abs(S).max() <= 1e2 * EPS * KAPPA


@pytest.mark.parametrize(
    # Kernels of tetrahedra, which have one point, are sooner compiled.
    ("scheme", "kind", "cell"),
    [
        (nts.EnergyMomentum, "expression", "hexahedron"),
        once(nts.EnergyMomentum, "numbers", "tetrahedron"),
        once(nts.Midpoint, "expression", "tetrahedron"),
        once(nts.GeneralizedAlpha, "numbers", "tetrahedron"),
    ],
)
def test_a_body_with_fibres_flies_with_its_energy_and_momenta(comm, scheme, kind, cell):
    box = Box(comm, cell)
    X = ufl.SpatialCoordinate(box.mesh)
    fibres = FIBRES if kind == "numbers" else [ufl.as_vector([ufl.cos(X[1]), ufl.sin(X[1]), 0])]
    body = nts.Body(box.V, box.cells, box.tag["body 0"], law(fibres))
    stepper = scheme([body], dt=0.03)
    stepper.set_velocity(body, swirl)
    ledger = Ledger(stepper)
    ledger.run(8)
    assert ledger.error <= CLOSED
    start, end = ledger.start, ledger.diagnostics.balance()
    change = end.linear_momentum - start.linear_momentum
    assert np.linalg.norm(change) <= 1e-11 * ledger.scale
    if scheme is nts.EnergyMomentum:
        assert abs(ledger.gained) <= 1e-11 * ledger.scale
    if scheme is not nts.GeneralizedAlpha:
        change = end.angular_momentum - start.angular_momentum
        assert np.linalg.norm(change) <= 1e-11 * ledger.scale


@pytest.mark.serial
def test_impossible_fibres_are_refused(comm):
    for wrong in ([(1.0, 0.0)], [(0.0, 0.0, 0.0)], [(np.nan, 0.0, 1.0)]):
        with pytest.raises(ValueError, match="three numbers, not all 0, as in"):
            law(wrong)
    for wrong in (3.0, "xyz", [], ["x"]):
        with pytest.raises(TypeError, match="expected fibres as a sequence of directions"):
            law(wrong)
    with pytest.raises(ValueError, match=r"shape \(3,\), in the plane \(2,\), given \(4,\)"):
        law([ufl.as_vector([1, 2, 3, 4])])
    with pytest.raises(ValueError, match=r"dispersion in \[0, 1/3\], given 0.5"):
        law(dispersion=0.5)
    assert law().one_point == {"kappa"}
    assert "fibres=((1.0, 0.0, 0.0), (0.0, 2.0, 0.0))" in repr(law())
