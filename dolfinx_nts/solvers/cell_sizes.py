"""Sizes of the cells of a mesh, the length scale of tolerances."""

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions

__all__ = ["CellSizes", "cell_sizes"]


@dataclass(frozen=True)
class CellSizes:
    """Diameters of the cells of a mesh.

    Attributes:
        smallest: Smallest diameter of all cells [m].
        nodal: Largest diameter of the cells at each owned node, shape ``(n,)`` [m].
    """

    smallest: float
    nodal: Floats


def cell_sizes(V: fem.FunctionSpace) -> CellSizes:
    """Measure the undeformed cells of a space. Collective.

    Args:
        V: Function space, whose nodes the result refers to.
    """
    mesh, tdim = V.mesh, V.mesh.topology.dim
    cells = mesh.topology.index_map(tdim)
    h = mesh.h(tdim, np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32))
    nodes = V.dofmap.index_map
    size = (nodes.size_local, nodes.size_global)
    vector = PETSc.Vec().createGhost(nodes.ghosts.astype(PETSc.IntType), size=size, comm=mesh.comm)
    with vector.localForm() as local:
        np.maximum.at(local.array, V.dofmap.list, h[:, None])
    vector.ghostUpdate(PETSc.InsertMode.MAX_VALUES, PETSc.ScatterMode.REVERSE)
    nodal = vector.array.copy()
    vector.destroy()
    smallest = float(reductions.least(mesh.comm, h.min(initial=np.inf)))
    return CellSizes(smallest, nodal)
