"""Run time against error: ``python3 -m benchmarks [--size SIZE] [--folder FOLDER]``.

Writes ``steps.csv``, ``errors.csv``, ``messages.csv``, ``start.csv``, ``output.csv``, figures
and ``tables.md``, and prints the tables and whether the targets are met. Each case runs in a
process of its own, one at a time.
"""

import argparse
import compileall
import csv
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from benchmarks import cases, plots, references, tables

ROOT = Path(__file__).parents[1]

_OF_PROCESS = ("ranks", "runs")  # not of its cases


def child(module: str, argument: Any, ranks: int = 1, preload: str = "", cache: str = "") -> Any:
    """Run a module in a new MPI process and return the JSON that it prints.

    Args:
        module: The module.
        argument: Given to it as JSON.
        ranks: Number of ranks.
        preload: Library that is loaded first.
        cache: Folder of compiled kernels, if it is not that of the user.
    """
    # The environment of a process that has started MPI confuses mpirun.
    traces = ("OMPI_COMM", "PMIX_")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(traces)}
    environment["OMP_NUM_THREADS"] = "1"
    if cache:
        environment["XDG_CACHE_HOME"] = cache
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", module, json.dumps(argument)]
    if preload:
        command = ["env", f"LD_PRELOAD={preload}", *command]
    if ranks > 1:
        command = ["mpirun", "-n", str(ranks), *command]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    lines = [line for line in done.stdout.splitlines() if line.startswith("ROW ")]
    if done.returncode or not lines:
        raise RuntimeError(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    return json.loads(lines[-1].removeprefix("ROW "))


def write(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a table; columns in the order of their first use."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, names)
        table.writeheader()
        table.writerows(rows)


def progress(text: str) -> None:
    """Print the progress of the benchmark on the terminal."""
    print(f"{time.strftime('%H:%M:%S')}  {text}", file=sys.stderr, flush=True)


def taken_in_turns(
    processes: Sequence[Sequence[Mapping[str, Any]]], number: int
) -> list[dict[str, Any]]:
    """Rows of cases that alternate in one process, as medians over repeated runs."""
    runs = []
    for _ in range(number):
        rows = []
        for process in processes:
            progress(f"steps: {process}")
            own = [{k: v for k, v in case.items() if k not in _OF_PROCESS} for case in process]
            rows += child("benchmarks.steps", own, process[0].get("ranks", 1))
        runs.append(rows)
    same = (
        sorted(rows, key=lambda row: float(row["wall_seconds"])) for rows in zip(*runs, strict=True)
    )
    return [rows[number // 2] for rows in same]


def measure_steps(size: str) -> list[dict[str, Any]]:
    """Rows of ``steps.csv``."""
    rows = []
    for number, turns in groupby(cases.STEPS[size], lambda process: process[0].get("runs", 1)):
        rows += taken_in_turns(list(turns), number)
    return rows


def measure_errors(size: str) -> list[dict[str, Any]]:
    """Rows of ``errors.csv``."""
    runs = []
    for series in cases.ERRORS[size]:
        progress(f"errors: {series}")
        runs += child("benchmarks.errors", series)
    return references.rows(runs)


def count_messages(
    counted: Sequence[Mapping[str, Any]], folder: str | Path
) -> list[dict[str, Any]]:
    """Rows of ``messages.csv`` of some cases.

    Args:
        counted: Arguments of `benchmarks.messages.count`, and numbers of ranks.
        folder: Where the library that counts is put.
    """
    if shutil.which("mpicc") is None:
        progress("no messages: mpicc is not installed")
        return []
    library = Path(folder) / "libcount_messages.so"
    source = Path(__file__).parent / "count_messages.c"
    subprocess.run(["mpicc", "-shared", "-fPIC", "-O2", "-o", library, source], check=True)
    rows = []
    for case in counted:
        progress(f"messages: {case}")
        argument = {name: value for name, value in case.items() if name != "ranks"}
        rows.append(child("benchmarks.messages", argument, case["ranks"], str(library)))
    return rows


def measure_start(size: str) -> list[dict[str, Any]]:
    """Rows of ``start.csv``: with an empty cache of compiled forms, and with a full one."""
    # Bytecode as in an installation; otherwise each process would compile the package.
    compileall.compile_dir(ROOT / "dolfinx_nts", quiet=1)
    rows = []
    for law in cases.LAWS[size]:
        with tempfile.TemporaryDirectory() as cache:
            for state in ("cold", "warm"):
                progress(f"start: {law}, {state}")
                row = child("benchmarks.start", {"law": law}, cache=cache)
                rows.append({"state": state, **row})
    return rows


def measure_output(size: str) -> list[dict[str, Any]]:
    """Rows of ``output.csv``."""
    rows = []
    for case in cases.OUTPUT[size]:
        progress(f"output: {case}")
        rows.append(child("benchmarks.output", case))
    return rows


def main() -> None:
    """Run everything of a size."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", choices=sorted(cases.STEPS), default="default")
    parser.add_argument("--folder", type=Path, default=Path("results/bench"))
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    start = measure_start(arguments.size)
    write(folder / "start.csv", start)
    steps = measure_steps(arguments.size)
    write(folder / "steps.csv", steps)
    output = measure_output(arguments.size)
    write(folder / "output.csv", output)
    errors = measure_errors(arguments.size)
    write(folder / "errors.csv", errors)
    messages = count_messages(cases.MESSAGES[arguments.size], folder)
    write(folder / "messages.csv", messages)
    plots.draw(folder, steps, errors)
    text = tables.markdown(tables.Results(steps, errors, messages, start, output))
    (folder / "tables.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
