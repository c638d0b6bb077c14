"""Numbers of the page on verification, measured by the tests with the fixture `table_row`.

Every test run compares them with the page. ``make verification`` runs these tests alone and
writes their results to the table of the page.
"""

import re
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

__all__ = ["ROUND_OFF", "TABLE", "Row", "differs", "numbers", "read", "write"]

TABLE = Path(__file__).parents[2] / "docs" / "tables" / "verification.md"
# Smaller values are round-off, of which only the size is reproducible.
ROUND_OFF = 1e-9
# Tolerances of numbers: relative, and units of the last printed digit.
MARGIN = 0.03
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


class Row(NamedTuple):
    """A row of the table.

    Attributes:
        section: What the file of tests is about.
        path: Of the file of tests, from the root of the project.
        case: Computed quantity.
        reference: What should come out.
        ours: What comes out.
    """

    section: str
    path: str
    case: str
    reference: str
    ours: str


def numbers(text: str) -> list[float]:
    """Numbers in a text."""
    return [float(number) for number in _NUMBER.findall(text)]


def differs(computed: str, printed: str) -> bool:
    """Whether two texts differ by more than the variation of numbers between machines."""
    if _NUMBER.sub("#", computed) != _NUMBER.sub("#", printed):
        return True
    for ours, theirs in zip(_NUMBER.findall(computed), _NUMBER.findall(printed), strict=True):
        a, b = float(ours), float(theirs)
        digit = 10.0 ** float(Decimal(theirs).as_tuple().exponent)
        if max(abs(a), abs(b)) > ROUND_OFF and abs(a - b) > MARGIN * abs(b) + 1.01 * digit:
            return True
    return False


def write(new: list[Row]) -> None:
    """Write the rows, a table for each file of tests, whole scenes before single parts.

    Rows of other files stay as they are.
    """
    files = {row.path for row in new}
    old = [row for row in read() if row.path not in files] if TABLE.exists() else []
    lines: list[str] = []
    path = ""
    parts = "tests/integration", "tests/unit"
    for row in sorted([*old, *new], key=lambda row: (row.path.startswith(parts), row.path)):
        if row.path != path:
            path = row.path
            lines += ["", f"## {row.section}", "", f"`{path}`", ""]
            lines += ["| case | reference | result |", "|---|---|---|"]
        lines.append(f"| {row.case} | {row.reference} | {row.ours} |")
    TABLE.write_text("\n".join(lines[1:]) + "\n", encoding="utf-8")


def read() -> list[Row]:
    """Rows of the table."""
    rows, section, path = [], "", ""
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            section = line[3:]
        elif line.startswith("`"):
            path = line.strip("`")
        elif line.startswith("| ") and not line.startswith("| case |"):
            rows.append(Row(section, path, *line.strip("| ").split(" | ")))
    return rows
