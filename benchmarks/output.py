"""Cost of files: a row of the table and a state of the fields in each step.

Run as ``python3 -m benchmarks.output '{"scheme": ..., "n": ...}'``, which prints a row of
``output.csv`` as JSON. Writing and stepping are timed in the same run.
"""

import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from mpi4py import MPI

import dolfinx_nts as nts
from benchmarks.scenes import ball_on_plate

__all__ = ["measure"]

_STEPS, _T_START = 40, 0.05


def measure(scheme: str, n: int) -> dict[str, Any]:
    """Row of ``output.csv``: CPU time of a step, of a row with fields and of a row alone [s].

    Args:
        scheme: Key of `scenes.SCHEMES`.
        n: Cells along an edge of the ball.
    """
    h = None if scheme == "central differences" else 0.01
    row: dict[str, Any] = {"scheme": scheme, "n": n, "steps": _STEPS}
    for name, every in (("row_and_fields", 1), ("row", _STEPS + 1)):
        stepper = ball_on_plate(MPI.COMM_SELF, scheme, h, n=n).stepper
        for _ in stepper.run(until=_T_START):
            pass
        step_seconds = write_seconds = 0.0
        with (
            tempfile.TemporaryDirectory() as folder,
            nts.Recorder(Path(folder) / "run", stepper, every=every) as record,
        ):
            for _ in range(_STEPS):
                start = time.process_time()
                report = stepper.advance()
                middle = time.process_time()
                record.write(report)
                step_seconds += middle - start
                write_seconds += time.process_time() - middle
        row["step_seconds"] = step_seconds / _STEPS
        row[f"{name}_seconds"] = write_seconds / _STEPS
        row[f"{name}_in_steps"] = write_seconds / step_seconds
    return row


if __name__ == "__main__":
    print("ROW", json.dumps(measure(**json.loads(sys.argv[1]))))
