"""Coulomb's law: cone, direction, dissipation, transport of tractions."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.friction import transport
from reference.bulk import rotation, taylor_order

ROUNDING = 1e2 * np.finfo(float).eps
MU = 0.4


def sample(rng, m=200):
    """Return stored traction inside the cone, slip, pressing force, stiffness."""
    p = rng.uniform(0.1, 2, m)
    t_n = rng.normal(size=(m, 2))
    t_n *= (rng.uniform(0, 1, m) * MU * p / np.linalg.norm(t_n, axis=1))[:, None]
    return t_n, 0.2 * rng.normal(size=(m, 2)), p, rng.uniform(0.5, 20, m)


def traction(model, p):
    return model.explicit + p[:, None] * model.direction


def test_spring_traction_stays_in_the_cone_and_slides_on_its_boundary(rng):
    t_n, slip, p, eps = sample(rng)
    model = nts.Coulomb(MU).spring(t_n, slip, p, eps)
    size = np.linalg.norm(traction(model, p), axis=1)
    assert 0 < model.sliding.sum() < len(p)
    assert np.all(size <= MU * p * (1 + ROUNDING))
    np.testing.assert_allclose(size[model.sliding], MU * p[model.sliding], rtol=ROUNDING)


def test_spring_that_sticks_is_linear_in_the_slip(rng):
    t_n, slip, p, eps = sample(rng)
    model = nts.Coulomb(MU).spring(t_n, slip, p, eps)
    stick = ~model.sliding
    np.testing.assert_allclose(
        traction(model, p)[stick], (t_n + eps[:, None] * slip)[stick], rtol=ROUNDING
    )


def test_spring_never_gives_energy(rng):
    # Work of the end traction less the change of |t|^2 / (2 eps).
    t_n, slip, p, eps = sample(rng)
    t = traction(nts.Coulomb(MU).spring(t_n, slip, p, eps), p)
    stored = (np.sum(t**2, axis=1) - np.sum(t_n**2, axis=1)) / (2 * eps)
    assert np.all(np.sum(t * slip, axis=1) - stored >= -ROUNDING)


@pytest.mark.parametrize("slides", [True, False])
def test_stiffness_of_the_spring_is_the_derivative_by_the_slip(rng, slides):
    t_n, slip, p, eps = sample(rng)
    law = nts.Coulomb(MU)
    trial = np.linalg.norm(t_n + eps[:, None] * slip, axis=1) / (MU * p)
    # Far from the kink, so that no step of the test crosses it.
    chosen = trial > 1.5 if slides else trial < 0.5
    t_n, slip, p, eps = (a[chosen] for a in (t_n, slip, p, eps))
    d = 0.1 * rng.normal(size=slip.shape) / eps[:, None] * p[:, None]
    slope = np.einsum("mij,mj->mi", law.spring(t_n, slip, p, eps).stiffness, d)

    def function(g):
        return traction(law.spring(t_n, g, p, eps), p)

    if slides:
        assert taylor_order(function, slip, d, slope) > 1.9
    else:
        np.testing.assert_allclose(function(slip + d) - function(slip), slope, atol=ROUNDING)


def test_solutions_of_the_exact_law_are_fixed_points(rng):
    _, slip, p, c = sample(rng)
    law = nts.Coulomb(MU)
    sliding = MU * p[:, None] * slip / np.linalg.norm(slip, axis=1)[:, None]
    model = law.exact(sliding, slip, p, c)
    assert model.sliding.all()
    np.testing.assert_allclose(traction(model, p), sliding, atol=1e3 * ROUNDING)
    sticking = 0.9 * sliding
    assert not law.exact(sticking, np.zeros_like(slip), p, c).sliding.any()


def test_exact_law_turns_a_traction_towards_the_slip(rng):
    # The linear model is Newton's: from a nearby traction, one iteration
    # at fixed slip and pressing force leaves an error of second order.
    _, slip, p, c = sample(rng)
    law = nts.Coulomb(MU)
    solution = MU * p[:, None] * slip / np.linalg.norm(slip, axis=1)[:, None]
    wrong = p[:, None] * rng.normal(size=slip.shape)
    errors = [
        np.abs(traction(law.exact(solution + h * wrong, slip, p, c), p) - solution).max()
        for h in (2e-3, 1e-3)
    ]
    free = law.exact(solution, slip, p, c).stiffness[:, 0, 0] / c
    assert free.max() < 100  # none at the bound on the stiffness
    assert np.log2(errors[0] / errors[1]) > 1.9


def test_without_pressing_force_there_is_no_traction(rng):
    t_n, slip, p, eps = sample(rng)
    model = nts.Coulomb(MU).spring(t_n, slip, 0 * p, eps)
    assert np.all(traction(model, 0 * p) == 0)


def test_transport_turns_with_the_normal_and_keeps_the_length(rng):
    old = rng.normal(size=(20, 3))
    old /= np.linalg.norm(old, axis=1)[:, None]
    axis = np.cross(old, rng.normal(size=old.shape))
    turns = np.array(
        [rotation(a, angle) for a, angle in zip(axis, np.linspace(0, 2.5, 20), strict=True)]
    )
    new = np.einsum("mij,mj->mi", turns, old)
    vector = np.cross(old, rng.normal(size=old.shape))
    first = np.cross(new, rng.normal(size=old.shape))
    first /= np.linalg.norm(first, axis=1)[:, None]
    frame = np.stack([first, np.cross(new, first)], axis=1)
    components = transport(vector, old, frame, new)
    # The axis is normal to both normals: this is the smallest rotation.
    expected = np.einsum("mij,mjk,mk->mi", frame, turns, vector)
    np.testing.assert_allclose(components, expected, atol=1e3 * ROUNDING)


@pytest.mark.parametrize("mu", [-0.1, np.nan, np.inf])
def test_coefficient_that_is_no_coefficient_is_refused(mu):
    with pytest.raises(ValueError, match=rf"mu >= 0, given {mu}"):
        nts.Coulomb(mu)


@pytest.mark.parametrize("eps_T", [0.0, -1.0, np.nan])
def test_spring_without_positive_stiffness_is_refused(eps_T):
    with pytest.raises(ValueError, match=rf"eps_T > 0, given {eps_T}"):
        nts.Coulomb(0.3, eps_T)
