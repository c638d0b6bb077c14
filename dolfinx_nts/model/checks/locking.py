"""Check for volumetric locking."""

import logging
from collections.abc import Sequence

from dolfinx_nts.fem.elements import Element
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.moduli import poisson_ratio

__all__ = ["warn_of_locking"]

_logger = logging.getLogger("dolfinx_nts")

# Poisson's ratio [-] above which tetrahedra and triangles of degree 1 lock severely.
_NEARLY_INCOMPRESSIBLE = 0.45 - 1e-9
# Description of cells of degree 1 that lock, and of cells that do not.
_LOCKED = {
    "tetrahedron": ("tetrahedra of degree 1 lock", "degree 2, or hexahedra"),
    "triangle": ("triangles of degree 1 lock", "degree 2, or quadrilaterals"),
}


def warn_of_locking(bodies: Sequence[Body]) -> None:
    """Warn of isochoric bodies made of tetrahedra or triangles of degree 1. Collective.

    Materials are nearly incompressible or plastic. Reduced quadrature does not help, since there
    are more cells, with one constraint each, than nodes.

    Args:
        bodies: Bodies of one space.
    """
    V = bodies[0].V
    element = Element.of(V)
    if element.cell not in _LOCKED or element.degree > 1:
        return
    what, instead = _LOCKED[element.cell]
    deformable = [body for body in bodies if not body.is_rigid]
    plastic = [body.name for body in deformable if body.material.remembered_terms]
    names = [body.name for body in deformable if poisson_ratio(body) >= _NEARLY_INCOMPRESSIBLE]
    if V.mesh.comm.rank > 0:
        return
    if plastic:
        _logger.warning(
            "%s in isochoric plastic flow, in %s: energy is conserved, but bodies are far too "
            "stiff; use %s of degree 1",
            what,
            ", ".join(plastic),
            instead.rpartition(" ")[2],
        )
    if names:
        _logger.warning(
            "%s at Poisson's ratios of 0.45 and more, in %s: energy is conserved, but bodies are "
            "far too stiff in bending and impact; use %s",
            what,
            ", ".join(names),
            instead,
        )
