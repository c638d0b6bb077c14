"""Run the stress suite and write its table.

    python3 -m stress.run [--jobs N] [PATTERN]

Writes ``results/stress.csv`` and, where all is as it has to be in a whole
run, ``docs/tables/stress.md``. Fails otherwise. PATTERN selects rows by name; N
rows run at a time, each in a process of its own.
"""

import argparse
import csv
import logging
import multiprocessing
import os
import re
import sys
from pathlib import Path

from mpi4py import MPI

from stress import boundaries, degenerate, impact, meetings, repeated, resting, statics, variants
from stress.rows import COLUMNS, Case, Outcome, empty_row, run
from stress.table import write_table

__all__ = ["ALL_CASES", "CASES"]

CASES: list[Case] = [
    *impact.CASES,
    *meetings.CASES,
    *repeated.CASES,
    *resting.CASES,
    *degenerate.CASES,
    *variants.CASES,
    *boundaries.CASES,
    *statics.CASES,
]

# Tests run the others and a few of the random scenes.
ALL_CASES = [*CASES, *boundaries.RANDOM]

_ROOT = Path(__file__).parents[1]
_logger = logging.getLogger("stress")


def _run(name: str) -> Outcome:
    """Run the case of a name."""
    logging.getLogger("dolfinx_nts").propagate = False
    case = next(case for case in ALL_CASES if case.name == name)
    try:
        return run(case, MPI.COMM_SELF)
    except Exception as error:
        # All other rows are run.
        logging.getLogger("stress").exception(name)
        failed = {"outcome": "failed", "message": repr(error)}
        return Outcome(empty_row(case) | failed, repr(error), 0.0)


def main() -> int:
    """Run the rows that the command line selects; return the number of wrong rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pattern", nargs="?", default="")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args()
    pattern = options.pattern
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    cases = [case for case in ALL_CASES if re.search(pattern, case.name)]
    results = _ROOT / "results"
    results.mkdir(exist_ok=True)
    rows, wrong = [], 0
    # Not forked: each process has to initialise MPI.
    with (
        (results / "stress.csv").open("w", newline="", encoding="utf-8") as file,
        multiprocessing.get_context("spawn").Pool(options.jobs) as pool,
    ):
        table = csv.DictWriter(file, COLUMNS)
        table.writeheader()
        outcomes = pool.imap(_run, [case.name for case in cases])
        for case, outcome in zip(cases, outcomes, strict=True):
            state = outcome.wrong or outcome.row["outcome"]
            _logger.info("%6.1f s  %s: %s", outcome.seconds, case.name, state)
            table.writerow(outcome.row)
            file.flush()
            rows.append(outcome.row)
            wrong += bool(outcome.wrong)
        pool.close()
        pool.join()
    if not pattern and not wrong:
        write_table(rows)
    _logger.info("%d rows, %d not as they have to be", len(rows), wrong)
    return wrong


if __name__ == "__main__":
    sys.exit(min(main(), 1))
