"""Content of pictures: states from files of fields, von Mises stress, surfaces of obstacles."""

from collections.abc import Iterator
from functools import singledispatch
from pathlib import Path
from typing import Any

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.cell_stress import CellStress
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.obstacles.rigid_surface import RigidSurface
from dolfinx_nts.plotting.canvas import grid_of

__all__ = ["states", "surface_near", "von_mises"]

# Number of grid points along the longest side of the box in which the surface is computed [-], by
# dimension. Larger: smoother surfaces of small tools, more time (160 000 points in the plane, 216
# 000 in space).
_POINTS = {2: 400, 3: 60}
# Margins of the box around the bodies, relative to their extent [-]: for obstacles at rest, and for
# moving ones, which are seen from outside.
_WALL, _TOOL = 0.03, 0.2


def von_mises(stepper: Stepper) -> Floats:
    """Von Mises stress at the centres of sub-cells of owned cells, by body [Pa]. Collective."""
    middles = Element.of(stepper.u.function_space).middles
    remembered = stepper.memory.stress
    stress = CellStress(stepper.bodies, stepper.u, middles, remembered).evaluate().von_mises()
    cells = np.concatenate([body.cells for body in stepper.bodies])
    values: Floats = stress[cells].ravel()
    return values


def states(fields: str | Path) -> Iterator[tuple[float, Any]]:
    """Read time [s] and grid of PyVista of each state, undeformed. Local.

    Args:
        fields: File ``.vtkhdf`` or ``.xdmf``.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It has another suffix.
    """
    path = Path(fields)
    if path.suffix not in (".vtkhdf", ".xdmf"):
        raise ValueError(f"expected the .vtkhdf or .xdmf file of a Recorder, given {path}")
    if not path.exists():
        raise FileNotFoundError(f"expected a file of fields, given {path}, which does not exist")
    return _of_vtkhdf(path) if path.suffix == ".vtkhdf" else _of_xdmf(path)


def _of_xdmf(fields: str | Path) -> Iterator[tuple[float, Any]]:
    import pyvista

    reader = pyvista.get_reader(fields)
    for t in reader.time_values:
        reader.set_active_time_value(t)
        # Copied, as the reader writes the points of all states into the same memory.
        yield t, reader.read().copy()


def _of_vtkhdf(fields: Path) -> Iterator[tuple[float, Any]]:
    import pyvista
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(fields))
    reader.UpdateInformation()
    for number in range(reader.GetNumberOfSteps()):
        reader.SetStep(number)
        reader.Update()
        yield reader.GetTimeValue(), pyvista.wrap(reader.GetOutputDataObject(0)).copy()


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
    """Surface of an obstacle near points ``(n, 3)`` [m], both in the frame of the obstacle."""
    import pyvista

    low, high = points.min(axis=0), points.max(axis=0)
    margin = (_WALL if obstacle.motion.is_rest else _TOOL) * (high - low).max()
    low, high = low - margin, high + margin
    if obstacle.dim == 2:
        low[2] = high[2] = 0.0
    spacing = (high - low).max() / _POINTS[obstacle.dim]
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
