"""Check for cells without volume."""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts import compat
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.lumped_mass import nodal_volumes
from dolfinx_nts.parallel.errors import agreed

__all__ = ["check_volumes"]

# Volume of a cell relative to the cube of its size [-] that counts as zero.
_FLAT = 1e-12


def check_volumes(bodies: Sequence[Body]) -> None:
    """Check that all cells have a volume and finite nodes. Collective.

    Args:
        bodies: Bodies of one space.

    Raises:
        ValueError: A cell has no volume or a node that is not finite; the message names one.
    """
    V = bodies[0].V
    mesh, of_space = V.mesh, Element.of(V)
    # In axisymmetric meshes the area of the plane cell is checked.
    element = Element.known(of_space.cell, of_space.degree)
    with agreed(mesh.comm, "check the volumes of cells"):
        for body in bodies:
            x = mesh.geometry.x[compat.geometry_nodes(mesh)[body.cells]]
            # NaN positions give a NaN volume.
            with np.errstate(invalid="ignore"):
                volume = nodal_volumes(element, x).sum(axis=1)
            size = np.ptp(x, axis=1).max(axis=1)
            # Negated, because comparisons with NaN are false.
            flat = np.flatnonzero(~(volume > _FLAT * size**mesh.geometry.dim))
            if len(flat):
                cell = body.cells[flat[0]]
                place = " ".join(f"{value:.4g}" for value in x[flat[0]].mean(axis=0))
                raise ValueError(
                    f"expected cells with a volume, given {len(flat)} of {body.name} without, "
                    f"such as cell {mesh.topology.original_cell_index[cell]} near [{place}]"
                )
