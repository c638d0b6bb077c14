"""Drawing of cells and facets by PyVista: one canvas, one style.

PyVista is imported when it is needed. Local: one rank draws.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from dolfinx_nts.common.arrays import Floats

__all__ = ["CELLS", "FACETS", "aim", "canvas", "grid_of", "paint"]

Kinds = dict[int, tuple[int, list[int]]]

# VTK's number of a cell and its vertex order, by number of vertices.
CELLS: Kinds = {4: (10, [0, 1, 2, 3]), 8: (12, [0, 1, 3, 2, 4, 5, 7, 6])}
FACETS: Kinds = {3: (5, [0, 1, 2]), 4: (9, [0, 1, 3, 2])}

_SIZE = [960, 560]
_STYLE = {"cmap": "YlOrRd", "ambient": 0.25, "show_edges": True, "edge_opacity": 0.5}
_BAR = {
    "vertical": True,
    "position_x": 0.865,
    "position_y": 0.15,
    "height": 0.7,
    "width": 0.06,
    "fmt": "%.5g",
    "color": "black",
    "n_labels": 5,
}


@contextmanager
def canvas(*, interactive: bool = False) -> Iterator[Any]:
    """White plotter, closed at the end unless it is in a notebook.

    Args:
        interactive: For the notebook that it is called in, or else a
            window, instead of a picture.

    Raises:
        RuntimeError: There is neither a notebook nor a display.
    """
    import pyvista
    from scooby import in_ipykernel

    notebook = interactive and in_ipykernel()
    if interactive and not notebook and not _has_display():
        raise RuntimeError("expected a notebook or a display; a snapshot needs neither")
    # VTK warns that there is no display before it draws without one.
    with pyvista.vtk_verbosity("error"):
        plotter = pyvista.Plotter(off_screen=not interactive, notebook=notebook, window_size=_SIZE)
        try:
            plotter.set_background("white")
            plotter.add_axes(color="black")
            yield plotter
        finally:
            # The view in a notebook lives on.
            if not notebook:
                plotter.close()


def grid_of(kinds: Kinds, ids: Any, x: Any, values: Any, name: str) -> Any:
    """PyVista grid of cells or facets that come with their vertices.

    Args:
        kinds: `CELLS` or `FACETS`.
        ids: Numbers of the vertices in DOLFINx's order, shape ``(c, k)``.
        x: Their positions, shape ``(c, k, 3)`` [m].
        values: Values of the cells, shape ``(c,)``, which the points of
            the grid get the mean of; or of the vertices, ``(c, k)``.
        name: Name of the values.
    """
    import pyvista

    _, first, inverse = np.unique(ids, return_index=True, return_inverse=True)
    kind, order = kinds[ids.shape[1]]
    cells = inverse.reshape(ids.shape)[:, order]
    grid = pyvista.UnstructuredGrid({kind: cells}, x.reshape(-1, 3)[first])
    if values.ndim == 1:
        grid.cell_data[name] = values
        return grid.cell_data_to_point_data()
    grid.point_data[name] = values.ravel()[first]
    return grid


def paint(
    plotter: Any, grid: Any, name: str, text: str, limits: tuple[float, float] | None = None
) -> None:
    """Put a grid into the picture, in the place of the one before.

    Args:
        plotter: Plotter to use.
        grid: PyVista dataset with current positions.
        name: Field that colours it; where it is NaN the grid is grey.
        text: Written in a corner.
        limits: Range of the colours; by default that of the field.
    """
    bar = _BAR | {"title": f"{name}\n"}
    plotter.add_mesh(
        grid,
        name="bodies",
        scalars=name,
        clim=limits,
        nan_color="lightgrey",
        scalar_bar_args=bar,
        reset_camera=False,
        **_STYLE,
    )
    plotter.add_text(text, font_size=12, color="black", name="text")


def aim(plotter: Any, points: Floats, camera: Any, direction: Floats | None = None) -> None:
    """Set the camera.

    Args:
        plotter: Plotter to use.
        points: What has to be in the picture, shape ``(n, 3)`` [m].
        camera: Position, focus and upward direction as in PyVista; None:
            from a direction.
        direction: From the points towards the camera, shape ``(3,)``; by
            default +x, a little from above and aside.
    """
    if camera is not None:
        plotter.camera_position = camera
        return
    towards = np.array([1.0, -0.45, 0.35]) if direction is None else direction
    steep = abs(towards[2]) > 0.9 * np.linalg.norm(towards)
    plotter.view_vector(tuple(towards), viewup=(0.0, 1.0, 0.0) if steep else (0.0, 0.0, 1.0))
    plotter.reset_camera(bounds=np.ravel([points.min(axis=0), points.max(axis=0)], order="F"))
    plotter.camera.zoom(1.2)


def _has_display() -> bool:
    """Whether a window can open; X and Wayland say so."""
    return sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
