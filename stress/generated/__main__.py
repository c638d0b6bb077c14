"""Run generated cases and write their table.

    python3 -m stress.generated [--only PATTERN] [--seed N] [--sample N]

Writes ``results/generated.csv`` and, after a whole run, ``docs/tables/generated.md``.
Returns the number of cases that are silent, raise raw errors or hang.
"""

import argparse
import csv
import logging
import re
import sys
from pathlib import Path

import numpy as np

from stress.generated.case import KINDS_OF_ENDS, run
from stress.generated.cases import ALL_CASES
from stress.generated.table import table

_ROOT = Path(__file__).parents[2]


def main() -> int:
    """Run the cases that the command line selects."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="regular expression for names")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sample", type=int, default=0, help="number of cases chosen at random")
    options = parser.parse_args()
    logging.getLogger("dolfinx_nts").setLevel(logging.ERROR)
    cases = [case for case in ALL_CASES if re.search(options.only, case.name)]
    if options.sample:
        rng = np.random.default_rng(options.seed)
        chosen = rng.choice(len(cases), min(options.sample, len(cases)), replace=False)
        cases = [cases[i] for i in np.sort(chosen)]
    results = _ROOT / "results"
    results.mkdir(exist_ok=True)
    rows = []
    with (results / "generated.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("kind", "name", "end", "message", "seconds"))
        for case in cases:
            verdict = run(case, options.seed)
            rows.append((case.kind, verdict.end))
            writer.writerow((case.kind, case.name, verdict.end, verdict.message, verdict.seconds))
            file.flush()
            said = f"{verdict.seconds:5.2f} s  {verdict.end:9}  {case.name}"
            print(said, verdict.message[:160], flush=True)
    text = table(rows)
    print(text)
    if not options.only and not options.sample:
        (_ROOT / "docs" / "tables" / "generated.md").write_text(f"{text}\n", encoding="utf-8")
    return sum(end in KINDS_OF_ENDS[2:] for _, end in rows)


if __name__ == "__main__":
    sys.exit(min(main(), 1))
