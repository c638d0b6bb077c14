"""The same run gives the same bytes, and costs no more the longer it is."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dolfinx_nts as nts
import scenes

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
        # The same collision again and again, not bodies that fly away.
        for _ in range(num_runs):
            scene.stepper.u.x.array[:] = x
            for body in scene.bodies.values():
                scene.stepper.set_velocity(body, v.reshape(-1, 3)[body.nodes].T)
            for _ in range(25):
                scene.stepper.advance()
        return memory()

    run(8)
    growth = np.diff([run(8) for _ in range(4)]) / 200
    # The least of some: the allocator takes memory in large pieces.
    assert growth.min() <= BYTES_PER_STEP, f"{growth} bytes a step"


@pytest.mark.serial
def test_run_raises_no_floating_point_trap():
    """PETSc stops at the first division by zero, overflow or invalid operation."""
    script = "from mpi4py import MPI; import scenes; scenes.ball_plate(MPI.COMM_WORLD).run(40)"
    tests = str(Path(__file__).parents[1])
    path = os.pathsep.join([tests, os.environ.get("PYTHONPATH", "")])
    env = os.environ | {"PYTHONPATH": path, "PETSC_OPTIONS": "-fp_trap"}
    done = subprocess.run([sys.executable, "-c", script], env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
