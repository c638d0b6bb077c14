"""Figures of the benchmark."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt

__all__ = ["draw"]

Rows = Sequence[Mapping[str, Any]]

_MARKS = "osD^vPX*"


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
    names = [
        row["scheme"] + (f", {row['element']}" if row["element"] != "full" else "") for row in rows
    ]
    for mark, name in zip(cycle(_MARKS), dict.fromkeys(names), strict=False):
        points = sorted((r[x], r[y]) for r, n in zip(rows, names, strict=True) if n == name)
        axes.loglog(*zip(*points, strict=True), marker=mark, markersize=4, label=name)


def _slopes(axes: Any, rows: Rows, orders: Sequence[int]) -> None:
    """Lines of given orders in the step, through the middle of the points."""
    if not rows:
        return
    h = np.array(sorted({row["h"] for row in rows}))
    top = float(np.exp(np.mean(np.log([row["error"] for row in rows if row["error"] > 0]))))
    for order in orders:
        values = top * (h / np.exp(np.mean(np.log(h)))) ** order
        axes.loglog(h, values, "k:", linewidth=0.8)
        axes.annotate(f"h^{order}", (h[-1], values[-1]), fontsize=8)


def _errors(path: Path, errors: Rows) -> None:
    panels = (
        ("ball", "v_z", 6, "ball, E = 1e5 Pa, same mesh"),
        ("stiff ball", "v_z", 6, "ball, E = 1e7 Pa, same mesh"),
        ("ball", "v_z, fine mesh", None, "ball, E = 1e5 Pa, against the limit of meshes"),
        ("bar", "rebound", None, "bar on wall, against wave theory"),
    )
    figure, grid = plt.subplots(2, 2, figsize=(10, 10))
    for axes, (scene, quantity, n, title) in zip(grid.flat, panels, strict=True):
        rows = [
            row
            for row in _selected(errors, scene=scene, quantity=quantity)
            if n is None or (row["n"] == n and row["element"] == "full")
        ]
        if quantity == "v_z, fine mesh":
            # Elements are compared; the other schemes are as the first on any mesh.
            rows = [row for row in rows if row["scheme"] in ("EM elastic", "central differences")]
        _curves(axes, rows, "cpu_seconds", "error")
        axes.set(title=title, xlabel="CPU time [s]")
        axes.set_ylabel("error of v / v0 [-]" if scene == "bar" else "error of v_z [m/s]")
        if rows:
            axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
    _save(figure, path)


def _order(path: Path, errors: Rows) -> None:
    figure, grid = plt.subplots(1, 2, figsize=(10, 4))
    titles = {"block": "block that stays in contact", "ball": "ball: nodes strike one by one"}
    for axes, (scene, title) in zip(grid, titles.items(), strict=True):
        rows = [
            row
            for row in _selected(errors, scene=scene, quantity="displacement")
            if row["scheme"] != "central differences"
        ]
        _curves(axes, rows, "h", "error")
        _slopes(axes, rows, (1, 2))
        axes.set(title=title, xlabel="step h [s]", ylabel="error of displacements, rms [m]")
        if rows:
            axes.legend(fontsize=7)
    _save(figure, path)


def _scaling(path: Path, steps: Rows) -> None:
    figure, axes = plt.subplots(figsize=(6, 4.2))
    for mark, (scheme, ranks) in zip(
        _MARKS,
        dict.fromkeys((r["scheme"], r["ranks"]) for r in steps if r["scene"] == "contact"),
        strict=False,
    ):
        rows = _selected(steps, scene="contact", scheme=scheme, ranks=ranks)
        points = sorted((r["dofs"], 0.01 * r["wall_seconds_per_step"] / r["h"]) for r in rows)
        label = f"{scheme}, {ranks} rank{'s' if ranks > 1 else ''}"
        axes.loglog(*zip(*points, strict=True), marker=mark, markersize=5, label=label)
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
