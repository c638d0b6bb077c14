"""Friction laws of users: mistakes that a check finds when the pair is made."""

from types import SimpleNamespace

import numpy as np
import pytest
from basix.ufl import quadrature_element
from dolfinx import fem, mesh

import dolfinx_nts as nts
from dolfinx_nts.contact.friction.laws import FrictionNodes
from dolfinx_nts.contact.friction.limits import Limits, check_law

pytestmark = pytest.mark.serial

NODES = SimpleNamespace(nodes=np.arange(9, dtype=np.int32), positive_area=np.linspace(0.1, 1, 9))


class Viscous(nts.FrictionLaw):
    """Coefficient that grows with the speed of slip, with a cap."""

    def __init__(self, by_p=1.0, by_slip=1.0):
        self.by_p, self.by_slip = by_p, by_slip

    def limit(self, p, slip, dt, nodes):
        mu, cap = 0.2 + 0.1 * slip / dt, 1e3 * nodes.area
        is_capped = mu * p > cap
        by_p, by_slip = (np.where(is_capped, 0, each) for each in (mu, 0.1 / dt * p))
        return np.where(is_capped, cap, mu * p), self.by_p * by_p, self.by_slip * by_slip


def returns(*arrays):
    """Law that returns these arrays, functions of p and slip."""

    class Returns(nts.FrictionLaw):
        def limit(self, p, slip, dt, nodes):
            found = tuple(each(p, slip) for each in arrays)
            return found[0] if len(found) == 1 else found

    return Returns()


def zero(p, slip):
    return 0 * p


@pytest.mark.parametrize(
    "law",
    [
        *(Viscous(), nts.Coulomb(0.3), nts.Tresca(nts.Coulomb(0.3), 1e3)),
        *(nts.Stribeck(0.4, 0.2, speed) for speed in (1e-6, 0.1, 0.0)),
        *(nts.SlipWeakening(0.4, 0.2, length) for length in (1e-6, 0.01)),
        returns(lambda p, _: [0.3 * each for each in p], lambda *_: 0.3, lambda *_: 0.0),
    ],
)
def test_right_laws_are_accepted(law):
    check_law(law, NODES)


@pytest.mark.parametrize(
    ("name", "value", "meant"), [("eps_t", 1e3, "eps_T"), ("depend_on_slip", False, "depends_on_")]
)
def test_misspelt_attribute_is_refused(name, value, meant):
    law = type("Misspelt", (Viscous,), {name: value})()
    with pytest.raises(AttributeError, match=f"expected {meant}.* of Misspelt, given {name}"):
        check_law(law, NODES)


@pytest.mark.parametrize("name", ["by_p", "by_slip"])
@pytest.mark.parametrize("factor", [-1.0, 0.0, 0.5, 0.999, 2.0])
def test_wrong_derivative_is_named(name, factor):
    argument = name.removeprefix("by_")
    message = f"expected the derivative of the limit with respect to {argument} from Viscous"
    with pytest.raises(ValueError, match=message):
        check_law(Viscous(**{name: factor}), NODES)


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (
            returns(lambda p, _: p * (p / 1.0) ** (-1 / 3), lambda *_: 0.0, lambda *_: 0.0),
            r"finite limit from .*, given nan at p = 0 N, slip = 0 m and dt",
        ),
        (
            returns(
                lambda p, s: p * np.sqrt(s), lambda _, s: np.sqrt(s), lambda p, s: p / s**0.5 / 2
            ),
            r"derivative with respect to slip from .*, given inf at p = 0.0137 N, slip = 0 m",
        ),
        (
            returns(lambda p, s: p * np.exp(1e3 * s), lambda *_: 1.0, lambda *_: 1.0),
            r"finite limit from .*, given inf at p = 1 N, slip = 1 m",
        ),
    ],
)
def test_values_that_are_not_finite_are_named(law, message):
    with np.errstate(over="ignore"), pytest.raises(ValueError, match=message):
        check_law(law, NODES)


def hertzian(p, slip):
    """Limit of a law whose coefficient falls with the pressure."""
    return 0.3 * p ** (2 / 3)


def slope(p, slip):
    return 0.2 * p ** (-1 / 3)


@pytest.mark.parametrize("by_slip", [zero, lambda p, slip: 0 * p ** (-1 / 3)])
def test_derivative_may_be_infinite_at_open_nodes(by_slip):
    law = returns(hertzian, slope, by_slip)
    check_law(law, NODES)
    limits = Limits(law, NODES, 1.0, lambda: np.ones(9), np.zeros(9))
    found = limits.at(np.arange(3), np.array([-1.0, 0.0, 8.0]))
    np.testing.assert_allclose(found.force, [0, 0, 1.2])
    np.testing.assert_allclose(found.by_p, [0, 0, 0.1])
    assert not found.by_slip.any()


def test_values_of_a_diverged_guess_are_left_to_the_step_control():
    limits = Limits(returns(hertzian, slope, zero), NODES, 1.0, lambda: np.ones(9), np.zeros(9))
    assert np.isnan(limits.at(np.arange(1), np.array([np.nan])).force).all()


