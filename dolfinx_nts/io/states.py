"""States of a run, collected for the files of its fields."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.fields import RunFields
from dolfinx_nts.parallel.ordered_rows import OrderedRows

__all__ = ["CELLS", "States"]

# What the names of the fields of cells begin with.
CELLS = "cells/"


class States:
    """Collects the fields of the present state on rank 0, in the numbering of the mesh as read.

    Args:
        stepper: Stepper of the run.
        fields: What is collected of each state.
    """

    def __init__(self, stepper: Stepper, fields: RunFields) -> None:
        """Find the order of nodes and cells. Collective."""
        self._fields = fields
        mesh = stepper.u.function_space.mesh
        comm: MPI.Comm = mesh.comm
        owned = mesh.topology.index_map(mesh.topology.dim).size_local
        self._nodes = OrderedRows(comm, stepper.node_ids)
        self._cells = OrderedRows(comm, mesh.topology.original_cell_index[:owned])

    def present(self) -> dict[str, Array]:
        """Collect the present state. Collective.

        Returns:
            On rank 0 values at the nodes by name, shape ``(n,)`` or ``(n, 3)``, and those of the
            pieces of cells, also tensors ``(m, 9)``, by names that begin with ``cells/``. On
            other ranks they have no meaning.
        """
        values = _collected(self._nodes, self._fields.nodal())
        for name, rows in _collected(self._cells, self._fields.of_cells()).items():
            values[f"{CELLS}{name}"] = rows.reshape(-1, *rows.shape[2:])
        return values


def _collected(order: OrderedRows, fields: dict[str, Array]) -> dict[str, Array]:
    """Fields of all ranks, which are sent together."""
    if not fields:
        return {}
    shapes = [values.shape[1:] for values in fields.values()]
    ends = np.cumsum([int(np.prod(shape, dtype=int)) for shape in shapes])
    parts = [values.reshape(len(values), -1) for values in fields.values()]
    every: Floats = order.collected(np.concatenate(parts, axis=1))
    columns = np.split(every, ends[:-1], axis=1)
    return {
        name: np.ascontiguousarray(part).reshape(-1, *shape)
        for name, part, shape in zip(fields, columns, shapes, strict=True)
    }
