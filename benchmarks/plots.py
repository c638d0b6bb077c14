"""Figures of the benchmark."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from benchmarks.references import FINE_MESH

__all__ = ["draw"]

Rows = Sequence[Mapping[str, Any]]

# The same in every panel and figure.
_COLOURS = {
    "EM elastic": "#0072b2",
    "EM resolved": "#56b4e9",
    "EM plastic": "#cc79a7",
    "EM penalty": "#009e73",
    "EM mortar": "#882255",
    "EM resolved, mortar": "#aa4499",
    "midpoint": "#d55e00",
    "generalised-alpha": "#e69f00",
    "central differences": "#000000",
    "statics": "#0072b2",
    "statics, mortar": "#882255",
    "statics, penalty": "#009e73",
}
_MARKS = {
    "default": "o",
    "full": "s",
    "degree 2": "D",
    "tetrahedra": "^",
    "tetrahedra, degree 2": "v",
}
_LINES = {1: "-", 2: "--"}  # by the number of ranks


class _Panel(NamedTuple):
    """Curves of one quantity of a problem.

    Attributes:
        problem, quantity: Of the rows.
        title: Of the panel.
        label: Of the errors.
        n: Cells, None for all meshes.
        compares_elements: Whether elements are compared, not schemes.
    """

    problem: str
    quantity: str
    title: str
    label: str
    n: int | None = None
    compares_elements: bool = False


_SPEED, _RATIO = "error of v_z [m/s]", "relative error [-]"
_PANELS = (
    _Panel("ball", "v_z", "ball on plate, same mesh", _SPEED, n=6),
    _Panel("ball", FINE_MESH, "ball on plate, limit of meshes", _SPEED, compares_elements=True),
    _Panel("stiff ball", "v_z", "stiff ball on plate, same mesh", _SPEED),
    _Panel("tori", "v_z", "soft tori, same mesh", _SPEED),
    _Panel("bar", "rebound", "bar on wall: rebound", _RATIO),
    _Panel("two bars", "velocity handed on", "bar on bar: velocity", _RATIO),
    _Panel("striker on rod", "velocity handed on", "striker on rod: velocity", _RATIO),
    _Panel("ball on wall", "greatest force", "Hertz' impact: greatest force", _RATIO),
    _Panel("ball on wall", "duration", "Hertz' impact: duration", _RATIO),
    _Panel("braking block", "way", "block that friction stops: distance", _RATIO),
    _Panel("paraboloid", "pressure, rms error", "Hertz' pressure at the nodes, statics", _RATIO),
)


def draw(folder: Path, steps: Rows, errors: Rows) -> None:
    """Write the figures to a folder.

    Args:
        folder: Of the files ``bench_*.png``.
        steps: Rows of ``steps.csv``.
        errors: Rows of ``errors.csv``.
    """
    with plt.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        _errors(folder / "bench_errors.png", errors)
        _order(folder / "bench_order.png", errors)
        _scaling(folder / "bench_scaling.png", steps)
        _phases(folder / "bench_phases.png", steps)


def _selected(rows: Rows, **values: Any) -> list[Mapping[str, Any]]:
    return [row for row in rows if all(row[k] == v for k, v in values.items())]


def _save(figure: Any, path: Path) -> None:
    figure.tight_layout()
    figure.savefig(path, dpi=250)
    plt.close(figure)


def _curves(axes: Any, rows: Rows, x: str, y: str) -> None:
    """One curve for each scheme and element."""
    for scheme, element in dict.fromkeys((row["scheme"], row["element"]) for row in rows):
        curve = _selected(rows, scheme=scheme, element=element)
        points = sorted((row[x], row[y]) for row in curve)
        colour, mark = _COLOURS[scheme], _MARKS[element]
        axes.loglog(*zip(*points, strict=True), color=colour, marker=mark, markersize=4)


def _explain(axes: Any, rows: Rows, **where: Any) -> None:
    """Legend of the schemes and elements of some rows."""
    schemes, elements = ({row[name] for row in rows} for name in ("scheme", "element"))
    lines = [Line2D([], [], color=c, label=s) for s, c in _COLOURS.items() if s in schemes]
    if elements != {"default"}:
        lines += [
            Line2D([], [], color="grey", marker=m, linestyle="", label=e)
            for e, m in _MARKS.items()
            if e in elements
        ]
    axes.legend(handles=lines, **where)


def _slopes(axes: Any, rows: Rows, orders: Sequence[int]) -> None:
    """Lines of given orders in the step, through the middle of the points."""
    if not rows:
        return
    h = np.array(sorted({row["h"] for row in rows}))
    top = float(np.exp(np.mean(np.log([row["error"] for row in rows if row["error"] > 0]))))
    for order in orders:
        values = top * (h / np.exp(np.mean(np.log(h)))) ** order
        axes.loglog(h, values, "k:", linewidth=0.8)
        place = {"xytext": (0, 3), "textcoords": "offset points", "ha": "right"}
        axes.annotate(f"$h^{order}$", (h[-1], values[-1]), fontsize=8, **place)


def _errors(path: Path, errors: Rows) -> None:
    figure, grid = plt.subplots(4, 3, figsize=(11, 13))
    shown = []
    for axes, panel in zip(grid.flat, _PANELS, strict=False):
        rows = [
            row
            for row in _selected(errors, problem=panel.problem, quantity=panel.quantity)
            if panel.n in (None, row["n"])
        ]
        if panel.compares_elements:
            # The other schemes are as the first on any mesh.
            rows = [row for row in rows if row["scheme"] in ("EM elastic", "central differences")]
        elif panel.n:
            rows = _selected(rows, element="default")
        shown += rows
        _curves(axes, rows, "cpu_seconds", "error")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(lambda x, _: f"{x:g}" if f"{x:e}"[0] in "25" else "")
        axes.set(title=panel.title, xlabel="CPU time [s]", ylabel=panel.label)
    grid.flat[-1].axis("off")
    _explain(grid.flat[-1], shown, loc="center", fontsize=9)
    _save(figure, path)


def _order(path: Path, errors: Rows) -> None:
    figure, grid = plt.subplots(1, 2, figsize=(10, 4))
    titles = {"block": "block that stays in contact", "ball": "ball: nodes strike one by one"}
    for axes, (problem, title) in zip(grid, titles.items(), strict=True):
        rows = [
            row
            for row in _selected(errors, problem=problem, quantity="displacement")
            if row["scheme"] != "central differences"
        ]
        _curves(axes, rows, "h", "error")
        _slopes(axes, rows, (1, 2))
        steps = sorted({row["h"] for row in rows})
        axes.set_xticks(steps, [f"{h:g}" for h in steps])
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set(title=title, xlabel="step h [s]", ylabel="error of displacements, rms [m]")
        if rows:
            _explain(axes, rows, fontsize=7)
    _save(figure, path)


def _scaling(path: Path, steps: Rows) -> None:
    figure, axes = plt.subplots(figsize=(6, 4.2))
    for scheme, ranks in dict.fromkeys(
        (r["scheme"], r["ranks"]) for r in steps if r["scene"] == "contact"
    ):
        rows = _selected(steps, scene="contact", scheme=scheme, ranks=ranks)
        points = sorted((r["dofs"], 0.01 * r["wall_seconds_per_step"] / r["h"]) for r in rows)
        label = f"{scheme}, {ranks} rank{'s' if ranks > 1 else ''}"
        style = {"color": _COLOURS[scheme], "linestyle": _LINES[ranks], "marker": "o"}
        axes.loglog(*zip(*points, strict=True), markersize=5, label=label, **style)
    dofs = np.array(sorted({r["dofs"] for r in steps if r["scene"] == "contact"}), dtype=float)
    axes.loglog(dofs, 1e-5 * dofs, "k:", linewidth=0.8, label="proportional to dofs")
    axes.set(xlabel="unknowns", ylabel="wall time for 0.01 s of motion [s]")
    axes.legend(fontsize=8)
    _save(figure, path)


def _phases(path: Path, steps: Rows) -> None:
    rows = _selected(steps, scene="contact", scheme="EM elastic", ranks=1)
    names = [name for name in rows[0] if name.startswith("share: ")]
    labels = [f"{row['dofs']:,}".replace(",", " ") for row in rows]
    figure, axes = plt.subplots(figsize=(6.5, 4.2))
    bottom = np.zeros(len(rows))
    for name in names:
        share = 100 * np.array([row.get(name, 0.0) for row in rows])
        axes.bar(labels, share, bottom=bottom, label=name.removeprefix("share: "))
        bottom += share
    axes.set(xlabel="unknowns", ylabel="part of a step [%]")
    axes.grid(visible=False)
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    _save(figure, path)