@pytest.mark.parametrize(
    ("law", "given"),
    [
        (returns(lambda p, _: 0.3 * p), r"1 of the shapes \(9,\)"),
        (returns(lambda *_: None), "None"),
        (returns(lambda p, _: 0.3 * p.sum(), zero, zero), r"3 of the shapes \(\), \(9,\), \(9,\)"),
        (
            returns(zero, lambda p, _: np.ones((9, 2)), zero),
            r"3 of the shapes \(9,\), \(9, 2\), \(9,\)",
        ),
        (returns(*3 * [lambda *_: "0.3"]), r"3 of the shapes \(\), \(\), \(\)"),
        (returns(*3 * [lambda *_: "mu"]), r"\('mu', 'mu', 'mu'\)"),
    ],
)
def test_wrong_return_value_is_described(law, given):
    with pytest.raises(ValueError, match=rf"expected the limit and its .* given {given}"):
        check_law(law, NODES)


def test_missing_method_and_wrong_arguments_are_named():
    class Forgotten(nts.FrictionLaw):
        pass

    class Short(nts.FrictionLaw):
        def limit(self, p, slip, dt):
            return 0.3 * p, 0.3, 0.0

    with pytest.raises(TypeError, match=r"expected a method limit\(self, p, slip, dt, nodes\)"):
        Forgotten()
    message = r"expected limit\(p, slip, dt, nodes\) of Short, given \(p, slip, dt\)"
    with pytest.raises(TypeError, match=message):
        check_law(Short(), NODES)


@pytest.mark.parametrize(
    ("name", "value", "error", "message"),
    [
        ("eps_T", -1.0, ValueError, r"eps_T of Viscous.* > 0.*given -1"),
        ("eps_T", "stiff", TypeError, "eps_T of Viscous.*given"),
        ("law", "paper", ValueError, "'objective' or 'convective', given 'paper'"),
        ("depends_on_slip", False, ValueError, "depends_on_slip is False, given limits that do"),
    ],
)
def test_wrong_attribute_is_named(name, value, error, message):
    law = type("Viscous", (Viscous,), {name: value})()
    with pytest.raises(error, match=message):
        check_law(law, NODES)


@pytest.mark.serial
def test_value_of_a_vector_is_refused(comm):
    V = fem.functionspace(mesh.create_unit_square(comm, 1, 1), ("Lagrange", 1, (2,)))
    nodes = FrictionNodes(NODES, np.arange(9, dtype=np.int32), np.ones(9), np.zeros(9), {}, {})
    with pytest.raises(TypeError, match=r"as a scalar Function, given shape \(2,\)"):
        nodes.value(fem.Function(V))
    with pytest.raises(TypeError, match=r"as a scalar Constant, given shape \(2,\)"):
        nts.Coulomb(fem.Constant(V.mesh, (0.1, 0.2)))
    mu = fem.Constant(V.mesh, 0.3)
    assert np.all(nodes.value(mu) == 0.3)
    assert str(nts.Coulomb(mu).describe()).endswith("a Constant")


def test_limits_that_differ_in_a_second_call_are_refused():
    calls = []

    class Worn(nts.FrictionLaw):
        def limit(self, p, slip, dt, nodes):
            calls.append(1)
            mu = 0.3 + 1e-6 * len(calls)
            return mu * p, mu, 0.0

    with pytest.raises(ValueError, match=r"expected the same limits of Worn\(\) .* second call"):
        check_law(Worn(), NODES)


@pytest.mark.parametrize("name", ["p", "slip"])
def test_law_that_changes_its_arguments_is_refused(name):
    """Regression: the slip of the next iteration was another one."""

    class InPlace(nts.FrictionLaw):
        def limit(self, p, slip, dt, nodes):
            changed = {"p": p, "slip": slip}[name]
            changed *= 0.5
            return 0.3 * p, 0.3, 0.0

    message = r"expected limit\(p, slip, dt, nodes\) of InPlace\(\) to leave its arguments unchang"
    with pytest.raises(ValueError, match=message):
        check_law(InPlace(), NODES)


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ([1.0, 2.0], TypeError, "a number, a fem.Constant or a fem.Function, given list"),
        ("expression", TypeError, "given Product: interpolate an expression"),
        ((1.0, 2.0), TypeError, r"as a scalar Constant, given shape \(2,\)"),
        (quadrature_element("triangle", degree=2), ValueError, "values at quadrature points"),
    ],
    ids=["list", "expression", "vector", "quadrature"],
)
def test_value_of_what_has_none_at_a_node_is_refused(comm, given, error, message):
    """Regression: the one at quadrature points ended the process."""
    square = mesh.create_unit_square(comm, 1, 1)
    if given == "expression":
        given = 2.0 * fem.Constant(square, 1.0)
    elif isinstance(given, tuple):
        given = fem.Constant(square, given)
    elif hasattr(given, "family_name"):
        given = fem.Function(fem.functionspace(square, given))
    nodes = FrictionNodes(NODES, np.arange(9, dtype=np.int32), np.ones(9), np.zeros(9), {}, {})
    with pytest.raises(error, match=message):
        nodes.value(given)


def test_constant_is_a_coefficient(comm):
    mu = fem.Constant(mesh.create_unit_square(comm, 1, 1), 0.3)
    law = nts.Tresca(nts.Coulomb(mu), stress=mu)
    assert law.describe() == "Coulomb friction with mu = a Constant, up to a Constant Pa"
    assert repr(nts.Coulomb(mu)) == "Coulomb(mu=Constant, eps_T=None, law='objective')"
    check_law(law, NODES)
    limits = Limits(law, NODES, 0.1, lambda: NODES.positive_area, np.zeros(9))
    node = np.arange(9, dtype=np.int32)
    np.testing.assert_allclose(limits.at(node, np.full(9, 1e-3)).force, 3e-4, rtol=1e-15)
