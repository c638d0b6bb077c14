"""Pictures of a run: deformed bodies, energies, momenta, energy error.

One call a picture. PyVista and Matplotlib are imported when they are needed.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from mpi4py import MPI

import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from dolfinx_nts.integrators import EnergyMomentum, Midpoint

__all__ = ["energies", "energy_error", "momenta", "snapshot"]

Floats = npt.NDArray[np.float64]

_VTK_CELLS = {4: (10, [0, 1, 2, 3]), 8: (12, [0, 1, 3, 2, 4, 5, 7, 6])}  # type, order


def snapshot(
    stepper: Midpoint | EnergyMomentum,
    filename: str | Path,
    *,
    colour: Literal["stress", "displacement"] = "stress",
    limits: tuple[float, float] | None = None,
    camera: Any = None,
) -> None:
    """Draw the deformed bodies into a PNG file. Collective.

    Args:
        stepper: Midpoint or EnergyMomentum, drawn in its present state.
        filename: Picture to write.
        colour: Von Mises stress, from the middle of the cells, or
            magnitude of the displacement.
        limits: Range of the colours [Pa or m]; by default that of the
            picture.
        camera: Camera position of PyVista: position, focus, up. By
            default from the side of +x, in a frame that holds the
            reference and the present state.

    Raises:
        ValueError: Another ``colour``.
    """
    if colour not in ("stress", "displacement"):
        raise ValueError(f"expected colour 'stress' or 'displacement', given {colour!r}")
    V = stepper.u.function_space
    dofmap, comm = V.dofmap, V.mesh.comm
    cells = np.concatenate([body.cells for body in stepper.bodies])
    nodes = dofmap.index_map.local_to_global(dofmap.list[cells].ravel())
    local = dofmap.list[cells].ravel()
    u = stepper.u.x.array.reshape(-1, 3)
    parts = comm.gather((nodes, stepper.x[local], u[local], _von_mises(stepper)))
    if comm.rank != 0:
        return

    import pyvista

    ids, x, displacement, stress = (np.concatenate(part) for part in zip(*parts, strict=True))
    _, first, inverse = np.unique(ids, return_index=True, return_inverse=True)
    size = dofmap.list.shape[1]
    cell_type, order = _VTK_CELLS[size]
    grid = pyvista.UnstructuredGrid({cell_type: inverse.reshape(-1, size)[:, order]}, x[first])
    if colour == "stress":
        name = "von Mises stress [Pa]"
        grid.cell_data[name] = stress
        grid = grid.cell_data_to_point_data()
    else:
        name = "displacement [m]"
        grid.point_data[name] = np.linalg.norm(displacement[first], axis=1)
    X = x - displacement
    box = np.column_stack([np.minimum(x, X).min(axis=0), np.maximum(x, X).max(axis=0)]).ravel()

    # Without a display VTK warns before it draws without one.
    with pyvista.vtk_verbosity("error"):
        plotter = pyvista.Plotter(off_screen=True, window_size=(900, 560))
        plotter.set_background("white")
        plotter.add_mesh(
            grid,
            scalars=name,
            clim=limits,
            cmap="YlOrRd",
            ambient=0.25,
            show_edges=True,
            edge_opacity=0.5,
            scalar_bar_args={
                "title": name,
                "fmt": "%.4g",
                "color": "black",
                "n_labels": 5,
                "vertical": True,
                "position_x": 0.86,
                "position_y": 0.15,
                "height": 0.7,
                "width": 0.06,
            },
        )
        plotter.add_text(f"t = {stepper.t:.2f} s", font_size=12, color="black")
        plotter.add_axes(color="black")
        if camera is None:
            plotter.view_vector((1.0, -0.45, 0.35), viewup=(0.0, 0.0, 1.0))
            plotter.reset_camera(bounds=box)
            plotter.camera.zoom(1.2)
        else:
            plotter.camera_position = camera
        plotter.screenshot(str(filename))
        plotter.close()


def energies(table: str | Path, filename: str | Path) -> None:
    """Draw kinetic, strain and total energy over time, on rank 0.

    Args:
        table: CSV file of a `Recorder`.
        filename: Picture to write.
    """
    if MPI.COMM_WORLD.rank == 0:
        rows = _read(table)
        figure, (axes,) = _figure(1, 1)
        for name in ("total", "kinetic", "strain"):
            axes.plot(rows["time"], rows[f"{name}_energy"], label=name)
        axes.set(xlabel="time [s]", ylabel="energy [J]", ylim=(0, None))
        axes.legend()
        figure.savefig(filename)


def momenta(table: str | Path, filename: str | Path) -> None:
    """Draw linear and angular momentum and their drift, on rank 0.

    Args:
        table: CSV file of a `Recorder`.
        filename: Picture to write.
    """
    if MPI.COMM_WORLD.rank == 0:
        rows = _read(table)
        figure, panels = _figure(2, 2)
        for kind, unit, (above, below) in zip(
            ("linear", "angular"),
            ("kg m/s", "kg m²/s"),  # noqa: RUF001
            np.transpose(np.reshape(panels, (2, 2))),
            strict=True,
        ):
            parts = np.array([rows[f"{kind}_momentum_{axis}"] for axis in "xyz"])
            for axis, part, style in zip("xyz", parts, ("-", "--", ":"), strict=True):
                above.plot(rows["time"], part, style, linewidth=2, label=axis)
            above.set(ylabel=f"{kind} momentum [{unit}]")
            above.legend(loc="center right")
            drift = np.linalg.norm(parts - parts[:, :1], axis=0)
            _log(below, rows["time"], drift, color="black")
            below.set(xlabel="time [s]", ylabel=f"its drift [{unit}]")
        figure.savefig(filename)


def energy_error(tables: Mapping[str, str | Path], filename: str | Path) -> None:
    """Draw the relative energy error of several runs, on rank 0.

    Args:
        tables: CSV file of a `Recorder` by label of the curve.
        filename: Picture to write.
    """
    if MPI.COMM_WORLD.rank == 0:
        figure, (axes,) = _figure(1, 1)
        for label, table in tables.items():
            rows = _read(table)
            start = rows["total_energy"][0]
            error = np.abs(rows["total_energy"] - start) / start
            _log(axes, rows["time"], error, label=label)
        axes.set(xlabel="time [s]", ylabel="relative energy error |E(t) - E(0)| / E(0)")
        axes.legend()
        figure.savefig(filename)


def _von_mises(stepper: Midpoint | EnergyMomentum) -> Floats:
    """Von Mises stress in the middle of the owned cells, body by body [Pa]."""
    mesh = stepper.u.function_space.mesh
    corners = basix.geometry(basix.CellType[mesh.topology.cell_name()])
    F = ufl.Identity(3) + ufl.grad(stepper.u)
    values = []
    for body in stepper.bodies:
        # Constants, as numbers would be compiled in.
        parameters = {k: fem.Constant(mesh, v) for k, v in body.material.parameters.items()}
        S = body.material.stress(F.T * F, **parameters)
        sigma = F * S * F.T / ufl.det(F)
        deviator = ufl.dev(sigma)
        stress = ufl.sqrt(1.5 * ufl.inner(deviator, deviator))
        expression = fem.Expression(stress, corners.mean(axis=0, keepdims=True))
        values.append(expression.eval(mesh, body.cells).reshape(-1))
    return np.concatenate(values)


def _figure(rows: int, columns: int) -> tuple[Any, list[Any]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2 * columns, 1.0 + 2.4 * rows), dpi=110, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    for panel in axes:
        panel.grid(alpha=0.3)
    return figure, list(axes)


def _log(axes: Any, t: Floats, values: Floats, **style: Any) -> None:
    """Curve on a logarithmic axis, without zeros."""
    axes.semilogy(t, np.where(values > 0, values, np.nan), **style)


def _read(table: str | Path) -> Any:
    return np.genfromtxt(table, delimiter=",", names=True)
