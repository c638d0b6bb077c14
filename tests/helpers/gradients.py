"""Scenes of gradients of runs, and their comparison with differences."""

import numpy as np
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models import box_meshes

__all__ = [
    "ADJOINT",
    "ALONG",
    "DIFFERENCES",
    "DOWN",
    "ORDER",
    "boxes",
    "check",
    "impact",
    "pressed",
]

# Round-off of an adjoint against tangent-linear steps, and error of differences of runs [-].
ADJOINT, DIFFERENCES, ORDER = 1e-10, 1e-6, 1.95
# Displacements of the top of a box [m]: down, and along the other one.
DOWN, ALONG = (0.02, 0.01, -0.12), (0.25, 0.1, -0.1)


def boxes(comm, shapes, sizes, cell="hexahedron", degree=1):
    """Mesh of boxes, the second one tilted above the first, its space, and its parameters."""
    data = box_meshes.boxes(shapes, sizes, cell)
    if len(shapes) > 1:
        top = np.unique(data.cells[data.body == 1])
        X = data.X[top] - data.X[top].mean(axis=0)
        (c, s), (d, t) = ((np.cos(a), np.sin(a)) for a in (0.1, 0.07))
        X = X @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T
        X = X @ np.array([[1, 0, 0], [0, d, -t], [0, t, d]]).T
        data.X[top] = X + np.array([0.57, 0.61, 0.73])
    mesh, cells, facets, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    mu, kappa = fem.Constant(mesh, 500.0), fem.Constant(mesh, 800.0)

    def psi(C):
        J2 = ufl.det(C)
        return mu / 2 * (ufl.tr(C) - 3 - ufl.ln(J2)) + kappa / 8 * ufl.ln(J2) ** 2

    material = nts.Hyperelastic(psi, rho=10.0, one_point=())
    names = [name for name in tag if name.startswith("body")]
    return V, facets, tag, [nts.Body(V, cells, tag[n], material) for n in names], (mu, kappa)


def impact(comm, scheme=nts.EnergyMomentum, *, steps=8, clamped=True, degree=1, **contact):
    """Gradient of a box that falls on a clamped one, for the material.

    Friction may be a function of the space that returns a law.
    """
    shapes, sizes = [(3, 3, 1), (2, 2, 2)], [(1.2, 1.2, 0.4), (0.6, 0.6, 0.5)]
    V, facets, tag, bodies, controls = boxes(comm, shapes, sizes, degree=degree)
    obstacle = contact.pop("obstacle", None)
    below = obstacle or nts.Surface(V, facets, tag["top 0"])
    if callable(friction := contact.get("friction")):
        contact["friction"] = friction(V)
    pair = nts.ContactPair(nts.Surface(V, facets, tag["bottom 1"]), below, **contact)
    floor = fem.locate_dofs_geometrical(V, lambda X: np.isclose(X[2], 0.0))
    bcs = [fem.dirichletbc(np.zeros(3), floor, V)] if clamped else []
    stepper = scheme(bodies, [pair], dt=0.01, bcs=bcs)
    stepper.set_velocity(
        bodies[1], lambda X: np.array([0.3 + 0 * X[0], 0.1 * X[0], 0.2 * X[0] - 2.0])
    )
    w = fem.Function(V)
    w.interpolate(lambda X: X)
    u, v = stepper.u, stepper.v
    J = ufl.inner(u - w, u) * ufl.dx + 0.01 * ufl.inner(v, v) * ufl.dx + ufl.inner(v, w) * ufl.dx
    return stepper, list(controls), J, 0.01 * steps


def check(gradient, direction, *, exact=ADJOINT):
    """Compare with tangent-linear steps, with differences of runs, and by Taylor remainders."""
    x = gradient.controls
    value, slope = gradient.value(x), gradient.derivative(direction, x)
    assert np.isclose(gradient.gradient(x) @ direction, slope, rtol=exact, atol=0)
    ends = [gradient.value(x + h * direction) for h in (1e-4, -1e-4)]
    assert np.isclose((ends[0] - ends[1]) / 2e-4, slope, rtol=DIFFERENCES, atol=0)
    rest = [abs(gradient.value(x + h * direction) - value - h * slope) for h in (4e-3, 2e-3, 1e-3)]
    assert np.log2(np.divide(rest[:-1], rest[1:])).min() > ORDER


def pressed(comm, scheme, kind="scaled", *, to=DOWN, steps=4, degree=1, **contact):
    """Gradient of a tilted box whose top is moved against a clamped one.

    The control is the value of conditions: a ``"constant"``, a ``"function"`` of the space, its
    vertical ``"part"``, or a Constant with which ``update`` scales the motion (``"scaled"``).
    Moduli follow. Friction may be a function of the space that returns a law.
    """
    shapes, sizes = [(3, 3, 1), (2, 2, 2)], [(1.2, 1.2, 0.4), (0.6, 0.6, 0.5)]
    V, facets, tag, bodies, moduli = boxes(comm, shapes, sizes, degree=degree)
    below, above = (nts.Surface(V, facets, tag[name]) for name in ("top 0", "bottom 1"))
    if callable(friction := contact.get("friction")):
        contact["friction"] = friction(V)
    pair = nts.ContactPair(above, below, **{"enforcement": nts.Penalty(), **contact})
    floor = fem.locate_dofs_geometrical(V, lambda X: np.isclose(X[2], 0.0))
    held, top = fem.dirichletbc(np.zeros(3), floor, V), facets.find(tag["top 1"])
    is_static = scheme is nts.QuasiStatic
    dt = 0.25 if is_static else 0.01
    to, update = np.array(to) * (1.0 if is_static or kind == "scaled" else 0.3), None
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
    return stepper, [control, *moduli], J, steps * dt
