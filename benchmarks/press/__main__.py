"""Run the scene in each installed code, with the contact nodes on either side; print a table.

``python3 -m benchmarks.press > docs/tables/press.md``; ``python3 -m benchmarks.press NAME SWAPPED
FILE`` runs one code and writes its nodes.
"""

import importlib
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.peers import calculix
from benchmarks.press import scene
from benchmarks.press.judge import Verdict, judge


class Peer(NamedTuple):
    """A code with one of its contact methods.

    Attributes:
        module: What runs it.
        method: Name of the method.
        text: What it is.
    """

    module: str
    method: str
    text: str


PEERS = [
    Peer("ours", "mortar", "mortar, multipliers"),
    Peer("ours", "node-to-segment", "nodes and segments, multipliers"),
    Peer("calculix", "MORTAR", "mortar, stiff springs"),
    Peer("calculix", "SURFACE TO SURFACE", "face-to-face penalty"),
    Peer("getfem", "", "augmented Lagrangian"),
]
NAMES = {"ours": "dolfinx_nts", "calculix": "CalculiX", "getfem": "GetFEM"}
COLUMNS = (
    "| code | contact | Newton iterations | CPU s | pressing force [N] | forces of both bodies, "
    "difference | error of the pressure | error of the traction | sliding force over μP | "
    "overlap |\n|" + 10 * "---|"
)


class Run(NamedTuple):
    """CPU time and result of a code."""

    cpu_seconds: float
    newton_iterations: int
    version: str
    verdict: Verdict


def run_one(number: str, swapped: str, path: str) -> None:
    """Run a code in this process and write its result."""
    peer = PEERS[int(number)]
    module = importlib.import_module(f"benchmarks.press.{peer.module}")
    x, cpu, newton = module.run(scene.read(), peer.method, swapped == "True")
    np.savez(path, x=x, cpu=cpu, newton=newton, version=module.version())


def run(number: int, swapped: bool) -> Run:
    """Run a code in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.npz"
        command = [sys.executable, "-m", "benchmarks.press", str(number), str(swapped), str(path)]
        subprocess.run(command, check=True, stdout=sys.stderr)
        file = np.load(path)
        verdict = judge(scene.read(), file["x"])
        return Run(file["cpu"].item(), file["newton"].item(), str(file["version"]), verdict)


def row(peer: Peer, runs: list[Run]) -> str:
    """Row of the table: with contact nodes on the finer side, and on the coarser side."""
    verdicts = [each.verdict for each in runs]
    cells = [
        f"{NAMES[peer.module]} {runs[0].version}",
        peer.text,
        " / ".join(f"{each.newton_iterations}" for each in runs),
        " / ".join(f"{each.cpu_seconds:.1f}" for each in runs),
        " / ".join(f"{v.force:.4f}" for v in verdicts),
        " / ".join(f"{v.balance:.0e}" for v in verdicts),
        " / ".join(f"{100 * v.pressure_error:.1f}" for v in verdicts) + " %",
        " / ".join(f"{100 * v.traction_error:.1f}" for v in verdicts) + " %",
        " / ".join(f"{v.sliding:.4f}" for v in verdicts),
        " / ".join(f"{100 * v.overlap:.1f}" for v in verdicts) + " %",
    ]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Run all codes and print the table."""
    print(COLUMNS)
    for number, peer in enumerate(PEERS):
        if peer.module == "calculix" and not calculix.command():
            print("no CalculiX: there is no ccx, which CCX may name", file=sys.stderr)
            continue
        print(row(peer, [run(number, swapped) for swapped in (False, True)]), flush=True)


if __name__ == "__main__":
    if len(sys.argv) == 4:
        run_one(*sys.argv[1:])
    else:
        main()
