"""Diagrams of a run, drawn from the table that its `Recorder` wrote.

Matplotlib is imported when it is needed. Everything is local: only rank 0 draws, and the other
ranks do nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arguments import did_you_mean
from dolfinx_nts.plotting.arguments import columns
from dolfinx_nts.plotting.picture import Picture
from dolfinx_nts.plotting.scales import prefixed

__all__ = ["energies", "energy_error", "force_displacement", "forces", "ledger", "momenta"]

# Relative error [-] below which curves are round-off, and are drawn constant.
_EPSILON = float(np.finfo(np.float64).eps)
# Size of one diagram and of the margin around all [inch], and the width of the picture [pixels].
_WIDTH, _HEIGHT, _MARGIN, _PIXELS = 6.4, 2.8, 1.0, 1600

P = ParamSpec("P")


def _on_first_rank(draw: Callable[P, Picture]) -> Callable[P, Picture]:
    """Decorator: call a drawing function on the first rank only."""

    @wraps(draw)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> Picture:
        return draw(*args, **kwargs) if MPI.COMM_WORLD.rank == 0 else Picture(b"")

    return wrapper


@_on_first_rank
def energies(table: str | Path, filename: str | Path | None = None) -> Picture:
    """Draw total, kinetic, strain and contact energy over time. Local.

    Energies that are always zero are left out.

    Args:
        table: CSV file of a `Recorder`.
        filename: Picture to write, if one is wanted.

    Returns:
        The picture, which a notebook displays.

    Example:
        >>> picture = plotting.energies("run.csv", "energies.png")
    """
    rows = columns(table)
    figure, axes = _figure(1, 1)
    for name in ("total", "kinetic", "strain", "contact"):
        if np.any(energy := rows[f"{name}_energy"]):
            axes[0, 0].plot(rows["time"], energy, label=name)
    axes[0, 0].set(xlabel="time [s]", ylabel="energy [J]", ylim=(0, None))
    axes[0, 0].legend()
    return _finished(figure, filename)


@_on_first_rank
def momenta(table: str | Path, filename: str | Path | None = None) -> Picture:
    """Draw linear and angular momentum, and their drift, over time. Local.

    A relative drift below the machine epsilon is drawn as the epsilon.

    Args:
        table: CSV file of a `Recorder`.
        filename: Picture to write, if one is wanted.

    Returns:
        The picture, which a notebook displays.

    Example:
        >>> picture = plotting.momenta("run.csv", "momenta.png")
    """
    rows = columns(table)
    figure, axes = _figure(2, 2)
    kinds = (("linear", "p", "kg m/s"), ("angular", "L", "kg m²/s"))
    for (kind, symbol, unit), (above, below) in zip(kinds, axes.T, strict=True):
        names = {axis: f"{kind}_momentum_{axis}" for axis in "xyz"}
        names = {axis: name for axis, name in names.items() if name in rows.dtype.names}
        parts = np.array([rows[name] for name in names.values()])
        for axis, part, style in zip(names, parts, ("-", "--", ":"), strict=False):
            above.plot(rows["time"], part, style, linewidth=2, label=axis)
        above.set(ylabel=f"{kind} momentum {symbol} [{unit}]")
        above.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
        drift = np.linalg.norm(parts - parts[:, :1], axis=0)
        floor = _EPSILON * np.linalg.norm(parts[:, 0])
        below.semilogy(rows["time"], np.maximum(drift, floor), color="black")
        below.set(xlabel="time [s]", ylabel=f"|{symbol}(t) - {symbol}(0)| [{unit}]")
    return _finished(figure, filename)


@_on_first_rank
def energy_error(
    tables: str | Path | Mapping[str, str | Path], filename: str | Path | None = None
) -> Picture:
    """Draw the energy error of a run. Local.

    That is the change of the total energy without the work of loads, supports, damping and
    friction, relative to the largest total energy or work of the run. It is zero for conserving
    schemes, also with loads; values below the machine epsilon are drawn as the epsilon.

    Args:
        tables: CSV file of a `Recorder`, or several by the labels of their curves.
        filename: Picture to write, if one is wanted.

    Returns:
        The picture, which a notebook displays.

    Raises:
        OSError: The file cannot be read.
        TypeError: The table is not a path.
        ValueError: It is not the table of a `Recorder`, or has no rows.

    Example:
        >>> picture = plotting.energy_error("run.csv", "error.png")
        >>> runs = {"energy-momentum scheme": "run.csv"}
        >>> picture = plotting.energy_error(runs)
    """
    runs = tables if isinstance(tables, Mapping) else {"": tables}
    if not runs:
        raise ValueError("expected a table, or tables by the labels of their curves, given none")
    figure, axes = _figure(1, 1)
    for label, table in runs.items():
        time, error = _unexplained(columns(table))
        axes[0, 0].semilogy(time, np.maximum(error, _EPSILON), label=label)
    axes[0, 0].set(xlabel="time [s]", ylabel="energy error, relative [-]")
    if any(runs):
        axes[0, 0].legend()
    return _finished(figure, filename)


@_on_first_rank
def forces(table: str | Path, filename: str | Path | None = None) -> Picture:
    """Draw contact forces, and the number of nodes in contact, over time. Local.

    The force of a pair is the magnitude of the resultant on its nodes.

    Args:
        table: CSV file of a `Recorder`.
        filename: Picture to write, if one is wanted.

    Returns:
        The picture, which a notebook displays.

    Example:
        >>> picture = plotting.forces("run.csv", "forces.png")
    """
    rows = columns(table)
    figure, axes = _figure(2, 1)
    above, below = axes[:, 0]
    for name in rows.dtype.names:
        if name.startswith("pair_") and name.endswith("_force_x"):
            axes_of = [axis for axis in "xyz" if f"{name[:-1]}{axis}" in rows.dtype.names]
            parts = [rows[f"{name[:-1]}{axis}"] for axis in axes_of]
            label = name.removesuffix("_force_x").replace("_", " ")
            above.plot(rows["time"], np.linalg.norm(parts, axis=0), label=label)
            above.legend()
    above.set(ylabel="contact force [N]", ylim=(0, None))
    below.step(rows["time"], rows["active_nodes"], color="black")
    below.set(xlabel="time [s]", ylabel="nodes in contact", ylim=(0, None))
    below.yaxis.get_major_locator().set_params(integer=True)
    return _finished(figure, filename)


@_on_first_rank
def ledger(table: str | Path, filename: str | Path | None = None) -> Picture:
    """Draw the energies of a run as stacked layers over time. Local.

    Layers are the energies of the state and the dissipation by friction and damping; layers that
    are always zero are left out. The dashed line is the initial energy plus the work of loads,
    supports and obstacles. A gap between the layers and this line is energy lost by the scheme.

    Args:
        table: CSV file of a `Recorder`.
        filename: Picture to write, if one is wanted.

    Returns:
        The picture, which a notebook displays.

    Raises:
        OSError: The file cannot be read.
        TypeError: The table is not a path.
        ValueError: It is not the table of a `Recorder`, or has no rows.

    Example:
        >>> picture = plotting.ledger("run.csv", "ledger.png")
    """
    rows = columns(table)
    layers = {name: rows[f"{name}_energy"] for name in ("strain", "contact", "kinetic")}
    layers |= {f"dissipated by {name}": -rows[f"energy_{name}"] for name in ("friction", "damping")}
    layers = {name: layer for name, layer in layers.items() if np.any(layer)}
    given = rows["total_energy"][0] + rows["external_work"]
    joule, prefix = prefixed(given.max())
    figure, axes = _figure(1, 1)
    heights = [layer / joule for layer in layers.values()]
    axes[0, 0].stackplot(rows["time"], *heights, labels=layers, alpha=0.8)
    axes[0, 0].plot(rows["time"], given / joule, "k--", label="initial energy and external work")
    top = 1.3 * max(given.max() / joule, 1e-300)
    axes[0, 0].set(xlabel="time [s]", ylabel=f"energy [{prefix}J]", ylim=(0, top))
    axes[0, 0].legend(loc="upper center", ncols=3, fontsize="small")
    return _finished(figure, filename)


@_on_first_rank
def force_displacement(
    table: str | Path,
    displacement: str,
    forces: str | Sequence[str],
    filename: str | Path | None = None,
) -> Picture:
    """Draw forces over a displacement, as for a test in statics. Local.

    Args:
        table: CSV file of a `Recorder`.
        displacement: Column of the displacement [m], for instance a custom column.
        forces: Column of a force [N], or several.
        filename: Picture to write, if one is wanted.

    Returns:
        The picture, which a notebook displays.

    Raises:
        ValueError: The table has no such column.

    Example:
        >>> column = "contact_force_z"
        >>> picture = plotting.force_displacement("run.csv", "min_gap", column, "force.png")
    """
    rows = columns(table)
    names = [forces] if isinstance(forces, str) else list(forces)
    if missing := {displacement, *names} - set(rows.dtype.names):
        raise ValueError(
            f"expected columns from {list(rows.dtype.names)}, given "
            f"{sorted(missing)}{did_you_mean(min(missing), rows.dtype.names)}; "
            "Recorder(own_columns=) adds your own columns"
        )
    metre, across = prefixed(np.abs(rows[displacement]).max())
    newton, upwards = prefixed(max(np.abs(rows[name]).max() for name in names))
    figure, axes = _figure(1, 1)
    for name in names:
        label = name.replace("_", " ")
        axes[0, 0].plot(rows[displacement] / metre, rows[name] / newton, label=label)
    label = displacement.replace("_", " ")
    axes[0, 0].set(xlabel=f"{label} [{across}m]", ylabel=f"force [{upwards}N]")
    axes[0, 0].legend()
    return _finished(figure, filename)


def _figure(high: int, wide: int) -> tuple[Any, Any]:
    """Figure with a grid of diagrams, and their axes."""
    from matplotlib.figure import Figure

    size = (_WIDTH * wide, _MARGIN + _HEIGHT * high)
    figure = Figure(figsize=size, dpi=_PIXELS / size[0], layout="constrained")
    axes = figure.subplots(high, wide, squeeze=False, sharex=True)
    for panel in axes.flat:
        panel.grid(alpha=0.3)
    return figure, axes


def _unexplained(rows: Any) -> tuple[Any, Any]:
    """Times [s], and relative energy error as in `energy_error` [-]."""
    energy = rows["total_energy"]
    causes = ("loads", "supports", "obstacles", "damping", "friction")
    work = sum(rows[f"energy_{cause}"] for cause in causes)
    scale = max(np.abs(energy).max(), np.abs(work).max())
    return rows["time"], np.abs(energy - energy[0] - work) / (scale or 1.0)


def _finished(figure: Any, filename: str | Path | None) -> Picture:
    """Write a figure to a file if a name is given, and return it as a picture."""
    if filename is not None:
        figure.savefig(filename)
    return Picture.of_figure(figure)
