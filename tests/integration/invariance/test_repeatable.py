"""The same run gives the same bytes, and costs no more the longer it is."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dolfinx_nts as nts
from helpers import scenes

# A page of memory in a hundred steps; a lost vector is one in three.
BYTES_PER_STEP = 64


def test_same_run_writes_the_same_table(comm, tmp_path):
    folder = Path(comm.bcast(str(tmp_path)))
    tables = []
    for name in ("first", "second"):
        scene = scenes.blocks(comm)
        with nts.Recorder(folder / name, scene.stepper) as record:
            for step in scene.stepper.run(30 * scene.stepper.dt):
                record.write(step)
        comm.barrier()
        tables.append((folder / f"{name}.csv").read_bytes())
    assert tables[0] == tables[1]
    assert len(tables[0].splitlines()) == 32


def memory() -> int:
    """Memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.serial
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_memory_does_not_grow_with_the_number_of_steps(comm):
    scene = scenes.blocks(comm)
    x, v = scene.stepper.u.x.array.copy(), scene.stepper.v.x.array.copy()

    def run(num_runs: int) -> int:
        # Repeated collisions, since bodies that fly away would test nothing.
        for _ in range(num_runs):
            scene.stepper.u.x.array[:] = x
            for body in scene.bodies.values():
                scene.stepper.set_velocity(body, v.reshape(-1, 3)[body.nodes].T)
            for _ in range(25):
                scene.stepper.advance()
        return memory()

    growth, used = [], run(8)
    while len(growth) < 10 and min(growth, default=np.inf) > BYTES_PER_STEP:
        before, used = used, run(8)
        growth.append((used - before) / 200)
    # The least of several samples, as the allocator takes memory in large pieces.
    assert min(growth) <= BYTES_PER_STEP, f"{growth} bytes a step"


# FE_DIVBYZERO and FE_OVERFLOW of the processor, everywhere. An invalid operation
# only in NumPy: to compare with the gap of a node without segment, NaN, is one, too.
TRAPPED = """
import ctypes, sys
from mpi4py import MPI
import numpy as np
import dolfinx_nts as nts
from helpers import scenes
scene = scenes.ball_plate(MPI.COMM_WORLD, nts.EnergyMomentum)
assert ctypes.CDLL(None).feenableexcept(0x4 | 0x8) >= 0
if "divide" in sys.argv:
    ctypes.CDLL(None).log(ctypes.c_double(0.0))
with np.errstate(all="raise", under="ignore"):
    scene.run(40)
"""


def trapped(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a scene with floating-point traps in a process of its own."""
    path = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-c", TRAPPED, *arguments]
    env = os.environ | {"PYTHONPATH": path}
    return subprocess.run(command, env=env, capture_output=True, text=True)


@pytest.mark.serial
@pytest.mark.skipif(platform.machine() != "x86_64", reason="values of the flags of x86")
def test_run_passes_with_floating_point_traps():
    done = trapped()
    assert done.returncode == 0, done.stderr[-2000:]
    # The traps are on: a division by zero ends the process.
    assert trapped("divide").returncode != 0
