"""Pictures of a run, one call each.

PyVista and Matplotlib are imported when they are needed.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from dolfinx_nts.elements import Element
from dolfinx_nts.stepper import Stepper

__all__ = ["energies", "energy_error", "momenta", "snapshot"]

Floats = npt.NDArray[np.float64]

# VTK's number of a cell and its vertex order, by number of vertices.
_VTK_CELLS = {4: (10, [0, 1, 2, 3]), 8: (12, [0, 1, 3, 2, 4, 5, 7, 6])}
_EPSILON = float(np.finfo(np.float64).eps)


def snapshot(
    stepper: Stepper,
    filename: str | Path,
    *,
    colour: Literal["stress", "displacement"] = "stress",
    limits: tuple[float, float] | None = None,
    camera: Any = None,
) -> None:
    """Draw the deformed bodies in their present state. Collective.

    Args:
        stepper: Midpoint, EnergyMomentum or QuasiStatic.
        filename: PNG file to write.
        colour: Von Mises stress, taken in the middle of the cells (of
            degree 2: of their eight parts), or magnitude of the
            displacement.
        limits: Range of the colours [Pa or m]; by default that of the
            state.
        camera: Position, focus and upward direction as in PyVista; by
            default from +x, with the reference state in the frame too.

    Raises:
        OSError: The file cannot be written.
        ValueError: Another ``colour``.
    """
    if colour not in ("stress", "displacement"):
        raise ValueError(f"expected colour 'stress' or 'displacement', given {colour!r}")
    V = stepper.u.function_space
    dofmap, comm, pieces = V.dofmap, V.mesh.comm, Element.of(V).pieces
    cells = dofmap.list[np.concatenate([body.cells for body in stepper.bodies])]
    cells = cells[:, pieces].reshape(-1, pieces.shape[1])
    ids = dofmap.index_map.local_to_global(cells.ravel()).reshape(cells.shape)
    u = stepper.u.x.array.reshape(-1, 3)
    parts = comm.gather((ids, stepper.x[cells], u[cells], _von_mises(stepper)))
    error: Exception | None = None
    if comm.rank == 0:
        try:
            ids, x, u, stress = (np.concatenate(part) for part in zip(*parts, strict=True))
            values = stress if colour == "stress" else np.linalg.norm(u, axis=2)
            name = "von Mises stress [Pa]" if colour == "stress" else "displacement [m]"
            _draw(f"t = {stepper.t:.2f} s", name, ids, x, u, values, filename, limits, camera)
        except Exception as failure:
            error = failure
    if error := comm.bcast(error):
        raise error


def _draw(
    text: str,
    name: str,
    ids: Any,
    x: Any,
    u: Any,
    values: Any,
    filename: Any,
    limits: Any,
    camera: Any,
) -> None:
    """Draw cells with vertices ``ids``, positions, displacements, values."""
    import pyvista

    _, first, inverse = np.unique(ids, return_index=True, return_inverse=True)
    cell_type, order = _VTK_CELLS[ids.shape[1]]
    cells = inverse.reshape(ids.shape)[:, order]
    grid = pyvista.UnstructuredGrid({cell_type: cells}, x.reshape(-1, 3)[first])
    if values.ndim == 1:
        grid.cell_data[name] = values
        grid = grid.cell_data_to_point_data()
    else:
        grid.point_data[name] = values.ravel()[first]
    frame = np.concatenate([x, x - u]).reshape(-1, 3)
    bar: dict[str, Any] = {
        "vertical": True,
        "position_x": 0.865,
        "position_y": 0.15,
        "height": 0.7,
        "width": 0.06,
    }
    bar |= {"title": f"{name}\n", "fmt": "%.5g", "color": "black", "n_labels": 5}

    # VTK warns that there is no display before it draws without one.
    with pyvista.vtk_verbosity("error"):
        plotter = pyvista.Plotter(off_screen=True, window_size=(960, 560))
        plotter.set_background("white")
        style = {"cmap": "YlOrRd", "ambient": 0.25, "show_edges": True, "edge_opacity": 0.5}
        plotter.add_mesh(grid, scalars=name, clim=limits, scalar_bar_args=bar, **style)
        plotter.add_text(text, font_size=12, color="black")
        plotter.add_axes(color="black")
        if camera is None:
            plotter.view_vector((1.0, -0.45, 0.35), viewup=(0.0, 0.0, 1.0))
            plotter.reset_camera(bounds=np.ravel([frame.min(axis=0), frame.max(axis=0)], order="F"))
            plotter.camera.zoom(1.2)
        else:
            plotter.camera_position = camera
        plotter.screenshot(str(filename))
        plotter.close()


def _von_mises(stepper: Stepper) -> Floats:
    """Von Mises stress in the middle of the pieces of the owned cells, body by body [Pa]."""
    mesh, element = stepper.u.function_space.mesh, Element.of(stepper.u.function_space)
    middles = element.points[element.pieces].mean(axis=1)
    F = ufl.Identity(3) + ufl.grad(stepper.u)
    values = []
    for body in stepper.bodies:
        # Constants, as numbers would be compiled in.
        parameters = {k: fem.Constant(mesh, v) for k, v in body.material.parameters.items()}
        sigma = F * body.material.stress(F.T * F, **parameters) * F.T / ufl.det(F)
        stress = ufl.sqrt(1.5 * ufl.inner(ufl.dev(sigma), ufl.dev(sigma)))
        expression = fem.Expression(stress, middles)
        values.append(expression.eval(mesh, body.cells).reshape(-1))
    return np.concatenate(values)


def energies(table: str | Path, filename: str | Path) -> None:
    """Draw the energies that are not zero. Local: only rank 0 draws.

    Args:
        table: CSV file of a `Recorder`.
        filename: Picture to write.
    """
    if MPI.COMM_WORLD.rank != 0:
        return
    rows = _read(table)
    figure, axes = _figure(1, 1)
    for name in ("total", "kinetic", "strain", "contact"):
        if np.any(energy := rows[f"{name}_energy"]):
            axes[0, 0].plot(rows["time"], energy, label=name)
    axes[0, 0].set(xlabel="time [s]", ylabel="energy [J]", ylim=(0, None))
    axes[0, 0].legend()
    figure.savefig(filename)


def momenta(table: str | Path, filename: str | Path) -> None:
    """Draw linear and angular momentum. Local: only rank 0 draws.

    A drift below machine epsilon is drawn as that.

    Args:
        table: CSV file of a `Recorder`.
        filename: Picture to write.
    """
    if MPI.COMM_WORLD.rank != 0:
        return
    rows = _read(table)
    figure, axes = _figure(2, 2)
    kinds = (("linear", "p", "kg m/s"), ("angular", "L", "kg m²/s"))
    for (kind, symbol, unit), (above, below) in zip(kinds, axes.T, strict=True):
        parts = np.array([rows[f"{kind}_momentum_{axis}"] for axis in "xyz"])
        for axis, part, style in zip("xyz", parts, ("-", "--", ":"), strict=True):
            above.plot(rows["time"], part, style, linewidth=2, label=axis)
        above.set(ylabel=f"{kind} momentum {symbol} [{unit}]")
        above.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
        drift = np.linalg.norm(parts - parts[:, :1], axis=0)
        floor = _EPSILON * np.linalg.norm(parts[:, 0])
        below.semilogy(rows["time"], np.maximum(drift, floor), color="black")
        below.set(xlabel="time [s]", ylabel=f"|{symbol}(t) - {symbol}(0)| [{unit}]")
    figure.savefig(filename)


def energy_error(tables: Mapping[str, str | Path], filename: str | Path) -> None:
    """Compare energy errors of several runs. Local: only rank 0 draws.

    An error below machine epsilon is drawn as that.

    Args:
        tables: CSV file of a `Recorder` by label of its curve.
        filename: Picture to write.
    """
    if MPI.COMM_WORLD.rank != 0:
        return
    figure, axes = _figure(1, 1)
    for label, table in tables.items():
        rows = _read(table)
        error = np.abs(rows["total_energy"] / rows["total_energy"][0] - 1)
        axes[0, 0].semilogy(rows["time"], np.maximum(error, _EPSILON), label=label)
    axes[0, 0].set(xlabel="time [s]", ylabel="energy error |E(t) - E(0)| / E(0)")
    axes[0, 0].legend()
    figure.savefig(filename)


def _figure(rows: int, columns: int) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2 * columns, 1.0 + 2.4 * rows), dpi=110, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True)
    for panel in axes.flat:
        panel.grid(alpha=0.3)
    return figure, axes


def _read(table: str | Path) -> Any:
    return np.genfromtxt(table, delimiter=",", names=True)
