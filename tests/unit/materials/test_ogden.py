"""Ogden's law: a twin by eigenvectors, Treloar's rubber, conservation, refused arguments."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import locate_entities_boundary
from scipy.optimize import brentq

import dolfinx_nts as nts
from dolfinx_nts.fem.jit import compile_expression
from helpers.models import plane, rings
from helpers.models.boxed import CLOSED, RHO, Box, Ledger, swirl
from helpers.once import once
from reference.bulk import rotation

pytestmark = pytest.mark.at_most_two_ranks

EPS = np.finfo(float).eps
KAPPA = 2.0e3
# Bulk modulus at which errors of the isochoric part are above the round-off of the volume.
SOFT = 1.0
# Treloar's rubber by Ogden (1972), in units in which the shear modulus is 4.225.
TRELOAR = ((6.3, 0.012, -0.1), (1.3, 5.0, -2.0))
TERMS = {
    "treloar": TRELOAR,
    "one": ((-300.0,), (-1.4,)),
    "steep": ((20.0, -8.0), (17.9, -25.0)),
}
TURN = rotation(np.array([0.3, -1.0, 0.7]), 1.3)


def law(terms="treloar", kappa=KAPPA, **options):
    return nts.Ogden(*TERMS[terms], kappa, RHO, **options)


def power_quotient(x, y, g):
    """(x^g - y^g)/(x - y) of near or equal numbers."""
    if x == y:
        return g * x ** (g - 1)
    return y**g * np.expm1(g * np.log1p((x - y) / y)) / (x - y)


def twin(terms, C, H):
    """Energy, stress, and derivative of the stress along H, by eigenvalues and eigenvectors."""
    x, Q = np.linalg.eigh(C)
    J = np.sqrt(np.prod(x))
    H = Q.T @ H @ Q
    psi, s, shear = SOFT / 2 * (J - 1) ** 2, SOFT * (J - 1) * J / x, np.zeros((3, 3))
    slope = SOFT / 2 * (2 * J - 1) * J / np.outer(x, x) - np.diag(SOFT * (J - 1) * J / x**2)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        shear[i, j] = shear[j, i] = SOFT * (J - 1) * J * power_quotient(x[i], x[j], -1)
    for mu, alpha in zip(*TERMS[terms], strict=True):
        size = J ** (-alpha / 3)
        p = size * x ** (alpha / 2)
        mean = p.mean()
        psi += mu / alpha * (p.sum() - 3)
        s += mu * (p - mean) / x
        by_log = alpha / 2 * (np.diag(p) - np.outer(np.ones(3), p) / 3 - p[:, None] / 3 + mean / 3)
        slope += mu * (by_log / np.outer(x, x) - np.diag((p - mean) / x**2))
        for i, j in ((0, 1), (1, 2), (2, 0)):
            quotient = size * power_quotient(x[i], x[j], alpha / 2 - 1)
            quotient -= mean * power_quotient(x[i], x[j], -1)
            shear[i, j] += mu * quotient
            shear[j, i] = shear[i, j]
    dS = shear * (H - np.diag(np.diag(H))) + np.diag(slope @ np.diag(H))
    return psi, Q @ np.diag(s) @ Q.T, Q @ dS @ Q.T


@pytest.fixture(scope="module")
def evaluated():
    """Energy, stress and its derivative along H by compiled code; compiled once."""
    known = {}

    def at(mesh, terms, C, H):
        if terms not in known:
            numbers = [fem.Constant(mesh, np.eye(3)) for _ in range(2)]
            s, material = ufl.variable(fem.Constant(mesh, 0.0)), law(terms, SOFT)
            S = material.stress(numbers[0] + s * numbers[1])
            dS = ufl.diff(S, s)
            parts = [T[i, j] for T in (S, dS) for i in range(3) for j in range(3)]
            values = ufl.as_vector([material.psi(numbers[0]), *parts])
            known[terms] = numbers, compile_expression(values, np.full((1, 3), 0.25))
        numbers, expression = known[terms]
        numbers[0].value[:], numbers[1].value[:] = C, H
        psi, *parts = expression.eval(mesh, np.zeros(1, dtype=np.int32)).ravel()
        return psi, *np.reshape(parts, (2, 3, 3))

    return at


@pytest.mark.serial
@pytest.mark.parametrize("terms", TERMS)
def test_energy_stress_and_tangent_agree_with_eigenvalues(comm, rng, evaluated, terms):
    mesh, modulus = Box(comm, shape=(1, 1, 1)).mesh, law(terms, SOFT).least_modulus
    near = [0.0, *10.0 ** -np.arange(1.0, 15.0)]
    squares = [np.array([1.0, 1 + d, 1 - 0.3 * d]) for d in near]
    squares += [np.array([1.4, 1.4 * (1 + d), 0.7]) for d in near]
    squares += [np.array([0.7, 0.7 * (1 + d), 1.4]) for d in near]
    # Where the series end, and in pure shear.
    squares += [1 + d * np.array([1, -0.5, -0.5]) for d in (0.0199, 0.0201, -0.0199, -0.0201)]
    squares += [np.array([1.8, 0.8 * (1 + w), 0.8 * (1 - w)]) for w in (0.0316, 0.03163)]
    squares += [np.array([1.5, 1.0, 0.5]), np.array([3.0, 1.0, 1 / 3])]
    squares += list(rng.uniform(0.5, 2.0, (10, 3)))
    for square in squares:
        for Q in (np.eye(3), TURN):
            C = Q @ np.diag(square) @ Q.T
            C, A = (C + C.T) / 2, rng.normal(size=(3, 3))
            found = evaluated(mesh, terms, C, A + A.T)
            for value, expected in zip(found, twin(terms, C, A + A.T), strict=True):
                size = modulus + np.abs(expected).max()
                np.testing.assert_allclose(value, expected, rtol=0, atol=5e2 * EPS * size)


@pytest.mark.serial
def test_even_powers_are_the_mooney_rivlin_law(at, rng):
    ogden = nts.Ogden((160.0, -60.0), (2.0, -2.0), KAPPA, RHO)
    mooney = nts.MooneyRivlin(80.0, 30.0, KAPPA, RHO)
    np.testing.assert_allclose(ogden.moduli, mooney.moduli, atol=1e3 * EPS * KAPPA)
    assert ogden.poisson_ratio == pytest.approx(mooney.poisson_ratio)
    assert ogden.least_modulus == pytest.approx(440.0)

    def values(material):
        def of(C):
            S = [material.stress(C), material.linear_stress(C - ufl.Identity(3))]
            parts = [T[i, j] for T in S for i in range(3) for j in range(3)]
            return ufl.as_vector([material.psi(C), *parts])

        return at(of)

    first, second = values(ogden), values(mooney)
    for _ in range(10):
        Q = rotation(rng.normal(size=3), rng.uniform(0, 3))
        C = Q @ np.diag(rng.uniform(0.6, 1.6, 3) ** 2) @ Q.T
        np.testing.assert_allclose(first(C), second(C), rtol=0, atol=1e2 * EPS * KAPPA)


@pytest.mark.serial
@pytest.mark.parametrize("terms", ["treloar", "steep"])
@pytest.mark.parametrize("size", [0.3, 1e-2, 1e-5, 1e-9, 0.0])
def test_conserving_stress_has_the_work_of_the_energy(comm, rng, size, terms):
    material = law(terms)
    mesh = Box(comm, shape=(1, 1, 1)).mesh
    C_n, C = (fem.Constant(mesh, np.eye(3)) for _ in range(2))
    S = material.conserving_stress(C_n, C)
    parts = [S[i, j] for i in range(3) for j in range(3)]
    values = ufl.as_vector([*parts, material.psi(C_n), material.psi(C)])
    expression = compile_expression(values, np.full((1, 3), 0.25))
    for _ in range(20):
        A, B = (M + M.T for M in rng.normal(size=(2, 3, 3)))
        mean = np.eye(3) + 0.3 * size * A
        C_n.value[:], C.value[:] = mean - size * B / 6, mean + size * B / 6
        if min(np.linalg.eigvalsh(T.value).min() for T in (C_n, C)) < 0.2:
            continue
        *S, psi_n, psi = expression.eval(mesh, np.zeros(1, dtype=np.int32)).ravel()
        work = np.vdot(S, C.value - C_n.value) / 2
        assert abs(work - psi + psi_n) <= 1e2 * EPS * KAPPA * (1 + abs(psi / KAPPA))
        if size == 0.0:
            assert np.abs(S).max() <= 1e2 * EPS * KAPPA


def closed_form(stretch, pulled, kappa):
    """Nominal stress along the pulled axes of a compressible block whose other sides are free."""

    def stress(free):
        stretches = np.array([stretch] * pulled + [free] * (3 - pulled))
        J = np.prod(stretches)
        P = kappa * (J - 1) * J / stretches
        for mu, alpha in zip(*TRELOAR, strict=True):
            p = (stretches / np.cbrt(J)) ** alpha
            P += mu * (p - p.mean()) / stretches
        return P

    without_volume = stretch ** (-pulled / (3 - pulled))
    free = brentq(lambda x: stress(x)[2], 0.95 * without_volume, 1.05 * without_volume, xtol=1e-15)
    return stress(free)[0]


@pytest.mark.serial
@pytest.mark.parametrize(("pulled", "end"), [(1, 4.0), (2, 2.0)], ids=["uniaxial", "equibiaxial"])
def test_a_block_of_treloars_rubber_is_pulled_with_the_force_of_the_closed_form(comm, pulled, end):
    mu = np.dot(*TRELOAR) / 2
    kappa = 2 * mu * 1.499 / (3 * 0.002)
    material = law(kappa=kappa)
    assert material.poisson_ratio == pytest.approx(0.499)
    assert material.one_point == {"kappa"}
    box = Box(comm, material=material, shape=(2, 1, 1), size=(1.0, 1.0, 1.0))
    zero, along = (fem.Constant(box.mesh, 0.0) for _ in range(2))

    def held(axis, place, value):
        space = box.V.sub(axis)
        facets = locate_entities_boundary(box.mesh, 2, lambda x: np.isclose(x[axis], place))
        return fem.dirichletbc(value, fem.locate_dofs_topological(space, 2, facets), space)

    bcs = [held(axis, 0.0, zero) for axis in range(3)]
    bcs += [held(axis, 1.0, along) for axis in range(pulled)]

    def update(t):
        along.value = t

    stepper = nts.QuasiStatic([box.body], dt=0.1, bcs=bcs, update=update)
    for step in stepper.run(end - 1):
        stretch = 1 + stepper.t
        force = step.reactions[3].force[0]
        assert force == pytest.approx(closed_form(stretch, pulled, kappa), rel=1e-8)
        # Ogden (1972): of a rubber that keeps its volume.
        across = -pulled / (3 - pulled)
        expected = sum(
            mu * (stretch ** (alpha - 1) - stretch ** (across * alpha - 1))
            for mu, alpha in zip(*TRELOAR, strict=True)
        )
        assert force == pytest.approx(expected, rel=0.01)
    assert stretch == pytest.approx(end)


@pytest.mark.parametrize(
    # Kernels of tetrahedra, which have one point, are sooner compiled.
    ("scheme", "cell"),
    [
        (nts.EnergyMomentum, "hexahedron"),
        once(nts.Midpoint, "tetrahedron"),
        once(nts.GeneralizedAlpha, "tetrahedron"),
    ],
)
def test_a_body_flies_with_its_energy_and_momenta(comm, scheme, cell):
    box = Box(comm, cell, nts.Ogden((400.0, 5.0, -50.0), (1.3, 5.0, -2.0), KAPPA, RHO))
    stepper = scheme([box.body], dt=0.03)
    stepper.set_velocity(box.body, swirl)
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
def test_explicit_steps_agree_with_the_mooney_rivlin_law(comm):
    results = []
    for material in (
        nts.Ogden((160.0, -60.0), (2.0, -2.0), KAPPA, RHO),
        nts.MooneyRivlin(80.0, 30.0, KAPPA, RHO),
    ):
        box = Box(comm, material=material)
        stepper = nts.CentralDifference([box.body], dt=0.004)
        stepper.set_velocity(box.body, swirl)
        for _ in range(20):
            stepper.advance()
        results.append(box.positions(stepper))
    np.testing.assert_allclose(*results, rtol=0, atol=1e5 * EPS)


@pytest.mark.serial
@pytest.mark.parametrize("kind", ["plane strain", "axisymmetric"])
def test_impact_in_two_dimensions_conserves_energy(kind):
    material = nts.Ogden((3.0e4,), (2.7,), 2.0e5, 1.0e3)
    if kind == "plane strain":
        scene = plane.blocks(angle=0.4, material=material)
        pairs, bodies = (
            [
                nts.ContactPair(
                    scene.nodes,
                    scene.segments,
                    enforcement=nts.LagrangeMultiplier(),
                    method="node-to-segment",
                )
            ],
            scene[1:3],
        )
        stepper = nts.EnergyMomentum(bodies, pairs, dt=0.01)
        plane.throw(scene, stepper)
    else:
        scene = rings.ball_on_plate(material=material)
        stepper = nts.EnergyMomentum(scene.bodies, scene.pairs(), dt=0.002)
        stepper.set_velocity(scene.ball, (0.0, -3.0))
    diagnostics = nts.Diagnostics(stepper)
    start, touched = diagnostics.balance().total_energy, 0
    for _ in range(12):
        touched = max(touched, stepper.advance().num_active)
        assert abs(diagnostics.balance().total_energy - start) < 1e-10 * start
    assert touched


@pytest.mark.serial
def test_impossible_terms_are_refused():
    with pytest.raises(TypeError, match=r"mu as a sequence of numbers, given 3\.0"):
        nts.Ogden(3.0, (2.0,), 1.0, 1.0)
    with pytest.raises(TypeError, match="expected a number for alpha, given 'x'"):
        nts.Ogden((3.0,), ("x",), 1.0, 1.0)
    for mu, alpha in (((), ()), ((1.0,), (1.0, 2.0))):
        with pytest.raises(ValueError, match="as many mu as alpha, at least one, given"):
            nts.Ogden(mu, alpha, 1.0, 1.0)
    with pytest.raises(ValueError, match=r"alpha other than 0, given \(2.0, 0.0\)"):
        nts.Ogden((1.0, 1.0), (2.0, 0.0), 1.0, 1.0)
    with pytest.raises(ValueError, match=r"shear modulus sum\(mu \* alpha\) / 2 > 0, given -1"):
        nts.Ogden((1.0,), (-2.0,), 1.0, 1.0)
    with pytest.raises(ValueError, match="kappa > 0, given 0"):
        nts.Ogden((1.0,), (2.0,), 0.0, 1.0)
    with pytest.raises(ValueError, match=r"linear in its parameters for one_point, .*'alpha_1'"):
        law(one_point=("alpha_1",))
    with pytest.raises(ValueError, match="thickness has a closed form, given Ogden"):
        nts.PlaneStress(law())
    assert "mu=(6.3, 0.012, -0.1), alpha=(1.3, 5.0, -2.0), kappa=2000" in repr(law())
