"""Schemes of users: mistakes that are found when a stepper is made."""

from functools import partial

import numpy as np
import pytest
import ufl

import dolfinx_nts as nts
from helpers.models.boxed import Box

pytestmark = pytest.mark.serial


def stress(material, parameters, F_n, F):
    """Stress at the end of a step."""
    return F * material.stress(F.T * F, **parameters)


RATES = partial(nts.NewmarkRates, nts.Newmark(0.0, 0.0, 0.25, 0.5))
ARGUMENTS = {"contact": "static", "stress": stress, "rates": RATES}
ARGUMENTS |= {"stress_share": 1.0, "load_point": 1.0}


@pytest.fixture
def box(comm):
    return Box(comm, shape=(1, 1, 1))


def stepper_of(box, **options):
    """Stepper of the box with a scheme of these arguments."""

    class Own(nts.ImplicitStepper):
        scheme = nts.Scheme(**ARGUMENTS | options)

    return Own([box.body], dt=0.1)


def test_right_scheme_is_accepted(box):
    assert stepper_of(box).advance().newton_iterations >= 0


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"contact": "end"}, "one of 'conserving', 'midpoint', 'static', given 'end'"),
        ({"loads_at": "start"}, "expected loads_at of a Scheme to be one of 'mean', 'end'"),
        ({"stress_share": 2.0}, "expected stress_share of a Scheme from 0 to 1, given 2"),
        ({"load_point": "end"}, "expected a number for load_point of a Scheme, given 'end'"),
        ({"rates": nts.Newmark(0.0, 0.0, 0.25, 0.5)}, "expected a function as rates .* Newmark"),
        ({"rates": nts.NewmarkRates}, r"expected rates\(state, dt, bodies\) .* given \(parameters"),
        ({"rates": lambda *_: None}, "expected rates of the Scheme that return Rates"),
        ({"rates": partial(nts.NewmarkRates, 0.25)}, "given float as parameters"),
        ({"stress": lambda m, F_n, F: F}, r"expected stress\(material, parameters, F_n, F\)"),
        ({"stress": lambda *_: None}, r"tensor of shape \(3, 3\), given NoneType"),
        ({"stress": lambda m, p, F_n, F: ufl.tr(F)}, r"tensor of shape \(3, 3\), given \(\)"),
        (
            {"stress": lambda m, p, F_n, F: m.stress(F.T * F, **p)},
            r"expected the first Piola-Kirchhoff stress F S\(F\^T F\)",
        ),
        (
            {"stress": lambda *arguments: -stress(*arguments)},
            r"expected the first Piola-Kirchhoff stress F S\(F\^T F\)",
        ),
        (
            {"stress": lambda m, p, F_n, F: F * m.stress(F.T * F)},
            r"depends on its argument parameters, .* write material\.stress\(C, \*\*parameters\)",
        ),
        ({"contact": "midpoint"}, "expected contact 'static' .* given 'midpoint', .* first order"),
        ({"contact": "conserving"}, "expected contact 'static' .* given 'conserving'"),
        ({"load_point": 0.5}, "expected load_point of the Scheme to be 1.*given 0.5.*first order"),
        ({"stress_share": 0.5}, "weight of the end of the step in its stress, .* given 0.5"),
        (
            {"stress_share": 0.8, "rates": nts.Midpoint.scheme.rates},
            r"weight of the end of the step in its stress, which is 1\.000, given 0\.8",
        ),
        (
            {"rates": nts.Midpoint.scheme.rates},
            r"expected stress_share of the Scheme to be 0\.5, .* given 1: .* first order",
        ),
    ],
)
def test_wrong_argument_is_named(box, option, message):
    with pytest.raises((TypeError, ValueError), match=message):
        stepper_of(box, **option)


def test_parameters_of_newmark_are_checked():
    with pytest.raises(ValueError, match=r"expected beta of Newmark > 0, given -0\.25"):
        nts.Newmark(0.0, 0.0, -0.25, 0.5)
    with pytest.raises(TypeError, match="expected a number for gamma, given 'half'"):
        nts.Newmark(0.0, 0.0, 0.25, "half")
    with pytest.raises(ValueError, match=r"gamma of Newmark >= .* = 0\.6, .* grows, given 0\.5"):
        nts.Newmark(0.0, 0.1, 0.25, 0.5)
    with pytest.raises(ValueError, match=r"beta of Newmark >= gamma/2 .* given 0\.166667 and"):
        nts.Newmark(0.0, 0.0, 1 / 6, 0.5)
    with pytest.raises(ValueError, match=r"of Newmark <= 1/2, .* given 0 and 0\.6"):
        nts.Newmark(0.0, 0.6, 0.6, 1.1)


