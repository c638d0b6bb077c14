"""Gradients with respect to prescribed motions."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from helpers.gradients import ADJOINT, boxes, check, pressed
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

NODES = {"method": "node-to-segment"}
MORTAR = {"method": "mortar", "friction": nts.Coulomb(0.3)}


@pytest.mark.parametrize(
    ("scheme", "kind", "contact"),
    [
        (nts.QuasiStatic, "function", NODES),
        (nts.EnergyMomentum, "scaled", NODES),
        (nts.QuasiStatic, "scaled", MORTAR),
        once(nts.QuasiStatic, "part", NODES),
        once(nts.QuasiStatic, "constant", NODES),
        once(nts.EnergyMomentum, "constant", MORTAR),
        once(nts.EnergyMomentum, "function", NODES),
        once(nts.Midpoint, "part", NODES),
        once(nts.EnergyMomentum, "scaled", MORTAR),
    ],
)
def test_derivatives_with_respect_to_a_prescribed_motion(comm, rng, scheme, kind, contact):
    stepper, controls, J, until = pressed(comm, scheme, kind, **contact)
    gradient = nts.Gradient(stepper, controls[:2], J, until=until)
    direction = 0.01 * rng.standard_normal(gradient.controls.size)
    direction[-1] = 100.0
    check(gradient, direction, exact=ADJOINT if contact is NODES else 1e-8)


@pytest.mark.several_ranks
@pytest.mark.parametrize("contact", [NODES, MORTAR], ids=["nodes", "mortar"])
def test_gradient_for_a_motion_does_not_depend_on_the_ranks(comm, agree, contact):
    several, alone = (
        nts.Gradient(*pressed(each, nts.QuasiStatic, "scaled", **contact)[:3], until=0.5)
        for each in (comm, MPI.COMM_SELF)
    )
    assert agree(np.allclose(several.gradient(), alone.gradient(), rtol=1e-7, atol=0))


def column(comm, value, update, loads=None):
    """Stepper of a box whose top has a prescribed displacement, and its objective."""
    V, facets, tag, bodies, _ = boxes(comm, [(2, 2, 2)], [(1.0, 0.8, 0.6)])
    floor = fem.locate_dofs_geometrical(V, lambda X: np.isclose(X[2], 0.0))
    top = fem.locate_dofs_topological(V, 2, facets.find(tag["top 0"]))
    given = value(V)
    bcs = [fem.dirichletbc(np.zeros(3), floor, V), fem.dirichletbc(given, top, V)]
    load = [] if loads is None else [loads(V)]
    stepper = nts.QuasiStatic(bodies, dt=0.5, bcs=bcs, loads=load, update=update)
    return stepper, ufl.inner(stepper.u, stepper.u) * ufl.dx


def test_controls_that_update_changes_are_refused_in_the_run(comm, refused):
    known = []

    def value(V):
        known.append(fem.Constant(V.mesh, np.zeros(3)))
        return known[0]

    def update(t):
        known[0].value[2] = 0.1 * t

    stepper, J = column(comm, value, update)
    gradient = nts.Gradient(stepper, known, J, until=1.0)
    with refused(ValueError, "expected controls that keep their values in a run"):
        gradient.value()


def test_controls_that_update_does_not_use_are_refused(comm, refused):
    stepper, J = column(comm, lambda V: fem.Constant(V.mesh, np.full(3, 0.1)), lambda t: None)
    unused = fem.Constant(stepper.u.function_space.mesh, 1.0)
    gradient = nts.Gradient(stepper, [unused], J, until=1.0)
    with refused(ValueError, "control 1 of 1, a Constant of shape .*, which occurs in none"):
        gradient.gradient()


@pytest.mark.parametrize("kind", ["load", "function"])
def test_other_data_that_update_computes_from_controls_are_refused(comm, refused, kind):
    known = {}

    def load(V):
        known["force"], known["one"] = (fem.Constant(V.mesh, x) for x in (0.0, 1.0))
        known["field"] = fem.Function(V)
        known["field"].x.array[:] = 0.1
        factor = known["force"] * (known["one"] if kind == "load" else known["field"][0])
        return nts.FormLoad(V, lambda u, eta, t: factor * eta[2] * ufl.dx)

    def value(V):
        return fem.Constant(V.mesh, np.full(3, 0.01))

    def update(t):
        source = known["one"].value if kind == "load" else known["field"].x.array[0]
        known["force"].value = 2.0 * t * source

    stepper, J = column(comm, value, update, load)
    control = known["one"] if kind == "load" else known["field"]
    gradient = nts.Gradient(stepper, [control], J, until=1.0)
    with refused(ValueError, "expected update to compute only displacements of bcs from controls"):
        gradient.gradient()
