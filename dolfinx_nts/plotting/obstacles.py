"""Surfaces of obstacles, drawn where bodies are near."""

from functools import singledispatch
from typing import Any

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.model.obstacles import Obstacle
from dolfinx_nts.model.rigid_surface import RigidSurface
from dolfinx_nts.plotting.canvas import FACETS, grid_of

__all__ = ["surface_near"]

_POINTS = 60  # of the grid along the longest side of the box in which the surface is found
_MARGIN = 0.03  # of the box around the bodies [-]


@singledispatch
def surface_near(obstacle: Obstacle, points: Floats) -> Any:
    """Find the surface of an obstacle in the box around some points. Local.

    It is where the depth of the obstacle is zero. A `RigidSurface` is drawn as a whole.

    Args:
        obstacle: The obstacle.
        points: Positions, shape ``(n, 3)`` [m].

    Returns:
        PyVista surface; without points where the obstacle is not in the box.
    """
    import pyvista

    low, high = points.min(axis=0), points.max(axis=0)
    margin = _MARGIN * (high - low).max()
    low, high = low - margin, high + margin
    spacing = (high - low).max() / _POINTS
    cells = np.maximum(np.ceil((high - low) / spacing), 1).astype(int)
    grid = pyvista.ImageData(dimensions=cells + 1, spacing=(high - low) / cells, origin=low)
    grid["depth"] = obstacle.depth(np.asarray(grid.points))
    return grid.contour([0.0], scalars="depth")


@surface_near.register
def _(obstacle: RigidSurface, points: Floats) -> Any:
    x = obstacle.corners
    ids = np.arange(x.shape[0] * x.shape[1]).reshape(x.shape[:2])
    return grid_of(FACETS, ids, x, np.zeros(ids.shape), "depth")
