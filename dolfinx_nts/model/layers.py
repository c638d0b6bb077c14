"""Layers of cells behind the nodes of a surface, which an impact compresses first."""

from collections.abc import Sequence

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.few_nodes import sums_at
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.materials.strain_energy import STRETCHES
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.moduli import wave_modulus
from dolfinx_nts.model.surfaces import Surface, facet_shares
from dolfinx_nts.parallel.communication import exchanged, rows_by_rank

__all__ = ["layers", "nodal_densities", "nodal_moduli"]


def nodal_moduli(bodies: Sequence[Body], n: int) -> Floats:
    """P-wave moduli at C = 1 of n owned nodes, shape ``(n,)`` [Pa]. Collective.

    They are infinite in rigid bodies, and for materials without stiffness. Anisotropic materials
    have the largest modulus along the coordinate axes, and nodes of several bodies, or of cells
    with several moduli, the largest one.
    """
    V = bodies[0].V
    moduli: Floats = np.zeros(len(reference_positions(V)))
    for body in bodies:
        if body.is_rigid:
            moduli[body.nodes] = np.inf
        elif body.material.has_fields:
            np.maximum.at(moduli, V.dofmap.list[body.cells], wave_modulus(body)[:, None])
        else:
            modulus = body.material.moduli.diagonal()[STRETCHES].max()
            moduli[body.nodes] = np.maximum(moduli[body.nodes], modulus)
    if any(body.material.has_fields for body in bodies):
        _take_largest(V, moduli)
    owned = moduli[:n]
    owned[owned <= 0] = np.inf
    return owned


def nodal_densities(bodies: Sequence[Body], n: int) -> Floats:
    """Largest reference density of the bodies at n owned nodes, ``(n,)`` [kg/m^3]. Local."""
    densities: Floats = np.zeros(n)
    for body in bodies:
        nodes = body.nodes[body.nodes < n]
        densities[nodes] = np.maximum(densities[nodes], body.material.rho)
    return densities


def layers(surface: Surface, modulus: Floats) -> tuple[Floats, Floats]:
    """Layers of cells behind the nodes of a surface. Collective.

    A layer of height h, between nodes, and modulus M has the stiffness M/h per area.

    Args:
        surface: The surface.
        modulus: P-wave modulus at the owned nodes of the space, see `nodal_moduli`.

    Returns:
        Reference areas of the nodes, positive also at degree 2, shape ``(m,)`` [m^2], and
        compression of the layer per pressure, shape ``(m,)`` [m/Pa].
    """
    V = surface.V
    area, height = facet_shares(surface), surface.thickness / Element.of(V).degree
    parts = np.tile(np.column_stack([area, area * height]), (surface.segments.shape[1], 1))
    of_nodes, volume = sums_at(V, surface.nodes, surface.segments.T.ravel(), parts).T
    return of_nodes, volume / of_nodes / modulus[surface.nodes]


def _take_largest(V: fem.FunctionSpace, values: Floats) -> None:
    """Set values of owned nodes to the largest ones of all ranks, in place. Collective.

    Args:
        V: The space.
        values: Values of its local nodes, shape ``(l,)``.
    """
    comm, nodes = V.mesh.comm, V.dofmap.index_map
    n, first = nodes.size_local, nodes.local_range[0]
    rows = rows_by_rank(comm, nodes.owners)
    sent = {rank: (nodes.ghosts[i], values[n + i]) for rank, i in rows.items()}
    for ghosts, of_ghosts in exchanged(comm, sent).values():
        np.maximum.at(values, ghosts - first, of_ghosts)
