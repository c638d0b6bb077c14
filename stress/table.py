"""The table of the stress suite in the documentation: one line for each scene and parameter.

    python3 -m stress.table

writes it again from ``results/stress.csv``.
"""

import csv
from collections import Counter
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

__all__ = ["read", "summary", "write_table"]

_ROOT = Path(__file__).parents[1]
_REASONS = {
    "inverted": "an element inverts",
    "pass through": "nodes would pass through",
    "sank into": "a node sinks in",
    "no convergence": "no solution",
    "largest stable": "longer than the stable step",
}
# Number of cases of a scene above which they are counted instead of listed.
_MANY = 20
_HEADER = """\
| scene | parameter | finished | stopped, state intact | energy | momenta | gap | cut |
|---|---|---|---|---|---|---|---|"""


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown table of the rows of the suite, one line for each sweep."""
    lines = [_HEADER]
    for (scene, parameter), group in groupby(rows, lambda row: (row["scene"], row["parameter"])):
        cases = list(group)
        finished = [str(row["value"]) for row in cases if row["outcome"] == "finished"]
        others = [row for row in cases if row["outcome"] != "finished"]
        stopped = [f"{row['value']}: {_reason(row)}" for row in others]
        if len(cases) > _MANY:
            finished = [f"{len(finished)} of {len(cases)}"]
            counts = Counter(_reason(row) for row in others)
            stopped = [f"{number}: {reason}" for reason, number in counts.most_common()]
        momenta = ("momentum_error", "angular_momentum_error")
        cells = [scene, parameter, ", ".join(finished), "; ".join(stopped)]
        cells += [_worst(cases, ["energy_error"]), _worst(cases, momenta)]
        cells += [_depth(cases), str(sum(row["rejected_steps"] for row in cases))]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def write_table(rows: Sequence[dict[str, Any]], root: Path = _ROOT) -> None:
    """Write the table for ``docs/stress.md``, which includes it.

    Args:
        rows: Rows of the whole suite.
        root: Of the repository.
    """
    path = root / "docs" / "tables" / "stress.md"
    path.write_text(f"{summary(rows)}\n", encoding="utf-8")


def read(path: Path) -> list[dict[str, Any]]:
    """Read the rows that the suite wrote; numbers are converted."""
    with path.open(newline="", encoding="utf-8") as file:
        rows: list[dict[str, Any]] = list(csv.DictReader(file))
    for row in rows:
        for name in row.keys() - {"scene", "parameter", "value", "outcome", "message"}:
            number = float(row[name]) if row[name] else ""
            row[name] = int(number) if name == "rejected_steps" and row[name] else number
    return rows


def _reason(row: dict[str, Any]) -> str:
    return next(
        (short for word, short in _REASONS.items() if word in row["message"]), row["message"]
    )


def _worst(cases: Sequence[dict[str, Any]], columns: Sequence[str]) -> str:
    values = [row[column] for row in cases for column in columns if row[column] != ""]
    return f"{max(values):.0e}" if values else "-"


def _depth(cases: Sequence[dict[str, Any]]) -> str:
    """Depth of the deepest node relative to the admissible depth."""
    pairs = [(row["min_gap"], row["least_allowed_gap"]) for row in cases]
    pairs = [(gap, allowed) for gap, allowed in pairs if "" not in (gap, allowed)]
    parts = [gap / allowed if allowed < 0 else 0.0 for gap, allowed in pairs]
    return f"{max(0.0, *parts):.2f}" if parts else "-"


if __name__ == "__main__":
    write_table(read(_ROOT / "results" / "stress.csv"))
