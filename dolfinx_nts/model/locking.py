"""Bodies whose elements lock: they can hardly deform without change of volume."""

import logging
from collections.abc import Sequence

from dolfinx_nts.fem.elements import Element
from dolfinx_nts.model.bodies import Body

__all__ = ["warn_of_locking"]

_logger = logging.getLogger("dolfinx_nts")

# Poisson's ratio of small strains [-], rounded, from which on tetrahedra and triangles of degree
# 1 are useless.
_NEARLY_INCOMPRESSIBLE = 0.45 - 1e-9
# What is told of cells of degree 1, and which would not lock.
_LOCKED = {
    "tetrahedron": ("tetrahedra of degree 1 lock", "degree 2, or hexahedra"),
    "triangle": ("triangles of degree 1 lock", "degree 2, or quadrilaterals"),
}


def warn_of_locking(bodies: Sequence[Body]) -> None:
    """Warn of nearly incompressible bodies of tetrahedra or triangles of degree 1. Local.

    No quadrature helps these: they have more cells than nodes, and each keeps its volume.

    Args:
        bodies: Bodies of one space.
    """
    V = bodies[0].V
    element = Element.of(V)
    if element.cell not in _LOCKED or element.degree > 1 or V.mesh.comm.rank > 0:
        return
    what, instead = _LOCKED[element.cell]
    deformable = [body for body in bodies if not body.is_rigid]
    names = [b.name for b in deformable if b.material.poisson_ratio >= _NEARLY_INCOMPRESSIBLE]
    if names:
        _logger.warning(
            "%s at Poisson's ratios of 0.45 and more, those of %s: "
            "energies are right for the mesh, but bodies bend and rebound as if they were far "
            "stiffer; take %s",
            what,
            ", ".join(names),
            instead,
        )
