"""Table of the outcomes of generated cases, one line for each kind."""

from collections import Counter
from collections.abc import Sequence

from stress.generated.case import KINDS_OF_ENDS

__all__ = ["table"]


def table(rows: Sequence[tuple[str, str]]) -> str:
    """Markdown table from the kind and the outcome of each case."""
    lines = [f"| kind | cases | {' | '.join(KINDS_OF_ENDS)} |", "|---|" + "---:|" * 6]
    for kind in [*dict.fromkeys(kind for kind, _ in rows), "all"]:
        ends = Counter(end for of, end in rows if kind in (of, "all"))
        counts = (str(ends[end]) for end in KINDS_OF_ENDS)
        lines.append(f"| {kind} | {ends.total()} | {' | '.join(counts)} |")
    return "\n".join(lines)
