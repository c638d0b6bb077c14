"""Arrays written to files: mesh, and fields of a state."""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arguments import functions_by_name, real_array
from dolfinx_nts.common.arrays import Array
from dolfinx_nts.compat import geometry_nodes
from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.diagnostics.functions import nodal_values
from dolfinx_nts.diagnostics.nodal_fields import NodalFields
from dolfinx_nts.fem.components import dimension, in_space
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import input_ids, reference_positions
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.cell_stress import CellStress
from dolfinx_nts.parallel.errors import agreed
from dolfinx_nts.parallel.slabs import Slab, Slabs, Some

__all__ = ["OwnField", "RunFields", "mesh_arrays"]

# A Function, or a callable that returns values at the owned nodes of a stepper.
OwnField: TypeAlias = "fem.Function | Callable[[Stepper], Any]"

# Position of each vertex of VTK and XDMF among the vertices of DOLFINx.
_VTK_ORDER = {
    "triangle": [0, 1, 2],
    "quadrilateral": [0, 1, 3, 2],
    "tetrahedron": [0, 1, 2, 3],
    "hexahedron": [0, 1, 3, 2, 4, 5, 7, 6],
}


def mesh_arrays(stepper: Stepper) -> dict[str, Slab]:
    """Arrays of the mesh in its input numbering. Collective.

    A cell of degree 2 is divided into cells of degree 1 between its nodes, eight in space and four
    in the plane, so that every reader can show all nodes.

    Args:
        stepper: Stepper whose bodies fill the mesh.

    Returns:
        Rows for this rank: ``points``, the reference positions of the nodes, shape ``(n, 3)``
        [m]; ``cells``, the nodes of each cell in the order of VTK, shape ``(m, 3)``,
        ``(m, 4)`` or ``(m, 8)``;
        and ``body``, the position of each cell's body in ``stepper.bodies``, shape ``(m,)``.
    """
    V = stepper.u.function_space
    mesh, element = V.mesh, Element.of(V)
    comm: MPI.Comm = mesh.comm
    # Input coordinates, and midpoints between them: tabulated coordinates have a round-off error
    # that depends on the partition.
    points, read = reference_positions(V).copy(), mesh.geometry.x[geometry_nodes(mesh)]
    if read.shape[1] < len(element.points):
        for node, pairs in enumerate(element.diagonals):
            points[V.dofmap.list[:, node]] = read[:, pairs].mean(axis=2).mean(axis=1)
    points[V.dofmap.list[:, : read.shape[1]]] = read
    cell = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local)
    original = mesh.topology.original_cell_index[cell]
    body = np.empty(len(cell), dtype=np.int32)
    for number, b in enumerate(stepper.bodies):
        body[b.cells] = number
    order = _VTK_ORDER[mesh.topology.cell_name()]
    pieces = input_ids(V)[V.dofmap.list[cell]][:, element.pieces[:, order]]
    ids = stepper.node_ids
    nodes, cells = Slabs(comm, ids), Slabs(comm, original)
    pieces = nodes.places(pieces.ravel()).reshape(len(pieces), -1)
    return {
        "points": nodes.slab(points[: len(ids)]),
        "cells": cells.slab(pieces).split(len(element.pieces), len(order)),
        "body": cells.slab(np.repeat(body[:, None], len(element.pieces), axis=1)).split(
            len(element.pieces)
        ),
    }


class RunFields:
    """Fields of a state that are written to files. Collective, as are its methods.

    Args:
        stepper: The stepper.
        stress: Whether to include the stress.
        own: User-defined fields by name, see `Recorder`.

    Raises:
        ValueError: The name of a user-defined field has an invalid character.
    """

    def __init__(
        self, stepper: Stepper, stress: bool = False, own: Mapping[str, OwnField] | None = None
    ) -> None:
        self._stepper, self._own = stepper, functions_by_name("own_fields", own or {})
        self._nodal = NodalFields(stepper)
        for name in self._own:
            if not name.isidentifier():
                raise ValueError(
                    f"expected names of own_fields made of letters, digits and _, given {name!r}"
                )
        middles = Element.of(stepper.u.function_space).middles
        self._stress = (
            CellStress(stepper.bodies, stepper.u, middles, stepper.memory.stress)
            if stress
            else None
        )

    def nodal(self, now: CurrentState) -> dict[str, Array | Some]:
        """Values at all or at some owned nodes, by name, shape ``(n,)`` or ``(n, 3)``.

        Args:
            now: Current state of the stepper.

        Raises:
            ValueError: A user-defined field has the wrong shape, or the name of another field.
        """
        fields = self._nodal.of(now)
        comm: MPI.Comm = self._stepper.u.function_space.mesh.comm
        for name, own in self._own.items():
            with agreed(comm, f"evaluate the field {name}"):
                if name in fields:
                    raise ValueError(f"expected names that no other field has, given {name!r}")
                fields[name] = self._values(name, own)
        return fields

    def of_cells(self) -> dict[str, Array]:
        """Values at the midpoints of the sub-cells of owned cells by name, ``(c, p, ...)``."""
        if self._stress is None:
            return {}
        state, memory = self._stress.evaluate(), self._stepper.memory
        shape = state.energy_density.shape
        fields = {
            "cauchy_stress": state.cauchy.reshape(*shape, 9),
            "von_mises_stress": state.von_mises(),
            "strain_energy_density": state.energy_density,
        }
        if memory.flows:
            strain = memory.plastic_strain()
            fields["plastic_strain"] = np.broadcast_to(strain[:, None], shape).copy()
        return fields

    def _values(self, name: str, own: OwnField) -> Array:
        """Checked values of a user-defined field. Local."""
        stepper = self._stepper
        V, value = stepper.u.function_space, own if isinstance(own, fem.Function) else own(stepper)
        if isinstance(value, fem.Function):
            values = nodal_values(V, value)
        else:
            n, d = len(stepper.node_ids), dimension(V)
            values = real_array(f"the field {name}", value)
            if values.shape not in ((n,), (n, d), (n, 3)):
                columns = "" if d == 3 else f"({n}, {d}) or "
                raise ValueError(
                    f"expected a field {name} of shape ({n},) or {columns}({n}, 3), with a row for "
                    f"each owned node, given {values.shape}"
                )
        return in_space(values) if values.ndim == 2 else values
