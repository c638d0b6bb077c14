"""Moduli of undeformed bodies, also of materials that vary in space."""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.materials.strain_energy import STRETCHES, poisson_ratios
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.cell_moduli import CellModuli
from dolfinx_nts.parallel import reductions

__all__ = ["least_moduli", "least_modulus", "poisson_ratio", "wave_modulus"]


def wave_modulus(body: Body) -> Floats:
    """P-wave modulus of each owned cell of a deformable body, shape ``(c,)`` [Pa]. Collective.

    Anisotropic materials have the largest modulus along the coordinate axes, and materials that
    vary within a cell the largest one of its points.
    """
    of_cells = CellModuli(body.V, body.material)
    stretches = [
        moduli[..., STRETCHES, STRETCHES].max(axis=(1, 2))
        for _, moduli in of_cells.blocks(body.cells)
    ]
    return np.concatenate([np.empty(0), *stretches])


def least_modulus(body: Body) -> float:
    """`StrainEnergy.least_modulus` of a body, also if it varies in space [Pa]. Collective."""
    material = body.material
    if not np.isnan(material.least_modulus):
        return material.least_modulus
    of_cells = CellModuli(body.V, material)
    values = [np.linalg.eigvalsh(moduli)[..., 0] for _, moduli in of_cells.blocks(body.cells)]
    least = min((float(each.min()) for each in values), default=np.inf)
    return max(float(reductions.least(body.V.mesh.comm, least)), 0.0)


def least_moduli(bodies: Sequence[Body]) -> Floats:
    """`least_modulus` at all local nodes, infinite in rigid bodies, ``(l,)`` [Pa]. Collective.

    Nodes of several bodies have the smallest one.
    """
    moduli: Floats = np.full(len(reference_positions(bodies[0].V)), np.inf)
    for body in bodies:
        own = np.inf if body.is_rigid else least_modulus(body)
        moduli[body.nodes] = np.minimum(moduli[body.nodes], own)
    return moduli


def poisson_ratio(body: Body) -> float:
    """Largest `StrainEnergy.poisson_ratio` in the cells of a deformable body [-]. Collective."""
    material = body.material
    if not (material.has_fields and np.isnan(material.poisson_ratio)):
        return material.poisson_ratio
    blocks = CellModuli(body.V, material).blocks(body.cells)
    ratios = (float(poisson_ratios(moduli).max()) for _, moduli in blocks)
    return float(reductions.largest(body.V.mesh.comm, max(ratios, default=-1.0)))
