"""Gradients with respect to coefficients of friction."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.gradients import ALONG, check, impact, pressed
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

NODES, MORTAR = {"method": "node-to-segment"}, {"method": "mortar"}


def constants(V, *values):
    """Constants of the mesh."""
    return [fem.Constant(V.mesh, value) for value in values]


def field(V):
    """Coefficient that varies in space."""
    function = fem.Function(fem.functionspace(V.mesh, ("Lagrange", 1)))
    function.interpolate(lambda X: 0.15 + 0.05 * X[0])
    return function


class Halved(nts.FrictionLaw):
    """Half of a coefficient, which is an attribute."""

    def __init__(self, mu):
        self.mu = mu

    def limit(self, p, slip, dt, nodes):
        mu = float(self.mu.value) / 2
        return mu * p, mu, 0.0


def reading(mu):
    """A law that reads a coefficient which it does not have as an attribute."""

    class Reading(nts.FrictionLaw):
        def limit(self, p, slip, dt, nodes):
            value = nodes.value(mu)
            return value * p, value, 0.0

    return Reading()


# Laws, by the coefficients that are controls.
LAWS = {
    "Coulomb": (lambda V: constants(V, 0.2), nts.Coulomb),
    "attribute": (lambda V: constants(V, 0.4), Halved),
    "value": (lambda V: constants(V, 0.2), reading),
    "field": (lambda V: [field(V)], nts.Coulomb),
    "SlipWeakening": (
        lambda V: constants(V, 0.3, 0.1),
        lambda *mu: nts.SlipWeakening(*mu, length=0.02),
    ),
    "Stribeck": (lambda V: constants(V, 0.2, 0.1), lambda *mu: nts.Stribeck(*mu, speed=1.0)),
    "Tresca": (
        lambda V: constants(V, 0.2, 60.0),
        lambda mu, stress: nts.Tresca(nts.Coulomb(mu), stress),
    ),
}


def sliding(comm, scheme, name, **contact):
    """Gradient of a box that is moved along another one, or falls on it, for a law."""
    controls, (coefficients, law) = [], LAWS[name]

    def friction(V):
        controls.extend(coefficients(V))
        return law(*controls)

    if scheme is nts.QuasiStatic:
        stepper, _, J, until = pressed(comm, scheme, to=ALONG, friction=friction, **contact)
    else:
        stepper, _, J, until = impact(comm, scheme, friction=friction, **contact)
    return stepper, controls, J, until


@pytest.mark.parametrize(
    ("scheme", "law", "contact"),
    [
        (nts.QuasiStatic, "Coulomb", MORTAR),
        (nts.EnergyMomentum, "SlipWeakening", NODES),
        once(nts.QuasiStatic, "SlipWeakening", MORTAR),
        once(nts.QuasiStatic, "Tresca", NODES),
        once(nts.EnergyMomentum, "Coulomb", MORTAR),
        once(nts.EnergyMomentum, "Stribeck", NODES),
        once(nts.Midpoint, "Tresca", NODES),
        once(nts.EnergyMomentum, "attribute", NODES),
        (nts.EnergyMomentum, "value", NODES),
    ],
)
def test_derivatives_with_respect_to_coefficients_of_friction(comm, scheme, law, contact):
    stepper, controls, J, until = sliding(comm, scheme, law, **contact)
    gradient = nts.Gradient(stepper, controls, J, until=until)
    check(gradient, 2 * gradient.controls, exact=1e-8)
    history = stepper.contacts[0].history
    assert comm.allreduce(int((history.active & history.sliding).sum())) > 0


def test_derivative_along_a_field_of_friction(comm):
    """A uniform change of the field is that of a number."""
    slopes = []
    for name in "field", "Coulomb":
        stepper, (mu,), J, until = sliding(comm, nts.QuasiStatic, name, **NODES)
        if isinstance(mu, fem.Function):
            mu.x.array[:] = 0.2
        gradient = nts.Gradient(stepper, [mu], J, until=until)
        slopes.append(gradient.derivative(np.ones(gradient.controls.size)))
    assert np.isclose(*slopes, rtol=1e-8, atol=0)


@pytest.mark.several_ranks
def test_gradient_for_friction_does_not_depend_on_the_ranks(comm, agree):
    several, alone = (
        nts.Gradient(*sliding(each, nts.QuasiStatic, "Coulomb", **MORTAR)[:3], until=0.5)
        for each in (comm, MPI.COMM_SELF)
    )
    assert agree(np.allclose(several.gradient(), alone.gradient(), rtol=1e-7, atol=0))
