"""Gradients of statics with contact by springs."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.contact.implicit.mortar.frozen_points import SettlingPoints
from helpers.gradients import ADJOINT, ALONG, check, pressed
from helpers.models import box_meshes
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

NODES, MORTAR, FRICTION = {"method": "node-to-segment"}, {"method": "mortar"}, nts.Coulomb(0.3)


def resting(comm, **contact):
    """Stepper, modulus and objective of a box that lies on a clamped one."""
    data = box_meshes.boxes([(2, 2, 1), (2, 2, 2)], [(1.2, 1.2, 0.4), (0.6, 0.6, 0.5)])
    data.X[np.unique(data.cells[data.body == 1])] += np.array([0.23, 0.31, 0.4])
    mesh, cells, facets, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    mu = fem.Constant(mesh, 500.0)

    def psi(C):
        return mu / 2 * (ufl.tr(C) - 3 - ufl.ln(ufl.det(C))) + 100.0 * ufl.ln(ufl.det(C)) ** 2

    soft = nts.Hyperelastic(psi, rho=10.0, one_point=())
    bodies = [nts.Body(V, cells, tag[name], soft) for name in ("body 0", "body 1")]
    below, above = (nts.Surface(V, facets, tag[name]) for name in ("top 0", "bottom 1"))
    pair = nts.ContactPair(above, below, **{"enforcement": nts.Penalty(), **contact})
    floor = fem.locate_dofs_geometrical(V, lambda X: np.isclose(X[2], 0.0))
    gravity = nts.Gravity(bodies, (0.0, 0.0, -9.81))
    bcs = [fem.dirichletbc(np.zeros(3), floor, V)]
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, loads=[gravity])
    return stepper, [mu], ufl.inner(stepper.u, stepper.u) * ufl.dx


@pytest.mark.parametrize(
    "contact",
    [
        {**NODES},
        {**MORTAR},
        {"friction": FRICTION, "to": ALONG, **MORTAR},
        once({"enforcement": nts.Penalty(2e3), "to": ALONG, **NODES}),
        once({"friction": FRICTION, "to": ALONG, **NODES}),
        once({"to": ALONG, **MORTAR}),
        once({"degree": 2, **NODES}),
        once({"degree": 2, "steps": 2, "friction": FRICTION, **MORTAR}),
    ],
)
def test_derivatives_of_equilibria(comm, contact):
    stepper, controls, J, until = pressed(comm, nts.QuasiStatic, **contact)
    gradient = nts.Gradient(stepper, controls[1:], J, until=until)
    has_adjoint = contact["method"] != "mortar" and "friction" not in contact
    check(gradient, np.array([200.0, -300.0]), exact=ADJOINT if has_adjoint else 1e-8)


@pytest.mark.several_ranks
@pytest.mark.parametrize("method", [NODES, MORTAR], ids=["nodes", "mortar"])
def test_gradient_does_not_depend_on_the_ranks(comm, agree, method):
    several, alone = (
        nts.Gradient(*pressed(each, nts.QuasiStatic, **method)[:3], until=0.5)
        for each in (comm, MPI.COMM_SELF)
    )
    assert agree(np.allclose(several.gradient(), alone.gradient(), rtol=1e-8, atol=0))


@pytest.mark.parametrize("method", [NODES, MORTAR], ids=["nodes", "mortar"])
def test_derivatives_of_a_body_that_only_friction_holds(comm, method):
    stepper, controls, J = resting(comm, friction=FRICTION, **method)
    check(nts.Gradient(stepper, controls, J, until=1.0), np.array([200.0]), exact=1e-8)


def test_motions_that_nothing_resists_are_refused(comm, refused):
    stepper, controls, J = resting(comm, **NODES)
    gradient = nts.Gradient(stepper, controls, J, until=1.0)
    with refused(ValueError, "expected, for gradients, supports or contact that resist all rigid"):
        gradient.gradient()


def test_points_that_do_not_settle_are_refused(comm, refused, monkeypatch):
    stepper, controls, J, until = pressed(comm, nts.QuasiStatic, **MORTAR)
    gradient = nts.Gradient(stepper, controls, J, until=until)
    with monkeypatch.context() as patch:
        patch.setattr(SettlingPoints, "_most_renewals", 0)
        with refused(ValueError, "expected contact points that settle in equilibrium"):
            gradient.value()
    assert np.isfinite(gradient.value())


def test_multipliers_in_statics_are_refused(comm, refused):
    stepper, controls, J, until = pressed(comm, nts.QuasiStatic, enforcement=None, **MORTAR)
    with refused(ValueError, "expected contact by springs"):
        nts.Gradient(stepper, controls, J, until=until)
