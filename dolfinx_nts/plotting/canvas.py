"""Drawing of cells and facets by PyVista, in one style for all pictures.

PyVista is imported when it is needed. Everything is local: one rank draws.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.plotting.picture import Picture
from dolfinx_nts.plotting.scales import prefixed, rounded

__all__ = [
    "Unit",
    "add_arrows",
    "add_obstacle",
    "add_outline",
    "aim",
    "canvas",
    "grid_of",
    "paint",
    "shot",
]

# VTK's cell type and vertex order, by dimension and number of vertices.
_KINDS: dict[tuple[int, int], tuple[int, list[int]]] = {
    (1, 2): (3, [0, 1]),
    (2, 3): (5, [0, 1, 2]),
    (2, 4): (9, [0, 1, 3, 2]),
    (3, 4): (10, [0, 1, 2, 3]),
    (3, 8): (12, [0, 1, 3, 2, 4, 5, 7, 6]),
}

_SIZE = [1600, 900]  # width and height of pictures [pixels]
# Limits of the height of a picture [pixels], which follows the shape of the bodies.
_HEIGHTS = (480, 1200)
# Fractions of the width and height of the picture for the bodies [-]; the rest of the width is for
# the colour bar.
_LEFT, _RIGHT, _LOW, _HIGH = 0.03, 0.84, 0.03, 0.91
# Default direction from the bodies to the camera [-]: +x, slightly from above and from the side.
_TOWARDS_CAMERA = (1.0, -0.45, 0.35)
# Cosine of the angle between the viewing direction and z [-] above which z is not the upward
# direction.
_STEEP = 0.9
# Options of PyVista for bodies and for the bar of colours; places and sizes of the bar are
# relative to the picture [-].
_STYLE = {
    "cmap": "viridis",
    "ambient": 0.35,
    "diffuse": 0.65,
    "show_edges": True,
    "edge_color": "white",
    "edge_opacity": 0.3,
    "nan_color": "lightgrey",
}
_BAR = {
    "vertical": True,
    "position_x": 0.87,
    "position_y": 0.25,
    "height": 0.62,
    "width": 0.05,
    "fmt": "%.4g",
    "color": "black",
    "title_font_size": 24,
    "label_font_size": 24,
}
# Left, lower, right and upper end of the axes, below the bar and outside of the bodies.
_TRIAD = (0.85, 0.0, 0.99, 0.2)
_TEXT = 14  # size of the text in a corner
_LABELS = 5  # number of labels of the bar, if the range is given
_ABOVE = "magenta"  # colour of values above the range
_LINE = 24  # width of coloured lines [pixels]
_BEHIND = 1e-3  # distance from lines to the bodies behind them, relative to the bodies [-]
_ARROW = 0.1  # length of the longest arrow, relative to the picture [-]


class Unit(NamedTuple):
    """Unit of the values in a picture.

    Attributes:
        symbol: Its symbol, ``""`` for numbers without one.
        free: Whether the user has given the unit: no prefix is added, and times have no unit.
    """

    symbol: str
    free: bool = False

    def scale(self, size: float) -> tuple[float, str]:
        """Divisor and SI prefix for numbers up to a given size."""
        return (1.0, "") if self.free or not self.symbol else prefixed(size)

    def seconds(self, end: float) -> tuple[float, str]:
        """Divisor and unit for times up to ``end`` [s]."""
        scale, prefix = prefixed(end)
        return (1.0, "") if self.free else (scale, f"{prefix}s")


@contextmanager
def canvas(*, interactive: bool = False) -> Iterator[Any]:
    """Context with a white plotter, which is closed at the end unless a notebook shows it.

    Args:
        interactive: Whether to draw in a notebook or a window instead of a picture.

    Yields:
        PyVista plotter.

    Raises:
        RuntimeError: There is neither a notebook nor a display.
    """
    import pyvista
    from scooby import in_ipykernel

    notebook = interactive and in_ipykernel()
    if interactive and not notebook and not _has_display():
        raise RuntimeError("expected a notebook or a display, given neither: use snapshot")
    # Suppress VTK's warning that there is no display.
    with pyvista.vtk_verbosity("error"):
        plotter = pyvista.Plotter(off_screen=not interactive, notebook=notebook, window_size=_SIZE)
        try:
            plotter.set_background("white")
            plotter.add_axes(color="black", viewport=_TRIAD)
            plotter.enable_anti_aliasing("ssaa")
            yield plotter
        finally:
            # The notebook still uses the plotter after the context.
            if not notebook:
                plotter.close()


def grid_of(dim: int, ids: Any, x: Any, values: Any, name: str) -> Any:
    """Create a PyVista grid of cells or facets, coloured by values.

    Args:
        dim: Dimension of the cells or facets, from 1 for edges to 3.
        ids: Numbers of the vertices, shape ``(c, k)``.
        x: Positions of the vertices, shape ``(c, k, 3)`` [m].
        values: Values of the vertices, shape ``(c, k)``; or of the cells, ``(c,)``, averaged at
            each point of the grid.
        name: Name of the values.

    Returns:
        The grid, in which vertices with the same number are one point.
    """
    import pyvista

    _, first, inverse = np.unique(ids, return_index=True, return_inverse=True)
    kind, order = _KINDS[dim, ids.shape[1]]
    cells = inverse.reshape(ids.shape)[:, order]
    grid = pyvista.UnstructuredGrid({kind: cells}, x.reshape(-1, 3)[first])
    if values.ndim == 1:
        grid.cell_data[name] = values
        return grid.cell_data_to_point_data()
    grid.point_data[name] = values.ravel()[first]
    return grid


def paint(
    plotter: Any,
    grid: Any,
    name: str,
    unit: Unit,
    time: tuple[float, float],
    limits: tuple[float, float] | None = None,
) -> None:
    """Draw a grid, replacing the previous one.

    Args:
        plotter: PyVista plotter.
        grid: Grid at its current positions.
        name: Name of the values that colour it; it is grey where they are NaN.
        unit: Unit of the values.
        time: Time of the picture, and largest time of all pictures, which determines the prefix
            [s].
        limits: Range of the colours; by default that of the values, rounded. Values above it have a
            special colour.
    """
    values = np.asarray(grid[name], dtype=np.float64)
    least, largest = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=-np.inf)
    low, high = limits or ((least, largest) if least <= largest else (0.0, 1.0))
    scale, prefix = unit.scale(max(abs(low), abs(high)))
    ticks = (low / scale, high / scale, _LABELS) if limits else rounded(low / scale, high / scale)
    title = f"{name} [{prefix}{unit.symbol}]" if unit.symbol else name
    grid[title] = values / scale
    plotter.add_mesh(
        grid,
        name="bodies",
        scalars=title,
        clim=ticks[:2],
        above_color=_ABOVE if limits and largest > high else None,
        scalar_bar_args=_BAR | {"title": f"{title}\n", "n_labels": ticks[2]},
        reset_camera=False,
        line_width=_LINE if grid.distinct_cell_types == {_KINDS[1, 2][0]} else None,
        **_STYLE,
    )
    t, end = time
    second, prefix = unit.seconds(end)
    text = f"t = {t / second:.3g} {prefix}".rstrip()
    place = {"position": (0.02, 0.93), "viewport": True}
    plotter.add_text(text, font_size=_TEXT, color="black", name="text", **place)


def add_outline(plotter: Any, grid: Any) -> None:
    """Draw cells of a plane mesh without colours, behind coloured objects.

    Args:
        plotter: PyVista plotter.
        grid: The cells.
    """
    style = {name: _STYLE[name] for name in ("ambient", "show_edges", "edge_opacity")}
    behind = grid.translate((0.0, 0.0, -_BEHIND * grid.length), inplace=False)
    plotter.add_mesh(behind, name="outline", color="gainsboro", reset_camera=False, **style)


def add_arrows(plotter: Any, x: Floats, vectors: Floats, size: float) -> None:
    """Draw vectors of the plane as arrows.

    Args:
        plotter: PyVista plotter.
        x: Start points, shape ``(n, 3)`` [m].
        vectors: The vectors, of any unit, shape ``(n, 3)``; zeros are skipped.
        size: Size of the picture [m]; the longest arrow is a tenth of it.
    """
    length = np.linalg.norm(vectors, axis=1)
    if (some := length > 0).any():
        longest = _ARROW * size / length.max()
        plotter.add_arrows(
            x[some], vectors[some], longest, color="black", name="arrows", reset_camera=False
        )


def add_obstacle(plotter: Any, surface: Any, number: int) -> None:
    """Draw the surface of an obstacle, transparent.

    Args:
        plotter: PyVista plotter.
        surface: Its surface, which may have no points.
        number: Number of the obstacle.
    """
    if surface.n_points:
        plotter.add_mesh(
            surface, name=f"obstacle {number}", color="grey", opacity=0.15, reset_camera=False
        )


def aim(plotter: Any, points: Floats, camera: Any, direction: Floats | None = None) -> None:
    """Set the camera of a plotter so that the scene fills the picture.

    Args:
        plotter: PyVista plotter.
        points: Positions that have to be in the picture, shape ``(n, 3)`` [m].
        camera: Direction from the points to the camera, shape ``(3,)``; or position, focus and
            upward direction as in PyVista, which stay as they are; or None.
        direction: Direction if ``camera`` is None; by default +x, slightly from above and from the
            side; +z if all points have the same z.
    """
    if camera is not None and np.ndim(camera[0]):
        plotter.camera_position = camera
        return
    is_plane = np.ptp(points[:, 2]) == 0
    usual = (0.0, 0.0, 1.0) if is_plane else _TOWARDS_CAMERA
    wanted = camera
    if camera is None and not is_plane:
        wanted = direction
    towards = np.array(usual if wanted is None else wanted, dtype=np.float64)
    towards /= np.linalg.norm(towards)
    up = np.array((0.0, 1.0, 0.0) if abs(towards[2]) > _STEEP else (0.0, 0.0, 1.0))
    right = np.cross(up, towards)
    right /= np.linalg.norm(right)
    up = np.cross(towards, right)
    # View axes: to the right, upwards, towards the camera.
    seen = points @ np.array([right, up, towards]).T
    low, high = seen.min(axis=0), seen.max(axis=0)
    width, height, depth = np.maximum(high - low, 1e-9 * np.ptp(points, axis=0).max())
    wide, tall = (_RIGHT - _LEFT) * _SIZE[0], _HIGH - _LOW
    pixels = int(np.clip(wide * height / width / tall, *_HEIGHTS)) // 16 * 16
    plotter.window_size = [_SIZE[0], pixels]
    scale = max(height / (tall * pixels), width / wide)  # metres per pixel
    middle = (low + high) / 2
    middle[0] += (0.5 - (_LEFT + _RIGHT) / 2) * _SIZE[0] * scale
    middle[1] += (0.5 - (_LOW + _HIGH) / 2) * pixels * scale
    focus = middle @ np.array([right, up, towards])
    distance = 2 * (width + height + depth)
    plotter.camera_position = [focus + distance * towards, focus, up]
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = scale * pixels / 2
    plotter.renderer.reset_camera_clipping_range()


def shot(plotter: Any, filename: str | Path | None) -> Picture:
    """Create a picture of the scene, and write it to a file if a name is given.

    Args:
        plotter: PyVista plotter.
        filename: PNG file to write, or None.

    Returns:
        The picture.
    """
    return Picture.of_pixels(plotter.screenshot(filename, return_img=True))


def _has_display() -> bool:
    """Whether a window can be opened, by the environment variables of X and Wayland."""
    return sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
