"""Leak test: memory and the number of PETSc objects stay bounded in a long run.

    python3 -m stress.endurance [STEPS]

Lets two cubes strike each other again and again, with each scheme, and says
every tenth of the run how many PETSc objects are alive and what memory the
process has. Fails if either grows.
"""

import argparse
import gc
import logging
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import dolfinx_nts as nts
from stress.meetings import cube
from stress.world import Touch, World

__all__ = ["SCHEMES", "growth", "samples"]

# Admissible growth of the memory [bytes per step]: a leaked vector has several hundred. The table
# of the recorder stores the iterations of each step.
_BYTES_PER_STEP = 64
_NUM_SAMPLES = 10
_STEPS_OF_A_MEETING = 25
SCHEMES: dict[str, tuple[Any, float, dict[str, Any]]] = {
    "EnergyMomentum": (nts.EnergyMomentum, 0.01, {}),
    "CentralDifference": (nts.CentralDifference, 0.002, {"enforcement": nts.Penalty()}),
}

_logger = logging.getLogger("stress")


def samples(scheme: str, num_steps: int) -> Iterator[tuple[int, int, int, int]]:
    """Samples of a run: steps, steps with contact, live PETSc objects, memory [bytes].

    On one rank. Objects are counted from the first use of this function in
    the process, so that only their difference has a meaning.

    Args:
        scheme: One of `SCHEMES`.
        num_steps: Number of steps, in pieces of which samples are taken.
    """
    PETSc.Log.begin()
    kind, dt, law = SCHEMES[scheme]
    parts = {"lower": cube(0.6, 1), "upper": cube(0.5, 1).at(0.02, 0.03, 0.605).flying(0, 0.1, -1)}
    world = World(MPI.COMM_SELF, parts)
    stepper = world.stepper([Touch("upper.bottom", "lower.top", law)], dt, kind)
    u, v = (function.x.array.copy() for function in (stepper.u, stepper.v))
    with (
        tempfile.TemporaryDirectory() as folder,
        nts.Recorder(f"{folder}/run", stepper, every=10**9, checkpoint_every=100) as record,
    ):
        touching = 0
        for done in range(num_steps):
            if done % _STEPS_OF_A_MEETING == 0:
                for start, put in ((u, stepper.set_displacement), (v, stepper.set_velocity)):
                    for body in stepper.bodies:
                        put(body, start.reshape(-1, 3)[body.nodes].T)
            step = stepper.advance()
            touching += step.num_active > 0
            record.write(step)
            if (done + 1) * _NUM_SAMPLES % num_steps < _NUM_SAMPLES:
                yield done + 1, touching, _alive(folder), _memory()


def growth(taken: list[tuple[int, int, int, int]]) -> str:
    """Text on quantities that grow from one sample to the next, or ""."""
    steps, touching, objects, memory = np.array(taken).T
    if not touching[0]:
        return "no contact"
    # The first samples may include one-time allocations.
    if np.any(np.diff(objects[2:]) > 0):
        return f"PETSc objects: {objects.tolist()}"
    # The least of several samples, as memory is taken in large pieces.
    pace = np.diff(memory[2:]) / np.diff(steps[2:])
    return f"memory: {pace} bytes a step" if pace.min() > _BYTES_PER_STEP else ""


def _alive(folder: str) -> int:
    """Number of PETSc objects, creations less destructions."""
    gc.collect()
    path = Path(folder) / "log"
    viewer = PETSc.Viewer().createASCII(str(path), "w")
    PETSc.Log.view(viewer)
    viewer.destroy()
    _, table = path.read_text(encoding="utf-8").split("Object Type")
    counts = re.findall(r"^ *\D+? +(\d+) +(\d+) *$", table, re.MULTILINE)
    return sum(int(created) - int(destroyed) for created, destroyed in counts)


def _memory() -> int:
    """Memory of this process [bytes]."""
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def main() -> int:
    """Run each scheme; return the number of schemes with growth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("steps", nargs="?", type=int, default=10_000)
    num_steps = parser.parse_args().steps
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    logging.getLogger("dolfinx_nts").setLevel(logging.ERROR)
    wrong = 0
    for scheme in SCHEMES:
        taken = []
        for sample in samples(scheme, num_steps):
            taken.append(sample)
            _logger.info(
                "%s: %d steps, %d with contact, %d PETSc objects, %.2f MB",
                scheme,
                *sample[:3],
                sample[3] / 1e6,
            )
        if grows := growth(taken):
            _logger.error("%s: %s", scheme, grows)
            wrong += 1
    return wrong


if __name__ == "__main__":
    sys.exit(min(main(), 1))
