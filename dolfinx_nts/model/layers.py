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
from dolfinx_nts.model.moduli import least_modulus, wave_modulus
from dolfinx_nts.model.surfaces import Surface, facet_shares
from dolfinx_nts.model.thickness import wall_thickness
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import exchanged, rows_by_rank

__all__ = ["layers", "nodal_densities", "nodal_moduli", "nodal_shear_ratios", "walls"]


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


def nodal_shear_ratios(bodies: Sequence[Body], n: int) -> Floats:
    """Ratios of shear to P-wave modulus at C = 1 of n owned nodes, shape ``(n,)`` [-]. Collective.

    They are infinite in rigid bodies, and for materials without stiffness. Nodes of several bodies
    have the smallest one.
    """
    ratios: Floats = np.full(n, np.inf)
    for body in bodies:
        if body.is_rigid:
            continue
        of_cells = float(wave_modulus(body).max(initial=0.0))
        if (largest := reductions.largest(body.V.mesh.comm, of_cells)) > 0:
            nodes = body.nodes[body.nodes < n]
            ratios[nodes] = np.fmin(ratios[nodes], least_modulus(body) / 2 / largest)
    return ratios


def nodal_densities(bodies: Sequence[Body], n: int) -> Floats:
    """Largest reference density of the bodies at n owned nodes, ``(n,)`` [kg/m^3]. Local."""
    densities: Floats = np.zeros(n)
    for body in bodies:
        nodes = body.nodes[body.nodes < n]
        densities[nodes] = np.maximum(densities[nodes], body.material.rho)
    return densities


def layers(surface: Surface) -> tuple[Floats, Floats]:
    """Layers of cells behind the nodes of a surface. Collective.

    Returns:
        Reference areas of the nodes, positive also at degree 2, shape ``(m,)`` [m^2], and mean
        heights of the layers, between nodes, ``(m,)`` [m].
    """
    area, height = facet_shares(surface), surface.thickness / Element.of(surface.V).degree
    of_nodes, volume = _sums(surface, np.column_stack([area, area * height])).T
    return of_nodes, volume / of_nodes


def walls(surface: Surface, farthest: float) -> Floats:
    """Harmonic mean of the thickness behind each node of a surface, ``(m,)`` [m]. Collective.

    They are at most ``farthest`` [m], see `wall_thickness`.
    """
    area, thickness = facet_shares(surface), wall_thickness(surface, farthest)
    of_nodes, inverse = _sums(surface, np.column_stack([area, area / thickness])).T
    means: Floats = of_nodes / inverse
    return means


def _sums(surface: Surface, values: Floats) -> Floats:
    """Sums of the values of segments, ``(s, k)``, at the owned nodes, ``(m, k)``. Collective."""
    parts = np.tile(values, (surface.segments.shape[1], 1))
    return sums_at(surface.V, surface.nodes, surface.segments.T.ravel(), parts)


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
