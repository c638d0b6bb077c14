"""Gradients with respect to prescribed motions."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from helpers.gradients import ADJOINT, boxes, check
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

NODES = {"method": "node-to-segment"}
MORTAR = {"method": "mortar", "friction": nts.Coulomb(0.3)}
# Displacement of the top of a box [m].
TO = np.array([0.02, 0.01, -0.12])


def pressed(comm, scheme, kind, **contact):
    """Gradient of a tilted box whose top is moved against a clamped one.

    The control is the value of conditions: a ``"constant"``, a ``"function"`` of the space, its
    vertical ``"part"``, or a Constant with which ``update`` scales the motion (``"scaled"``).
    """
    shapes, sizes = [(3, 3, 1), (2, 2, 2)], [(1.2, 1.2, 0.4), (0.6, 0.6, 0.5)]
    V, facets, tag, bodies, (mu, _) = boxes(comm, shapes, sizes)
    below, above = (nts.Surface(V, facets, tag[name]) for name in ("top 0", "bottom 1"))
    pair = nts.ContactPair(above, below, **{"enforcement": nts.Penalty(), **contact})
    floor = fem.locate_dofs_geometrical(V, lambda X: np.isclose(X[2], 0.0))
    held, top = fem.dirichletbc(np.zeros(3), floor, V), facets.find(tag["top 1"])
    is_static = scheme is nts.QuasiStatic
    dt = 0.25 if is_static else 0.01
    to, update = TO if is_static or kind == "scaled" else 0.3 * TO, None
    dofs = fem.locate_dofs_topological(V, 2, top)
    if kind == "function":
        control = fem.Function(V)
        control.interpolate(lambda X: to[:, None] + 0.02 * X[[1, 0, 1]])
        bcs = [fem.dirichletbc(control, dofs)]
    elif kind == "part":
        W, _ = V.sub(2).collapse()
        control = fem.Function(W)
        control.x.array[:] = to[2]
        both = fem.locate_dofs_topological((V.sub(2), W), 2, top)
        bcs = [fem.dirichletbc(control, both, V.sub(2))]
        for i in range(2):
            dofs = fem.locate_dofs_topological(V.sub(i), 2, top)
            bcs.append(fem.dirichletbc(np.float64(0.0), dofs, V.sub(i)))
    else:
        control = fem.Constant(V.mesh, to)
        motion = fem.Constant(V.mesh, to) if kind == "scaled" else control
        bcs = [fem.dirichletbc(motion, dofs, V)]

        def scaled(t):
            motion.value[:] = t / (4 * dt) * control.value

        update = scaled if kind == "scaled" else None
    stepper = scheme(bodies, [pair], dt=dt, bcs=[held, *bcs], update=update)
    w = fem.Function(V)
    w.interpolate(lambda X: X)
    u, v = stepper.u, stepper.v
    J = ufl.inner(u - w, u) * ufl.dx + 0.01 * ufl.inner(v, w + u) * ufl.dx
    return stepper, [control, mu], J, 4 * dt


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
    gradient = nts.Gradient(stepper, controls, J, until=until)
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