def test_parameters_of_newmark_are_those_of_stable_steps_of_any_length():
    """Against the largest eigenvalue of a step of an oscillator, for steps of many lengths."""

    def largest(alpha_m, alpha_f, beta, gamma, angle):
        # State u, dt v, dt^2 a; the equation of motion holds at the weighted means.
        end = np.array([[1, 0, -beta], [0, 1, -gamma], [0, 0, 0]], dtype=float)
        start = np.array([[1, 1, 0.5 - beta], [0, 1, 1 - gamma], [0, 0, 0]])
        k = angle**2
        end[2], start[2] = ((1 - alpha_f) * k, 0, 1 - alpha_m), (-alpha_f * k, 0, -alpha_m)
        return np.abs(np.linalg.eigvals(np.linalg.solve(end, start))).max()

    rng, accepted = np.random.default_rng(7), 0
    for _ in range(1000):
        alpha_m, alpha_f = rng.uniform(-0.6, 0.6, 2)
        gamma = 0.5 - alpha_m + alpha_f + rng.choice([0.0, rng.uniform(-0.2, 0.3)])
        beta = gamma / 2 + rng.uniform(-0.2, 0.3)
        radius = max(largest(alpha_m, alpha_f, beta, gamma, x) for x in np.logspace(-2, 4, 200))
        try:
            nts.Newmark(alpha_m, alpha_f, beta, gamma)
        except ValueError:
            assert radius > 1 + 1e-7 or beta <= 0
        else:
            assert radius <= 1 + 1e-7
            accepted += 1
    assert accepted > 20


def test_missing_scheme_and_missing_call_of_the_base_class_are_named(box):
    class Without(nts.ImplicitStepper):
        pass

    class NotCalled(nts.ImplicitStepper):
        def __init__(self, *bodies, **options):
            self.scheme = nts.Scheme(**ARGUMENTS)

    with pytest.raises(TypeError, match="expected a Scheme as the attribute scheme of Without"):
        Without([box.body], dt=0.1)
    with pytest.raises(
        AttributeError, match=r"expected super\(\).__init__\(bodies, pairs, dt=...\)"
    ):
        NotCalled([box.body], dt=0.1).set_velocity(box.body, None)


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        (nts.CentralDifference, "which CentralDifference ignores: .*ImplicitStep"),
        (nts.GeneralizedAlpha, "as .*ImplicitStep"),
        (nts.QuasiStatic, "as QuasiStatic has no inertia: .*ImplicitStep"),
    ],
)
def test_scheme_of_a_stepper_that_has_its_own_is_refused(box, kind, reason):
    """Regression: it was ignored."""
    own = type("Own", (kind,), {"scheme": nts.Scheme(**ARGUMENTS)})
    with pytest.raises(TypeError, match=f"expected no attribute scheme of Own, {reason}"):
        own([box.body], dt=1e-6)


def test_subclass_without_a_scheme_is_a_stepper(box):
    for kind in (nts.CentralDifference, nts.GeneralizedAlpha, nts.QuasiStatic):
        type("Own", (kind,), {})([box.body], dt=1e-6)


def test_scheme_of_wood_bossak_and_zienkiewicz_is_accepted(box):
    a = -0.1
    rates = partial(nts.NewmarkRates, nts.Newmark(a, 0.0, (1 - a) ** 2 / 4, 0.5 - a))
    assert stepper_of(box, rates=rates).advance().newton_iterations >= 0


def test_scheme_that_is_set_after_the_creation_is_refused(box):
    """Regression: it was ignored."""
    stepper = stepper_of(box)
    with pytest.raises(AttributeError, match="expected no change of scheme after the creation"):
        stepper.scheme = nts.Midpoint.scheme


@pytest.mark.parametrize(
    ("name", "advice"), [("u", "by set_displacement"), ("v", "by set_velocity"), ("u_n", "from u")]
)
def test_state_that_is_replaced_by_another_function_is_refused(box, name, advice):
    """The steps would use the values of the former Function."""
    stepper = stepper_of(box)
    with pytest.raises(AttributeError, match=f"expected no change of {name} after.*{advice}"):
        setattr(stepper, name, getattr(stepper, name).copy())


def test_stress_is_checked_without_a_body_of_an_elastic_material(comm):
    """Regression: a wrong stress of plastic bodies was accepted."""
    metal = nts.J2Plasticity(E=1e5, nu=0.3, yield_stress=1e3, rho=1e3)
    plastic = Box(comm, shape=(1, 1, 1), material=metal)
    with pytest.raises(ValueError, match="expected the first Piola-Kirchhoff stress"):
        stepper_of(plastic, stress=lambda m, p, F_n, F: m.stress(F.T * F, **p))
