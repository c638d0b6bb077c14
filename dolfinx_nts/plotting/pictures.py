"""Pictures of a run, each drawn by one function call.

`snapshot`, `show` and `contact` draw the current state of a stepper, `animate` the states in the
file of a `Recorder`, and the functions of `diagrams` its table. Only `show` needs a display.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import GlobalInts, Ints
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.components import dimension, in_space, nodal
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import on_root
from dolfinx_nts.plotting.arguments import check_stepper, check_view, numbered_pair
from dolfinx_nts.plotting.canvas import (
    Unit,
    add_arrows,
    add_obstacle,
    add_outline,
    aim,
    canvas,
    grid_of,
    paint,
    shot,
)
from dolfinx_nts.plotting.diagrams import (
    energies,
    energy_error,
    force_displacement,
    forces,
    ledger,
    momenta,
)
from dolfinx_nts.plotting.movie import Movie
from dolfinx_nts.plotting.picture import Picture
from dolfinx_nts.plotting.scales import rounded
from dolfinx_nts.plotting.scene import states, surface_near, von_mises

__all__ = [
    "animate",
    "contact",
    "energies",
    "energy_error",
    "force_displacement",
    "forces",
    "ledger",
    "momenta",
    "show",
    "snapshot",
]

# Units of the fields that a `Recorder` writes; other fields are drawn without a unit.
_UNITS = {
    "displacement": "m",
    "velocity": "m/s",
    "gap": "m",
    "contact_pressure": "Pa",
    "friction_traction": "Pa",
    "accumulated_slip": "m",
}


def snapshot(
    stepper: Stepper,
    filename: str | Path | None = None,
    *,
    colour: Literal["stress", "displacement"] = "stress",
    limits: tuple[float, float] | None = None,
    unit: str | None = None,
    camera: Any = None,
    cut: Sequence[float] | None = None,
) -> Picture:
    """Draw the deformed bodies at the current state. Collective.

    Args:
        stepper: Stepper with the state.
        filename: PNG file to write, if one is wanted.
        colour: ``"stress"`` for the von Mises stress at the midpoints of the cells (at degree 2 of
            their pieces of degree 1), or ``"displacement"`` for its magnitude.
        limits: Range of the colours [Pa or m]; by default of the state.
        unit: Symbol of the unit of the values, if it is not SI; it is used unchanged.
            By default the SI unit with a prefix that suits the numbers.
        camera: Direction to the camera, shape ``(3,)``, or position, focus and upward direction as
            in PyVista; by default from +x.
        cut: Normal of a cut through the bodies, shape ``(3,)``: cells beyond the centre of all
            bodies in this direction, in the reference state, are left out.

    Returns:
        The picture, which a notebook displays.

    Raises:
        OSError: The file cannot be written.
        ValueError: ``colour`` is unknown, or a range or direction does not fit.

    Example:
        >>> picture = plotting.snapshot(stepper, "start.png", colour="displacement")
    """
    check_stepper(stepper)
    put = _bodies(stepper, colour, limits, camera, unit, cut)

    def draw() -> Picture:
        with canvas() as plotter:
            put(plotter)
            return shot(plotter, filename)

    return on_root(stepper.u.function_space.mesh.comm, draw)


def show(
    stepper: Stepper,
    *,
    colour: Literal["stress", "displacement"] = "stress",
    limits: tuple[float, float] | None = None,
    unit: str | None = None,
    camera: Any = None,
    cut: Sequence[float] | None = None,
) -> None:
    """Show the deformed bodies interactively. Collective.

    A Jupyter notebook shows them by PyVista's backend, which is interactive with the package
    ``pyvista[jupyter]``. Elsewhere a window opens, and the function returns when it is closed.

    Args:
        stepper: Stepper with the state.
        colour: What to draw, as for `snapshot`.
        limits: Range of the colours [Pa or m], as for `snapshot`.
        unit: Symbol of the unit, as for `snapshot`.
        camera: Camera, as for `snapshot`.
        cut: Direction in which bodies are cut open, as for `snapshot`.

    Raises:
        RuntimeError: There is neither a notebook nor a display.
        ValueError: ``colour`` is unknown.

    Example:
        >>> plotting.show(stepper)
    """
    check_stepper(stepper)
    put = _bodies(stepper, colour, limits, camera, unit, cut)

    def draw() -> None:
        with canvas(interactive=True) as plotter:
            put(plotter)
            plotter.show()

    on_root(stepper.u.function_space.mesh.comm, draw)


def contact(
    stepper: Stepper,
    filename: str | Path | None = None,
    *,
    colour: Literal["pressure", "gap"] = "pressure",
    pair: int = 0,
    limits: tuple[float, float] | None = None,
    unit: str | None = None,
    camera: Any = None,
) -> Picture:
    """Draw contact pressure or gap on the nodal surface of a pair. Collective.

    A gap is grey where a node faces no segment. In the plane the surface is a line along the
    bodies, and arrows are the forces on its nodes.

    Args:
        stepper: Stepper with the state.
        filename: PNG file to write, if one is wanted.
        colour: ``"pressure"`` or ``"gap"``.
        pair: Position of the pair in ``stepper.pairs``.
        limits: Range of the colours [Pa or m]; by default the range of the state, for gaps only up
            to the size of a segment.
        unit: Symbol of the unit of the values, if it is not SI; it is used unchanged.
            By default the SI unit with a prefix that suits the numbers.
        camera: Direction to the camera, shape ``(3,)``, or position, focus and upward direction as
            in PyVista; by default opposite to the contact force, or on the side with the smallest
            gap; in the plane +z.

    Returns:
        The picture, which a notebook displays.

    Raises:
        IndexError: There is no such pair.
        OSError: The file cannot be written.
        ValueError: ``colour`` is unknown, or a range or direction does not fit.

    Example:
        >>> picture = plotting.contact(stepper, "gap.png", colour="gap")
    """
    if colour not in ("pressure", "gap"):
        raise ValueError(f"expected colour 'pressure' or 'gap', given {colour!r}")
    check_stepper(stepper)
    check_view(limits, camera)
    touching = numbered_pair(stepper, pair)
    surface, V = touching.nodes, stepper.u.function_space
    comm: MPI.Comm = V.mesh.comm
    gap = touching.gap(stepper.x)
    field = fem.Function(V)
    nodal(field)[surface.nodes, 0] = touching.pressure if colour == "pressure" else gap
    field.x.scatter_forward()
    values = nodal(field)[surface.segments, 0]
    ids = V.dofmap.index_map.local_to_global(surface.segments.ravel())
    parts = comm.gather((ids.reshape(values.shape), stepper.x[surface.segments], values))
    add_surroundings = _surroundings(stepper, touching)
    force = reductions.total(comm, touching.history.force.sum(axis=0))
    least = float(np.nanmin(gap, initial=np.inf))
    closest = reductions.least(comm, least)
    if colour == "gap" and limits is None and closest < touching.pair.segment_size:
        limits = (closest, touching.pair.segment_size)
    at = surface.nodes[np.nanargmin(gap)] if least < np.inf else 0
    _, nearest = min(comm.allgather((least, tuple(stepper.x[at]))))

    shown = _unit("Pa" if colour == "pressure" else "m", unit)

    def draw() -> Picture:
        assert parts is not None
        ids, x, values = (np.concatenate(part) for part in zip(*parts, strict=True))
        name = "contact pressure" if colour == "pressure" else "gap"
        grid = grid_of(dimension(V) - 1, ids, x, values, name)
        direction = -force if force.any() else np.array(nearest) - grid.points.mean(axis=0)
        with canvas() as plotter:
            paint(plotter, grid, name, shown, (stepper.t, stepper.t), limits)
            add_surroundings(plotter, grid.length)
            aim(plotter, grid.points, camera, direction)
            return shot(plotter, filename)

    return on_root(comm, draw)


def animate(
    fields: str | Path,
    filename: str | Path,
    *,
    colour: str = "displacement",
    limits: tuple[float, float] | None = None,
    unit: str | None = None,
    camera: Any = None,
    fps: float = 20.0,
) -> Picture:
    """Draw all states that a `Recorder` wrote as a movie. Local: only rank 0 draws.

    Args:
        fields: File ``.vtkhdf`` or ``.xdmf`` of a `Recorder` that is closed.
        filename: File to write, ``.gif``, or ``.mp4`` with the package ``imageio-ffmpeg``.
        colour: Name of a field in the file; of vectors the magnitude is drawn.
        limits: Range of the colours in the unit of the field; by default of all states.
        unit: Symbol of the unit of the values, if it is not SI; it is used unchanged.
            By default the SI unit with a prefix that suits the numbers.
        camera: Direction to the camera, shape ``(3,)``, or position, focus and upward direction as
            in PyVista; by default from +x, with all states in the picture.
        fps: States per second of the movie [1/s].

    Returns:
        The movie, which a notebook displays.

    Raises:
        FileNotFoundError: There is no file of fields.
        ModuleNotFoundError: The package for MP4 is not installed.
        ValueError: The suffix is another, or there is no such field.

    Example:
        >>> picture = plotting.animate("run.vtkhdf", "run.gif", colour="velocity", fps=10)
    """
    if MPI.COMM_WORLD.rank != 0:
        return Picture(b"")
    check_view(limits, camera)
    name = colour.replace("_", " ")
    shown = _unit(_UNITS.get(colour, ""), unit)
    times, grids = _states(fields, colour, name)
    with Movie(filename, fps) as movie, canvas() as plotter:
        values = [grid[name] for grid in grids]
        ends = rounded(float(np.nanmin(values)), float(np.nanmax(values)))
        for t, grid in zip(times, grids, strict=True):
            paint(plotter, grid, name, shown, (t, times[-1]), limits or ends[:2])
            if grid is grids[0]:
                aim(plotter, np.concatenate([other.points for other in grids]), camera)
            movie.write(plotter.screenshot(return_img=True))
    kind = "image/gif" if Path(filename).suffix == ".gif" else "video/mp4"
    return Picture(Path(filename).read_bytes(), kind)


def _states(fields: str | Path, colour: str, name: str) -> tuple[list[float], list[Any]]:
    """Read times and deformed grids of a file, with the field ``colour`` as ``name``. Local."""
    times, grids = [], []
    for t, grid in states(fields):
        if colour not in grid.array_names:
            raise ValueError(f"expected colour to be one of {grid.array_names}, given {colour!r}")
        grid.points = grid.points + grid["displacement"]
        values = grid[colour]
        grid[name] = values if values.ndim == 1 else np.linalg.norm(values, axis=1)
        times.append(t)
        grids.append(grid)
    return times, grids


def _bodies(
    stepper: Stepper,
    colour: str,
    limits: Any,
    camera: Any,
    unit: str | None,
    cut: Sequence[float] | None,
) -> Callable[[Any], None]:
    """Function that draws the bodies with a plotter on rank 0. Collective."""
    if colour not in ("stress", "displacement"):
        raise ValueError(f"expected colour 'stress' or 'displacement', given {colour!r}")
    check_view(limits, camera, cut)
    comm, u = stepper.u.function_space.mesh.comm, in_space(nodal(stepper.u))
    ids, cells = _pieces(stepper)
    parts = comm.gather((ids, stepper.x[cells], u[cells], von_mises(stepper)))
    shown = _unit("Pa" if colour == "stress" else "m", unit)
    sides = dict.fromkeys(pair.segments for pair in stepper.pairs)
    obstacles = [side for side in sides if isinstance(side, Obstacle)]

    def put(plotter: Any) -> None:
        assert parts is not None
        ids, x, u, stress = (np.concatenate(part) for part in zip(*parts, strict=True))
        values = stress if colour == "stress" else np.linalg.norm(u, axis=2)
        name = "von Mises stress" if colour == "stress" else "displacement"
        grid = grid_of(dimension(stepper.u.function_space), ids, x, values, name)
        points = x.reshape(-1, 3)
        if cut is not None:
            middle = (x - u).mean(axis=1)
            middle -= (middle.min(axis=0) + middle.max(axis=0)) / 2
            grid = grid.extract_cells(np.flatnonzero(middle @ cut <= 0))
        paint(plotter, grid, name, shown, (stepper.t, stepper.t), limits)
        surfaces = [surface_near(obstacle, points, stepper.t) for obstacle in obstacles]
        for number, surface in enumerate(surfaces):
            add_obstacle(plotter, surface, number)
        seen = [np.asarray(surface.points) for surface in surfaces if surface.n_points]
        aim(plotter, np.concatenate([points, *seen]), camera)

    return put


def _pieces(stepper: Stepper) -> tuple[GlobalInts, Ints]:
    """Global and local numbers of the nodes of the owned cells, body by body. Local."""
    V = stepper.u.function_space
    pieces = Element.of(V).pieces
    cells = V.dofmap.list[np.concatenate([body.cells for body in stepper.bodies])]
    cells = cells[:, pieces].reshape(-1, pieces.shape[1])
    return V.dofmap.index_map.local_to_global(cells.ravel()).reshape(cells.shape), cells


def _surroundings(stepper: Stepper, touching: PairState) -> Callable[[Any, float], None]:
    """Function that draws bodies and contact forces of a plane scene. Collective."""
    V = stepper.u.function_space
    if dimension(V) == 3:
        return lambda plotter, size: None
    ids, cells = _pieces(stepper)
    parts = V.mesh.comm.gather((ids, stepper.x[cells]))
    forces = V.mesh.comm.gather((stepper.x[touching.nodes.nodes], touching.history.force))

    def put(plotter: Any, size: float) -> None:
        assert parts is not None and forces is not None
        ids, x = (np.concatenate(part) for part in zip(*parts, strict=True))
        add_outline(plotter, grid_of(2, ids, x, np.zeros(ids.shape), "none"))
        at, force = (np.concatenate(part) for part in zip(*forces, strict=True))
        add_arrows(plotter, at, force, size)

    return put


def _unit(symbol: str, given: str | None) -> Unit:
    """SI unit, or the given unit."""
    return Unit(symbol) if given is None else Unit(given, free=True)
