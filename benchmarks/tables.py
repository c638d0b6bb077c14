"""Tables and targets of the benchmark, in Markdown."""

import os
import platform
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.targets import Results, Rows, measured

__all__ = ["markdown", "messages_table"]


def markdown(results: Results) -> str:
    """All tables."""
    parts = [
        f"Measured on {machine()}; CPU time of the slowest rank, start-up excluded.",
        _targets(results),
        _steps(results.steps),
        _start(results.start),
        _output(results.output),
        _errors(results.errors),
        _orders(results.errors),
        messages_table(results.messages) if results.messages else "",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def machine() -> str:
    """Name of the processor, number of cores, system."""
    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    names = [line.split(":")[1].strip() for line in text.splitlines() if "model name" in line]
    release = platform.freedesktop_os_release().get("PRETTY_NAME", platform.system())
    return f"{names[0] if names else platform.machine()}, {os.cpu_count()} cores, {release}"


def _table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(map(_text, row)) + " |" for row in rows]
    return "\n".join(lines)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    return f"{value:,}".replace(",", " ") if isinstance(value, int) else str(value)


def _targets(results: Results) -> str:
    """Targets and measured values."""
    rows = [
        (t.name, f"{t.sign} {t.aim:g}", f"{t.sign} {t.gate:g}", value, t.verdict(value))
        for t, value in measured(results)
    ]
    return _table(("target", "aim", "gate", "measured", ""), rows) if rows else ""


def _steps(steps: Rows) -> str:
    head = (
        "scene",
        "scheme",
        "element",
        "unknowns",
        "ranks",
        "h [s]",
        "CPU s / step",
        "CPU s for 0.01 s",
        "residuals / step",
        "Newton",
        "Krylov",
        "contact",
        "peak MB",
        "energy drift",
    )
    rows = [
        (
            row["scene"],
            row["scheme"],
            row["element"],
            row["dofs"],
            row["ranks"],
            row["h"],
            row["cpu_seconds_per_step"],
            0.01 * row["cpu_seconds_per_step"] / row["h"],
            row.get("residuals_per_step", "-"),
            row["newton_iterations"] / row["steps"],
            row["krylov_iterations"] / row["steps"] if "krylov_iterations" in row else "-",
            f"{100 * row['contact_share']:.0f} %" if "contact_share" in row else "-",
            round(row["peak_mb"]),
            row["energy_drift"],
        )
        for row in steps
    ]
    return "Cost of a step (Newton and Krylov iterations per step):\n\n" + _table(head, rows)


def _errors(errors: Rows) -> str:
    """Error and cost of each run, without the displacements, which `_orders` shows."""
    keys = list(
        dict.fromkeys(
            (row["problem"], row["quantity"])
            for row in errors
            if row["quantity"] not in ("displacement", "v_y")
        )
    )
    parts = []
    for problem, quantity in keys:
        rows = [
            [row[k] for k in ("scheme", "element", "dofs", "h", "cpu_seconds", "value", "error")]
            for row in errors
            if (row["problem"], row["quantity"]) == (problem, quantity)
        ]
        head = ("scheme", "element", "unknowns", "h [s]", "CPU s", "value", "error")
        parts.append(f"{problem}, {quantity}:\n\n{_table(head, rows)}")
    return "\n\n".join(parts)


def _orders(errors: Rows) -> str:
    """Observed order of the displacements between steps."""
    rows = []
    keys = dict.fromkeys(
        (row["problem"], row["scheme"]) for row in errors if row["quantity"] == "displacement"
    )
    for problem, scheme in keys:
        points = sorted(
            (
                (row["h"], row["error"])
                for row in errors
                if (row["problem"], row["scheme"]) == (problem, scheme)
                and row["quantity"] == "displacement"
            ),
            reverse=True,
        )
        h, e = np.array(points).T
        orders = np.log(e[1:] / e[:-1]) / np.log(h[1:] / h[:-1])
        rows.append(
            (
                problem,
                scheme,
                " → ".join(f"{value:.2g}" for value in h),
                " → ".join(f"{value:.1e}" for value in e),
                ", ".join(f"{order:.2f}" for order in orders),
            )
        )
    head = ("problem", "scheme", "h [s]", "rms error of displacements [m]", "order")
    return "Order of accuracy (reference: the same scheme at a small step):\n\n" + _table(
        head, rows
    )


def _start(start: Rows) -> str:
    """Time to the first step."""
    rows = [[row[k] for k in ("law", "state", "cpu_seconds", "wall_seconds")] for row in start]
    head = ("material", "kernels", "CPU s", "wall s")
    return (
        "From the start of the process to the first step of the first impact, nothing compiled "
        "and everything, with the compilers (`psi`: an energy in UFL):\n\n" + _table(head, rows)
    )


def _output(output: Rows) -> str:
    """Cost of files."""
    rows = [
        (
            row["scheme"],
            row["n"],
            row["step_seconds"],
            f"{100 * row['row_in_steps']:.0f} %",
            f"{100 * row['row_and_fields_in_steps']:.0f} %",
        )
        for row in output
    ]
    head = ("scheme", "n", "CPU s / step", "row of the table", "row and fields")
    return "A `Recorder` in every step, relative to the step:\n\n" + _table(head, rows)


def messages_table(messages: Rows) -> str:
    """Table of rows of ``messages.csv``."""
    head = (
        "unknowns",
        "ranks",
        "ghost nodes",
        "Newton",
        "Krylov",
        "messages",
        "kB",
        "collectives",
        "kB",
        "of contact: messages",
        "kB",
        "collectives",
        "kB",
        "searches",
    )
    rows = [
        (
            row["dofs"],
            row["ranks"],
            row["ghosts"],
            row["newton_per_step"],
            row["krylov_per_step"],
            *(
                float(row[f"{prefix}{name}_per_step"]) / (1e3 if "bytes" in name else 1)
                for prefix in ("", "contact_")
                for name in ("messages", "message_bytes", "collectives", "collective_bytes")
            ),
            f"{row['searches']} in {row['steps']} steps",
        )
        for row in messages
    ]
    return "Sent in a step by the rank that sends most:\n\n" + _table(head, rows)
