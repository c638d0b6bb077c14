"""Arrays of a run that are written to files: its mesh, and the fields of a state."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Array
from dolfinx_nts.compat import geometry_nodes
from dolfinx_nts.fem.components import in_space, nodal
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import input_ids
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.parallel.communication import gathered

__all__ = ["mesh_arrays", "nodal_fields"]

# Position of each vertex of VTK and XDMF among the vertices of DOLFINx.
_VTK_ORDER = {
    "triangle": [0, 1, 2],
    "quadrilateral": [0, 1, 3, 2],
    "tetrahedron": [0, 1, 2, 3],
    "hexahedron": [0, 1, 3, 2, 4, 5, 7, 6],
}


def mesh_arrays(stepper: Stepper) -> dict[str, Array]:
    """Collect the mesh on rank 0, in the numbering of the file it was read from.

    Collective. A cell of degree 2 becomes eight cells of degree 1 between its nodes, so that
    every reader can show all nodes.

    Args:
        stepper: Stepper whose bodies fill the mesh.

    Returns:
        On rank 0 ``points``, the reference positions of the nodes, shape ``(n, 3)`` [m];
        ``cells``, the nodes of each cell in the order of VTK, shape ``(m, 3)``,
        ``(m, 4)`` or ``(m, 8)``;
        and ``body``, the position of each cell's body in ``stepper.bodies``, shape ``(m,)``. On
        other ranks the arrays have no meaning.
    """
    V = stepper.u.function_space
    mesh, element = V.mesh, Element.of(V)
    comm: MPI.Comm = mesh.comm
    points = V.tabulate_dof_coordinates()
    # The vertices as they were read: tabulated ones have a round-off error that depends on the
    # partition.
    corners = geometry_nodes(mesh)
    points[V.dofmap.list[:, : corners.shape[1]]] = mesh.geometry.x[corners]
    cell = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local)
    original = mesh.topology.original_cell_index[cell]
    body = np.empty(len(cell), dtype=np.int32)
    for number, b in enumerate(stepper.bodies):
        body[b.cells] = number
    order = _VTK_ORDER[mesh.topology.cell_name()]
    pieces = input_ids(V)[V.dofmap.list[cell]][:, element.pieces[:, order]]
    cells = gathered(comm, original, pieces)[1].reshape(-1, len(order))
    ids = stepper.node_ids
    numbers, points = gathered(comm, ids, points[: len(ids)])
    bodies = gathered(comm, original, body)[1]
    return {
        "points": points,
        "cells": np.searchsorted(numbers, cells),
        "body": np.repeat(bodies, len(element.pieces)),
    }


def nodal_fields(stepper: Stepper) -> dict[str, Array]:
    """Displacement, velocity and contact at the owned nodes. Collective.

    Where a node belongs to several pairs, it has their smallest gap, the sum of their
    pressures, slips and tractions, and the largest of the others.

    Args:
        stepper: Stepper whose present state is described.

    Returns:
        Values by name. ``displacement`` [m] and ``velocity`` [m/s] have the shape ``(n, 3)``
        for ``n`` owned nodes; in the plane the third components are 0.

        With contact pairs, of shape ``(n,)``: ``gap`` [m], positive where contact is open, and
        NaN where a node faces no segment or belongs to no pair; ``contact_pressure`` [Pa];
        ``active``, 1 where contact transmits force. With friction also ``friction_traction``
        [Pa], shape ``(n, 3)``; ``slip_state``, 0 open, 1 sticking, 2 sliding; and
        ``accumulated_slip`` [m]. All but the gap are 0 at nodes without a pair.
    """
    n = len(stepper.node_ids)
    fields: dict[str, Array] = {
        "displacement": in_space(nodal(stepper.u)[:n]),
        "velocity": in_space(nodal(stepper.v)[:n]),
    }
    has_friction = any(pair.friction is not None for pair in stepper.pairs)
    gap = np.full(n, np.nan)
    pressure, active, slip_state, slip = np.zeros((4, n))
    traction = np.zeros((n, 3))
    for contact in stepper.contacts:
        at, history = contact.nodes.nodes, contact.history
        gap[at] = np.fmin(gap[at], contact.gap(stepper.x))
        pressure[at] += contact.pressure
        active[at] = np.maximum(active[at], history.active)
        if contact.pair.friction is not None:
            slip_state[at] = np.maximum(slip_state[at], history.active + 1.0 * history.sliding)
            slip[at] += history.slip
            traction[at] -= contact.nodes.per_area(history.traction)
    if stepper.pairs:
        fields |= {"gap": gap, "contact_pressure": pressure, "active": active}
    if has_friction:
        fields |= {
            "friction_traction": traction,
            "slip_state": slip_state,
            "accumulated_slip": slip,
        }
    return fields
