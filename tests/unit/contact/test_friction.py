"""Coulomb's law: cone, direction, dissipation, transport of tractions."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.contact.friction.limits import Limits
from dolfinx_nts.contact.friction.traction import exact_model, spring_model, transport
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


DT = 0.1
LAWS = {
    "Coulomb": nts.Coulomb(MU),
    "Stribeck": nts.Stribeck(MU, MU / 2, speed=3.0, viscous=0.02, power=1.5),
    "slip weakening": nts.SlipWeakening(MU, MU / 3, length=0.4),
    "capped": nts.Tresca(nts.Stribeck(MU, MU / 2, speed=3.0), stress=0.3),
}


def limits(m, law=LAWS["Coulomb"], dt=DT):
    """Limits at m nodes with areas from 0.5 to 2 m^2, which have slipped by up to 0.1 m."""
    area, slipped = np.geomspace(0.5, 2.0, m), np.linspace(0.0, 0.1, m)
    return Limits(law, None, dt, lambda: area, slipped)


def limit_at(p, slip=None, law=LAWS["Coulomb"]):
    return limits(len(p), law).at(np.arange(len(p), dtype=np.int32), p, slip)


def slides(trial, travel, p, heading, sliding):
    return _kernels.slides(limit_at(p).force, trial, travel, heading, sliding)


def exact(t, slip, p, c, heading, sliding, law=LAWS["Coulomb"]):
    limit = limit_at(p, np.linalg.norm(slip, axis=1), law)
    return exact_model(limit, t, slip, p, c, heading, sliding)


def spring(t_n, slip, p, eps, law=LAWS["Coulomb"], slid=None):
    """Return the tractions of the spring law, and the sliding nodes."""
    trial, node = t_n + eps[:, None] * slip, np.arange(len(p), dtype=np.int32)
    size, never = np.linalg.norm(trial, axis=1), np.zeros(len(p), dtype=bool)
    judged, limit = limits(len(p), law).of_springs(
        node, p, size, eps, never if slid is None else slid
    )
    sliding = _kernels.slides(judged.force, trial, trial, trial, never)
    return spring_model(limit, trial, p, eps, trial, sliding), sliding


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


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("is_slow", [False, True])
def test_stiffness_of_the_spring_is_the_derivative_by_the_slip(rng, law, is_slow):
    t_n, slip, p, eps = sample(rng)
    # Far from the kink, and below the cap, so that no step of the test crosses it.
    least = np.minimum(MU * p, 0.15)
    trial = np.linalg.norm(t_n + eps[:, None] * slip, axis=1)
    chosen = trial < 0.5 * least if is_slow else trial > 1.5 * MU * p
    t_n, slip, p, eps = (a[chosen] for a in (t_n, slip, p, eps))
    d = 0.02 * rng.normal(size=slip.shape) / eps[:, None] * np.minimum(p, 1.0)[:, None]
    slope = np.einsum("mij,mj->mi", spring(t_n, slip, p, eps, law)[0].stiffness, d)

    def function(g):
        return traction(spring(t_n, g, p, eps, law)[0], p)

    if not is_slow:
        assert taylor_order(function, slip, d, slope) > 1.9
    else:
        np.testing.assert_allclose(function(slip + d) - function(slip), slope, atol=ROUNDING)


def test_spring_that_turned_back_while_sliding_sticks_first(rng):
    t_n, slip, p, eps = sample(rng)
    every = np.ones(len(p), dtype=bool)
    trial = t_n + 1e3 * eps[:, None] * slip
    assert not slides(trial, trial, p, -trial, every).any()
    # A node that has to keep sliding keeps its direction, without stiffness.
    model = spring_model(limit_at(p), trial, p, eps, -trial, every)
    ahead = -MU * p[:, None] * trial / np.linalg.norm(trial, axis=1)[:, None]
    np.testing.assert_allclose(traction(model, p), ahead, rtol=1e2 * ROUNDING)
    assert np.all(model.stiffness == 0)


def test_solutions_of_the_exact_law_are_fixed_points(rng):
    _, slip, p, c = sample(rng)
    every = np.ones(len(p), dtype=bool)
    sliding = MU * p[:, None] * slip / np.linalg.norm(slip, axis=1)[:, None]
    assert slides(sliding + c[:, None] * slip, slip, p, sliding, every).all()
    model = exact(sliding, slip, p, c, sliding, every)
    np.testing.assert_allclose(traction(model, p), sliding, atol=1e3 * ROUNDING)
    for before in (every, ~every):
        assert not slides(0.9 * sliding, 0 * slip, p, sliding, before).any()


def test_exact_law_turns_a_traction_towards_the_slip(rng):
    # The linear model is Newton's: from a nearby traction, one iteration
    # at fixed slip and pressing force leaves an error of second order.
    _, slip, p, c = sample(rng)
    every = np.ones(len(p), dtype=bool)
    solution = MU * p[:, None] * slip / np.linalg.norm(slip, axis=1)[:, None]
    wrong = p[:, None] * rng.normal(size=slip.shape)

    def error(h):
        t = solution + h * wrong
        return np.abs(traction(exact(t, slip, p, c, t, every), p) - solution).max()

    assert np.log2(error(2e-3) / error(1e-3)) > 1.9


def test_slip_does_not_reverse_in_one_iteration(rng):
    # A node that slides against its traction sticks first, whatever the slip.
    _, slip, p, c = sample(rng)
    every = np.ones(len(p), dtype=bool)
    t = -MU * p[:, None] * slip / np.linalg.norm(slip, axis=1)[:, None]
    far = t + 1e3 * c[:, None] * slip
    assert not slides(far, slip, p, t, every).any()
    assert np.array_equal(slides(far, slip, p, t, ~every), np.linalg.norm(far, axis=1) > MU * p)
    # A node that has to keep sliding keeps its direction, without stiffness.
    model = exact(t, slip, p, c, t, every)
    np.testing.assert_allclose(traction(model, p), t, rtol=1e2 * ROUNDING)
    assert np.all(model.stiffness == 0)


def test_direction_of_a_node_that_is_pulled_does_not_turn(rng):
    _, slip, p, c = sample(rng)
    every = np.ones(len(p), dtype=bool)
    heading = rng.normal(size=slip.shape)
    # At p < 0 a traction points against the heading.
    model = exact(-heading, slip, -p, c, heading, every)
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


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_derivatives_of_limits_are_derivatives(rng, law):
    p, slip, dp, ds = rng.uniform(0.1, 2.0, (4, 50))
    p[:] = np.where(np.arange(50) % 2, 0.3 * p, 3 + p)  # below and above the cap
    of, after = limit_at(p, slip, law), limit_at(p + 0.1 * dp, slip, law)
    np.testing.assert_allclose(after.force - of.force, 0.1 * of.by_p * dp, atol=1e2 * ROUNDING)
    if law.depends_on_slip:
        slope = 0.1 * of.by_slip * ds
        assert taylor_order(lambda s: limit_at(p, s, law).force, slip, 0.1 * ds, slope) > 1.9
    else:
        assert not of.by_slip.any()


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_slip_of_springs_that_lasts_has_the_limit_of_its_speed(rng, law):
    t_n, slip, p, eps = sample(rng)
    model, sliding = spring(t_n, slip, p, eps, law)
    t = traction(model, p)
    lasting = slip - (t - t_n) / eps[:, None]
    length, size = np.linalg.norm(lasting, axis=1), np.linalg.norm(t, axis=1)
    expected = limit_at(p, length, law).force
    np.testing.assert_allclose(size[sliding], expected[sliding], rtol=1e3 * ROUNDING)
    assert np.all(length[~sliding] <= ROUNDING)
    # It dissipates.
    stored = (np.sum(t**2, axis=1) - np.sum(t_n**2, axis=1)) / (2 * eps)
    assert np.all(np.sum(t * slip, axis=1) - stored >= -1e2 * ROUNDING)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_model_of_the_exact_law_is_its_derivative(rng, law):
    """By the slip and by the normal force, at a solution that slides."""
    _, slip, p, c = sample(rng)
    p[:] = np.where(np.arange(len(p)) % 2, p, 10 + p)  # below and above the cap
    every = np.ones(len(p), dtype=bool)

    def solution(g, pressing):
        length = np.linalg.norm(g, axis=1)
        return (limit_at(pressing, length, law).force / length)[:, None] * g

    t = solution(slip, p)
    model = exact(t, slip, p, 1e-3 * c, t, every, law)
    np.testing.assert_allclose(traction(model, p), t, atol=1e3 * ROUNDING)
    d, dp = 1e-3 * rng.normal(size=slip.shape), 1e-3 * rng.normal(size=p.shape)
    # A small weight has the whole stiffness across the slip only in the limit.
    s = t / np.linalg.norm(t, axis=1)[:, None]
    d = np.einsum("mi,mi->m", s, d)[:, None] * s
    slope = np.einsum("mij,mj->mi", model.stiffness, d)
    if law.depends_on_slip:
        assert taylor_order(lambda g: solution(g, p), slip, d, slope) > 1.9
    else:
        np.testing.assert_allclose(slope, 0.0, atol=ROUNDING)
    change = solution(slip, p + dp) - t
    np.testing.assert_allclose(change, dp[:, None] * model.direction, atol=1e2 * ROUNDING)


@pytest.mark.parametrize("speed", [0.0, 1e-5])
def test_spring_that_slid_slides_on_where_a_falling_limit_lets_it(rng, speed):
    """Its trial traction is between both limits."""
    law, m = nts.Stribeck(MU, MU / 2, speed=speed), 50
    t_n, p, eps = rng.normal(size=(m, 2)), rng.uniform(0.1, 2, m), rng.uniform(0.5, 20, m)
    t_n *= (0.75 * MU * p / np.linalg.norm(t_n, axis=1))[:, None]
    slid = np.arange(m) % 2 == 0
    model, sliding = spring(t_n, 0 * t_n, p, eps, law, slid)
    np.testing.assert_array_equal(sliding, slid)
    t = np.where(slid[:, None], 2 / 3 * t_n, t_n)
    np.testing.assert_allclose(traction(model, p), t, atol=1e3 * ROUNDING)
    # Below the kinetic limit all stick.
    assert not spring(0.6 * t_n, 0 * t_n, p, eps, law, slid)[1].any()


def test_limit_below_zero_is_refused():
    class Wrong(nts.FrictionLaw):
        def limit(self, p, slip, dt, nodes):
            return -p, -1.0, 0.0

    with pytest.raises(ValueError, match=r"limits of friction >= 0 from Wrong\(\), given -2"):
        limit_at(np.array([1.0, 2.0]), law=Wrong())


def test_numbers_of_other_laws_are_checked():
    with pytest.raises(ValueError, match="power >= 1"):
        nts.Stribeck(0.3, 0.2, 1.0, power=0.5)
    with pytest.raises(ValueError, match="speed of the decay of friction >= 0"):
        nts.Stribeck(0.3, 0.2, -1.0)
    with pytest.raises(ValueError, match="kinetic coefficient of friction >= 0"):
        nts.SlipWeakening(0.3, -0.2, 1.0)
    with pytest.raises(ValueError, match="shear stress >= 0"):
        nts.Tresca(0.3, -1.0)
    with pytest.raises(TypeError, match=r"Coulomb\(mu\) or another law as friction, given str"):
        nts.Tresca("rough", 1.0)


@pytest.mark.parametrize("mu", [-0.1, np.nan, np.inf])
def test_invalid_coefficient_of_friction_is_refused(mu):
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


def test_multipliers_of_singular_systems_are_nan(rng):
    normal, force = rng.normal(size=(2, 1, 3))
    none, rank = np.zeros((2, 1, 2)), np.array([3], dtype=np.int32)
    assert np.isnan(_kernels.balance(normal, force, np.ones((1, 3, 3)), rank, *none)).all()
    with pytest.raises(ValueError, match="the node of each pair"):
        _kernels.balance(normal, force, np.ones((1, 3, 2)), rank, *none)
