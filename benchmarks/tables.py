"""Tables and targets of the benchmark, in Markdown."""

import os
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["markdown"]

Rows = Sequence[Mapping[str, Any]]

_EM, _EXPLICIT = "EM elastic", "central differences"


def markdown(steps: Rows, errors: Rows, messages: Rows) -> str:
    """All tables.

    Args:
        steps: Rows of ``steps.csv``.
        errors: Rows of ``errors.csv``.
        messages: Rows of ``messages.csv``.
    """
    parts = [
        f"Measured on {machine()}; CPU time of the slowest rank, start-up excluded.",
        _targets(steps),
        _steps(steps),
        _errors(errors),
        _orders(errors),
        _messages(messages) if messages else "",
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


def _find(steps: Rows, **values: Any) -> Mapping[str, Any]:
    """First row with these values; KeyError if there is none."""
    values = {"scheme": _EM, "element": "full", "ranks": 1} | values
    for row in steps:
        if all(row[name] == value for name, value in values.items()):
            return row
    raise KeyError(str(values))


def _exponent(steps: Rows, n: int) -> float:
    """Of the growth from a mesh that was measured beside another one."""
    a = _find(steps, scene=f"beside n = {n}")
    b = _find(steps, scene="contact", n=n)
    ratio = b["cpu_seconds_per_step"] / a["cpu_seconds_per_step"]
    return float(np.log(ratio) / np.log(b["dofs"] / a["dofs"]))


def _difference(a: Mapping[str, Any], b: Mapping[str, Any]) -> float:
    """Largest relative difference of the results of two runs."""
    return max(abs(a[name] / b[name] - 1) for name in ("v_y", "v_z", "strain_energy"))


def _wide(steps: Rows, n: int, name: str) -> float:
    """Ratio of wide contact with friction to that without."""
    rows = (_find(steps, scene=f"wide {s}", scheme="statics", n=n) for s in ("friction", "contact"))
    with_friction, without = (float(row[name]) for row in rows)
    return with_friction / without


def _targets(steps: Rows) -> str:
    """What was asked for, and what came out."""

    def ratio(name: str, **values: Any) -> Callable[[], float]:
        def value() -> float:
            scene, other = values["scene"], values["other"]
            row = _find(steps, scene=scene[0], n=scene[1])
            return float(row[name] / _find(steps, scene=other[0], n=other[1])[name])

        return value

    def beside(scene: str) -> Callable[[], float]:
        def value() -> float:
            element = "default" if "default" in scene else "full"
            row, other = _find(steps, scene=scene, element=element), "beside nu = 0.499"
            name = "residuals_per_step" if scene == "thin wall" else "cpu_seconds_per_step"
            return float(row[name] / _find(steps, scene=other)[name])

        return value

    def speedup(name: str) -> float:
        one, two = (_find(steps, scene="contact", n=24, ranks=ranks) for ranks in (1, 2))
        return float(one[name] / two[name])

    def explicit(n: int) -> Mapping[str, Any]:
        return _find(steps, scene="contact", scheme=_EXPLICIT, n=n)

    cost, sizes = "cpu_seconds_per_step", (6, 12, 24, 36)
    soft = "E = 1e5, same step"
    targets: list[tuple[str, Callable[[], float], str, float]] = [
        (
            "2 688 unknowns, 100 steps [CPU s]",
            lambda: _find(steps, scene="impact", n=6)["cpu_seconds"],
            "<=",
            2.0,
        ),
        (
            "16 959 unknowns, first 20 steps [CPU s]",
            lambda: _find(steps, scene="first 20 steps", n=12)["cpu_seconds"],
            "<=",
            2.5,
        ),
        (
            "E = 1e7 against 1e5, cost of a step",
            ratio(cost, scene=("E = 1e7", 6), other=(soft, 6)),
            "<=",
            1.5,
        ),
        (
            "E = 1e7, energy drift",
            lambda: _find(steps, scene="E = 1e7", n=6)["energy_drift"],
            "<=",
            1e-10,
        ),
        (
            "118 581 unknowns, step in residual evaluations",
            lambda: _find(steps, scene="contact", n=24)["residuals_per_step"],
            "<=",
            60,
        ),
        (
            "118 581 unknowns, peak memory [MB]",
            lambda: _find(steps, scene="contact", n=24)["peak_mb"],
            "<=",
            2500,
        ),
        ("time ~ dofs^p, n = 6 to 24", lambda: _exponent(steps, 24), "<=", 1.15),
        ("time ~ dofs^p, n = 6 to 36", lambda: _exponent(steps, 36), "<=", 1.15),
        *(
            (
                f"part of contact in a step, n = {n} [%]",
                lambda n=n: 100 * _find(steps, scene="contact", n=n)["contact_share"],
                "<=",
                25,
            )
            for n in sizes
        ),
        (
            "part of contact in the whole impact, n = 6 [%]",
            lambda: 100 * _find(steps, scene="impact", n=6)["contact_share"],
            "<=",
            25,
        ),
        *(
            (
                f"central differences, step in residuals of EM elastic, n = {n}",
                lambda n=n: (
                    explicit(n)["cpu_seconds_per_step"]
                    / _find(steps, scene="contact", n=n)["residual_seconds"]
                ),
                "<=",
                1.5,
            )
            for n in sizes
        ),
        *(
            (
                f"central differences, step in evaluations of their own forces, n = {n}",
                lambda n=n: explicit(n)["residuals_per_step"],
                "<=",
                1.5,
            )
            for n in sizes
        ),
        (
            "rho = 1 against 1000, n = 24, cost of a step",
            ratio(cost, scene=("rho = 1", 24), other=("rho = 1000", 24)),
            "<=",
            5,
        ),
        (
            "exact friction, cost of a step",
            ratio(cost, scene=("friction", 12), other=("contact", 12)),
            "<=",
            2,
        ),
        (
            "friction with a spring, cost of a step",
            ratio(cost, scene=("friction, spring", 12), other=("contact", 12)),
            "<=",
            2,
        ),
        *(
            (f"{name} against 0.4, cost of a step", beside(scene), "<=", bound)
            for name, scene, bound in (
                ("nu = 0.499", "nu = 0.499", 8.0),
                ("nu = 0.499, friction,", "nu = 0.499, friction", 15.0),
                ("nu = 0.49, default element,", "nu = 0.49, default element", 3.0),
            )
        ),
        ("thin wall against thick, step in residuals", beside("thin wall"), "<=", 2.0),
        *(
            (
                f"{(n + 1) ** 2} nodes slide, Krylov iterations with friction against none",
                lambda n=n: _wide(steps, n, "krylov_iterations"),
                "<=",
                2.0,
            )
            for n in (20, 44)
        ),
        (
            "2 025 nodes slide, 66 675 unknowns [CPU s / step]",
            lambda: _find(steps, scene="wide friction", scheme="statics", n=44)[cost],
            "<=",
            2.0,
        ),
        ("2 ranks against 1, n = 24, wall time", lambda: speedup("wall_seconds"), ">=", 1.6),
        ("the same, CPU time of the slower rank", lambda: speedup("cpu_seconds"), ">=", 1.6),
        (
            "2 ranks against 1, difference of results",
            lambda: _difference(
                *(_find(steps, scene="contact", n=24, ranks=ranks) for ranks in (1, 2))
            ),
            "<=",
            1e-9,
        ),
    ]
    rows = []
    for name, measured, relation, bound in targets:
        try:
            value = measured()
        except KeyError:
            continue
        met = value <= bound if relation == "<=" else value >= bound
        sign = {"<=": "≤", ">=": "≥"}[relation]
        rows.append((name, f"{sign} {bound:g}", float(value), "met" if met else "**missed**"))
    return _table(("target", "asked", "measured", ""), rows) if rows else ""


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
    """Error and cost of each run, but for the displacements of `_orders`."""
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


def _messages(messages: Rows) -> str:
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
