"""Run the impact in each installed code and write the results.

``python3 -m benchmarks.peers`` writes ``results/bench/peers.csv`` and ``peers.md``;
``python3 -m benchmarks.peers NAME FILE`` runs one code and writes its nodes.
"""

import csv
import importlib
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.errors import Series
from benchmarks.peers import calculix, scene
from benchmarks.peers.judge import judge
from benchmarks.peers.scene import Run


class Peer(NamedTuple):
    """A code, and how it treats contact.

    Attributes:
        module, function: What runs it.
        method: Contact and integrator.
    """

    module: str
    function: str
    method: str


PEERS = {
    "dolfinx_nts": Peer("ours", "run_implicit", "multipliers, energy-momentum scheme"),
    "dolfinx_nts, full rule": Peer("ours", "run_full", "the same"),
    "dolfinx_nts, explicit": Peer("ours", "run_explicit", "springs, central differences"),
    "CalculiX": Peer("calculix", "run", "face-to-face penalty, HHT"),
    "GetFEM": Peer("getfem", "run", "augmented Lagrangian, trapezoidal rule"),
    "IPC": Peer("ipc", "run", "barrier (ipctk and NumPy), trapezoidal rule"),
}
FINE = Series("ball", "EM elastic", n=18, h=(scene.H / 2,), t_end=scene.T_END)
FOLDER = Path("results") / "bench"


def run_one(name: str, path: str) -> None:
    """Run a code in this process and write its result."""
    peer = PEERS[name]
    module = importlib.import_module(f"benchmarks.peers.{peer.module}")
    run = getattr(module, peer.function)(scene.read())
    np.savez(path, *run, version=module.version())


def run_all() -> list[dict[str, Any]]:
    """Rows of the table, one for each installed code."""
    mesh, rows = scene.read(), []
    for name, peer in PEERS.items():
        if name == "CalculiX" and not calculix.command():
            print("no CalculiX: there is no ccx, which CCX may name")
            continue
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "run.npz"
            start = time.perf_counter()
            subprocess.run([sys.executable, "-m", "benchmarks.peers", name, path], check=True)
            seconds = time.perf_counter() - start
            file = np.load(path)
            x, v, *others = (file[f"arr_{i}"] for i in range(len(Run._fields)))
            run = Run(x, v, *(number.item() for number in others))
        row: dict[str, Any] = {"code": name, "version": str(file["version"])}
        row |= {"method": peer.method, "steps": len(x) - 1}
        row |= {"cpu_seconds": run.cpu_seconds, "process_seconds": seconds}
        row |= {"newton_iterations": run.newton_iterations}
        rows.append(row | judge(mesh, run)._asdict())
        print(rows[-1])
    return rows


def fine_rebound() -> float:
    """Rebound with three times the cells along each edge, no locking and half of the step [m/s]."""
    command = [sys.executable, "-m", "benchmarks.errors", json.dumps(asdict(FINE))]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    (row,) = json.loads(text.split("ROW ")[1])
    return float(row["values"]["v_z"])


def table(rows: list[dict[str, Any]]) -> str:
    """The rows for the documentation."""
    lines = [
        "| code | contact, time integration | steps | Newton iterations | CPU s of the steps | "
        "s of the process | change of energy | of linear / angular momentum | overlap [mm] | "
        "v_z(2) [m/s], error |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        newton = row["newton_iterations"]
        cells = (
            f"{row['code']} {row['version']}",
            row["method"],
            row["steps"],
            f"{newton:.0f}" if newton else "-",
            f"{row['cpu_seconds']:.3g}",
            f"{row['process_seconds']:.3g}",
            f"{row['energy_change']:.2g}",
            f"{row['momentum_error']:.1g} / {row['angular_momentum_error']:.1g}",
            f"{1e3 * row['overlap']:.1f}",
            f"{row['rebound']:.4f}, {row['rebound'] - row['fine_rebound']:+.3f}",
        )
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run all codes and write file and table."""
    rows, fine = run_all(), fine_rebound()
    rows = [row | {"fine_rebound": fine} for row in rows]
    FOLDER.mkdir(parents=True, exist_ok=True)
    with open(FOLDER / "peers.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    (FOLDER / "peers.md").write_text(table(rows))


if __name__ == "__main__":
    if len(sys.argv) == 3:
        run_one(*sys.argv[1:])
    else:
        main()
