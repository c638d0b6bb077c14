"""Coulomb's law: cone, direction, dissipation, transport of tractions."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.contact.friction import transport
from reference.bulk import rotation, taylor_order

pytestmark = pytest.mark.serial

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


def spring(t_n, slip, p, eps):
    """Return the solution of the spring's law, and who slides."""
    law, trial = nts.Coulomb(MU), t_n + eps[:, None] * slip
    sliding = law.slides(trial, trial, p, trial, np.zeros(len(p), dtype=bool))
    return law.spring(trial, p, eps, trial, sliding), sliding


def test_spring_traction_stays_in_the_cone_and_slides_on_its_boundary(rng):
    t_n, slip, p, eps = sample(rng)
    model, sliding = spring(t_n, slip, p, eps)
    size = np.linalg.norm(traction(model, p), axis=1)
    assert 0 < sliding.sum() < len(p)
    assert np.all(size <= MU * p * (1 + ROUNDING))
    np.testing.assert_allclose(size[sliding], MU * p[sliding], rtol=ROUNDING)


def test_spring_that_sticks_is_linear_in_the_slip(rng):
    t_n, slip, p, eps = sample(rng)
    model, sliding = spring(t_n, slip, p, eps)
    np.testing.assert_allclose(
        traction(model, p)[~sliding], (t_n + eps[:, None] * slip)[~sliding], rtol=ROUNDING
    )


def test_spring_never_gives_energy(rng):
    # Work of the end traction less the change of |t|^2 / (2 eps).
    t_n, slip, p, eps = sample(rng)
    t = traction(spring(t_n, slip, p, eps)[0], p)
    stored = (np.sum(t**2, axis=1) - np.sum(t_n**2, axis=1)) / (2 * eps)
    assert np.all(np.sum(t * slip, axis=1) - stored >= -ROUNDING)


@pytest.mark.parametrize("slides", [True, False])
def test_stiffness_of_the_spring_is_the_derivative_by_the_slip(rng, slides):
    t_n, slip, p, eps = sample(rng)
    trial = np.linalg.norm(t_n + eps[:, None] * slip, axis=1) / (MU * p)
    # Far from the kink, so that no step of the test crosses it.
    chosen = trial > 1.5 if slides else trial < 0.5
    t_n, slip, p, eps = (a[chosen] for a in (t_n, slip, p, eps))
    d = 0.1 * rng.normal(size=slip.shape) / eps[:, None] * p[:, None]
    slope = np.einsum("mij,mj->mi", spring(t_n, slip, p, eps)[0].stiffness, d)

    def function(g):
        return traction(spring(t_n, g, p, eps)[0], p)

    if slides:
        assert taylor_order(function, slip, d, slope) > 1.9
    else:
        np.testing.assert_allclose(function(slip + d) - function(slip), slope, atol=ROUNDING)


def test_spring_that_turned_back_while_sliding_sticks_first(rng):
    t_n, slip, p, eps = sample(rng)
    law, every = nts.Coulomb(MU), np.ones(len(p), dtype=bool)
    trial = t_n + 1e3 * eps[:, None] * slip
    assert not law.slides(trial, trial, p, -trial, every).any()
    # One that has to go on sliding has the direction of before, and no stiffness.
    model = law.spring(trial, p, eps, -trial, every)
    ahead = -MU * p[:, None] * trial / np.linalg.norm(trial, axis=1)[:, None]
    np.testing.assert_allclose(traction(model, p), ahead, rtol=1e2 * ROUNDING)
    assert np.all(model.stiffness == 0)


def test_solutions_of_the_exact_law_are_fixed_points(rng):
    _, slip, p, c = sample(rng)
    law, every = nts.Coulomb(MU), np.ones(len(p), dtype=bool)
    sliding = MU * p[:, None] * slip / np.linalg.norm(slip, axis=1)[:, None]
    assert law.slides(sliding + c[:, None] * slip, slip, p, sliding, every).all()
    model = law.exact(sliding, slip, p, c, sliding, every)
    np.testing.assert_allclose(traction(model, p), sliding, atol=1e3 * ROUNDING)
    for before in (every, ~every):
        assert not law.slides(0.9 * sliding, 0 * slip, p, sliding, before).any()


