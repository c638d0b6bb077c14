"""Messages of a rank in a step, in scenes with the same work and contact on each rank.

    python3 -m benchmarks.ranks [RANKS...]

As many balls as ranks strike a long plate beside each other. Prints the table of messages, which
are counted, so that ranks may share cores; 1, 2, 4 and 8 ranks take some minutes.
"""

import sys
import tempfile
from collections.abc import Sequence

from benchmarks.__main__ import count_messages
from benchmarks.tables import messages_table

__all__ = ["main"]

# Steps from the first search until nodes of all balls are active.
_CASE = {"n": 3, "h": 0.01, "skip": 0, "steps": 17, "in_a_row": True}


def main(numbers: Sequence[int]) -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        print(messages_table(count_messages([{**_CASE, "ranks": n} for n in numbers], folder)))


if __name__ == "__main__":
    main([int(n) for n in sys.argv[1:]] or [1, 2, 4, 8])
