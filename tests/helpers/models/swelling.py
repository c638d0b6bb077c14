"""A box of a compressible material that a stretch without stress swells."""

import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

__all__ = ["swelling_box"]


def swelling_box(comm, size, cells):
    """Return a cube of a side [m] and a number of cells along it, and its stretch, a Constant."""

    def build(model):
        parts.add_box(model, "box", corner=(0, 0, 0), size=3 * (size,), cells=3 * (cells,))

    mesh, tags, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    stretch = fem.Constant(mesh, 1.0)

    def psi(C):
        elastic = C / stretch**2
        J = ufl.sqrt(ufl.det(elastic))
        return 5e4 * (ufl.tr(elastic) - 3 - 2 * ufl.ln(J)) + 1e5 * ufl.ln(J) ** 2

    return nts.Body(V, tags, tag["box"], nts.Hyperelastic(psi, rho=1e3)), stretch