def test_exact_law_turns_a_traction_towards_the_slip(rng):
    # The linear model is Newton's: from a nearby traction, one iteration
    # at fixed slip and pressing force leaves an error of second order.
    _, slip, p, c = sample(rng)
    law, every = nts.Coulomb(MU), np.ones(len(p), dtype=bool)
    solution = MU * p[:, None] * slip / np.linalg.norm(slip, axis=1)[:, None]
    wrong = p[:, None] * rng.normal(size=slip.shape)

    def error(h):
        t = solution + h * wrong
        return np.abs(traction(law.exact(t, slip, p, c, t, every), p) - solution).max()

    assert np.log2(error(2e-3) / error(1e-3)) > 1.9


def test_slip_does_not_reverse_in_one_iteration(rng):
    # However far a node slides against its traction, it sticks first.
    _, slip, p, c = sample(rng)
    law, every = nts.Coulomb(MU), np.ones(len(p), dtype=bool)
    t = -MU * p[:, None] * slip / np.linalg.norm(slip, axis=1)[:, None]
    far = t + 1e3 * c[:, None] * slip
    assert not law.slides(far, slip, p, t, every).any()
    assert np.array_equal(law.slides(far, slip, p, t, ~every), np.linalg.norm(far, axis=1) > MU * p)
    # One that has to go on sliding has the direction of before, and no stiffness.
    model = law.exact(t, slip, p, c, t, every)
    np.testing.assert_allclose(traction(model, p), t, rtol=1e2 * ROUNDING)
    assert np.all(model.stiffness == 0)


def test_direction_of_a_node_that_is_pulled_does_not_turn(rng):
    _, slip, p, c = sample(rng)
    law, every = nts.Coulomb(MU), np.ones(len(p), dtype=bool)
    heading = rng.normal(size=slip.shape)
    # At p < 0 a traction points against the heading.
    model = law.exact(-heading, slip, -p, c, heading, every)
    unit = heading / np.linalg.norm(heading, axis=1)[:, None]
    np.testing.assert_allclose(model.direction, MU * unit, rtol=ROUNDING)


def test_without_pressing_force_there_is_no_traction(rng):
    t_n, slip, p, eps = sample(rng)
    model, sliding = spring(t_n, slip, 0 * p, eps)
    assert sliding.all()
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


@pytest.mark.parametrize("components", [2, 3])
def test_multipliers_balance_forces_and_tractions_at_the_nodes(rng, components):
    m = 9
    normal, force = rng.normal(size=(2, m, 3))
    columns, known, direction = (rng.normal(size=(m, *s)) for s in ((3, 12), (2,), (2,)))
    columns[:, 0, :3] += 5 * normal
    rank = np.resize([0, 1, components], m).astype(np.int32)
    sticks = rank > 1
    known[sticks] = direction[sticks] = 0
    columns[0, 0, :3] = np.einsum("i,ij->j", direction[0], columns[0, 1:, :3])  # no response
    multipliers = _kernels.balance(normal, force, columns, rank, known, direction)
    pressing = -multipliers[:, :1]
    traction = np.where(sticks[:, None], multipliers[:, 1:], known + pressing * direction)
    own = columns[:, :, :3]
    total = force + multipliers[:, :1] * own[:, 0]
    total += np.einsum("mi,mij->mj", traction, own[:, 1:])
    along = np.einsum("mi,mi->m", normal, total)
    assert multipliers[0, 0] == 0 and abs(along[0]) > 1e-3
    np.testing.assert_allclose(along[1:][~sticks[1:]], 0, atol=ROUNDING)
    np.testing.assert_allclose(total[sticks, :components], 0, atol=ROUNDING)
    assert np.all(multipliers[sticks, components:] == 0)


def test_multipliers_of_singular_systems_are_no_numbers(rng):
    normal, force = rng.normal(size=(2, 1, 3))
    none, rank = np.zeros((2, 1, 2)), np.array([3], dtype=np.int32)
    assert np.isnan(_kernels.balance(normal, force, np.ones((1, 3, 3)), rank, *none)).all()
    with pytest.raises(ValueError, match="the node of each pair"):
        _kernels.balance(normal, force, np.ones((1, 3, 2)), rank, *none)
