"""Scenes of gradients of runs, and their comparison with differences."""

import numpy as np
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models import box_meshes

__all__ = ["ADJOINT", "DIFFERENCES", "ORDER", "boxes", "check"]

# Round-off of an adjoint against tangent-linear steps, and error of differences of runs [-].
ADJOINT, DIFFERENCES, ORDER = 1e-10, 1e-6, 1.95


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


def check(gradient, direction, *, exact=ADJOINT):
    """Compare with tangent-linear steps, with differences of runs, and by Taylor remainders."""
    x = gradient.controls
    value, slope = gradient.value(x), gradient.derivative(direction, x)
    assert np.isclose(gradient.gradient(x) @ direction, slope, rtol=exact, atol=0)
    ends = [gradient.value(x + h * direction) for h in (1e-4, -1e-4)]
    assert np.isclose((ends[0] - ends[1]) / 2e-4, slope, rtol=DIFFERENCES, atol=0)
    rest = [abs(gradient.value(x + h * direction) - value - h * slope) for h in (4e-3, 2e-3, 1e-3)]
    assert np.log2(np.divide(rest[:-1], rest[1:])).min() > ORDER
