"""Rows of the fields of a state, for the files of a run."""

from collections.abc import Mapping

from mpi4py import MPI

from dolfinx_nts.common.arrays import Array
from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.fields import RunFields
from dolfinx_nts.parallel.slabs import Slab, Slabs

__all__ = ["CELLS", "States"]

# Prefix of the names of cell fields.
CELLS = "cells/"


class States:
    """Fields of states, redistributed to the input order of the mesh.

    Args:
        stepper: Stepper of the run.
        fields: Fields of each state.
    """

    def __init__(self, stepper: Stepper, fields: RunFields) -> None:
        self._fields = fields
        mesh = stepper.u.function_space.mesh
        comm: MPI.Comm = mesh.comm
        owned = mesh.topology.index_map(mesh.topology.dim).size_local
        self._nodes = Slabs(comm, stepper.node_ids)
        self._cells = Slabs(comm, mesh.topology.original_cell_index[:owned])

    def rows(self, now: CurrentState, former: Mapping[str, Slab] | None = None) -> dict[str, Slab]:
        """Rows of the current state for this rank. Collective.

        Args:
            now: Current state of the stepper.
            former: Rows of an earlier state, whose memory is reused.

        Returns:
            Nodal values by name, shape ``(n,)`` or ``(n, 3)``, and values of sub-cells, also
            tensors ``(m, 9)``, by names with the prefix ``cells/``.
        """
        of_nodes: dict[str, Array] = {}
        of_cells: dict[str, Array] = {}
        for name, slab in (former or {}).items():
            room = of_cells if name.startswith(CELLS) else of_nodes
            room[name.removeprefix(CELLS)] = slab.values
        fields = self._nodes.together(self._fields.nodal(now), of_nodes)
        for name, slab in self._cells.together(self._fields.of_cells(), of_cells).items():
            pieces, *shape = slab.values.shape[1:]
            fields[f"{CELLS}{name}"] = slab.split(pieces, *shape)
        return fields
