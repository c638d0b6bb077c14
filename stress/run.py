"""Run the stress suite and write its table.

    python3 -m stress.run [PATTERN]

Writes ``results/stress.csv`` and, where all is as it has to be in a whole
run, the table in README.md. Fails otherwise. PATTERN selects rows by name.
"""

import argparse
import csv
import logging
import re
import sys
from pathlib import Path

from mpi4py import MPI

from stress import degenerate, impact, meetings, repeated, resting
from stress.rows import COLUMNS, Case, run
from stress.table import replace_table

__all__ = ["CASES"]

CASES: list[Case] = [
    *impact.CASES,
    *meetings.CASES,
    *repeated.CASES,
    *resting.CASES,
    *degenerate.CASES,
]

_ROOT = Path(__file__).parents[1]
_logger = logging.getLogger("stress")


def main() -> int:
    """Run what the command line asks for; returns the number of wrong rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pattern", nargs="?", default="")
    pattern = parser.parse_args().pattern
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    logging.getLogger("dolfinx_nts").propagate = False
    cases = [case for case in CASES if re.search(pattern, case.name)]
    results = _ROOT / "results"
    results.mkdir(exist_ok=True)
    rows, wrong = [], 0
    with (results / "stress.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS)
        table.writeheader()
        for case in cases:
            outcome = run(case, MPI.COMM_WORLD)
            state = outcome.wrong or outcome.row["outcome"]
            _logger.info("%6.1f s  %s: %s", outcome.seconds, case.name, state)
            table.writerow(outcome.row)
            file.flush()
            rows.append(outcome.row)
            wrong += bool(outcome.wrong)
    if not pattern and not wrong:
        replace_table(_ROOT / "README.md", rows)
    _logger.info("%d rows, %d not as they have to be", len(rows), wrong)
    return wrong


if __name__ == "__main__":
    sys.exit(min(main(), 1))
