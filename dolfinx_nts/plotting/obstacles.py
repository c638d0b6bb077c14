"""Surfaces of obstacles near bodies."""

from functools import singledispatch
from typing import Any

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.model.obstacles import Obstacle
from dolfinx_nts.model.rigid_surface import RigidSurface
from dolfinx_nts.plotting.canvas import grid_of

__all__ = ["surface_near"]

_POINTS = 60  # of the grid along the longest side of the box in which the surface is found
# Margins of the box around the bodies [-]: of walls, and of tools, which are seen from outside.
_WALL, _TOOL = 0.03, 0.2


def surface_near(obstacle: Obstacle, points: Floats, t: float) -> Any:
    """Find the surface of an obstacle in the box around some points. Local.

    It is the zero level of the depth of the obstacle. A `RigidSurface` is drawn completely. In the
    plane the result is the area inside the obstacle, with positive depth.

    Args:
        obstacle: The obstacle.
        points: Positions, shape ``(n, 3)`` [m].
        t: Time of the position of a moving obstacle [s].

    Returns:
        PyVista surface; without points where the obstacle is not in the box.
    """
    frame = obstacle.motion.frame(t, t, obstacle.dim)
    surface = _surface(obstacle, frame.at_end(points))
    surface.points = frame.in_space(np.asarray(surface.points))
    return surface


@singledispatch
def _surface(obstacle: Obstacle, points: Floats) -> Any:
    """Surface of an obstacle where it was declared, around points in its frame, ``(n, 3)`` [m]."""
    import pyvista

    low, high = points.min(axis=0), points.max(axis=0)
    margin = (_WALL if obstacle.motion.is_rest else _TOOL) * (high - low).max()
    low, high = low - margin, high + margin
    if obstacle.dim == 2:
        low[2] = high[2] = 0.0
    spacing = (high - low).max() / _POINTS
    cells = np.ceil((high - low) / spacing).astype(int)
    step = (high - low) / np.maximum(cells, 1)
    grid = pyvista.ImageData(dimensions=cells + 1, spacing=step, origin=low)
    grid["depth"] = obstacle.depth(np.asarray(grid.points))
    if obstacle.dim == 2:
        return grid.clip_scalar(scalars="depth", value=0.0, invert=False)
    return grid.contour([0.0], scalars="depth")


@_surface.register
def _(obstacle: RigidSurface, points: Floats) -> Any:
    x = obstacle.corners
    ids = np.arange(x.shape[0] * x.shape[1]).reshape(x.shape[:2])
    return grid_of(2, ids, x, np.zeros(ids.shape), "depth")
