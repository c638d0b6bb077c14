"""Arrays lent to PETSc are released, also when the program ends."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.serial

# The stepper is a global variable, so it is there until the interpreter ends.
SCRIPT = """
import os
from mpi4py import MPI
import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.solvers.precond import factor_age, preconditioner
from helpers.scenes import blocks
from counted import counted

for name in ("CellIntegral", "IncompleteFactors", "SingleMatrix", "Segments"):
    setattr(_kernels, name, counted(getattr(_kernels, name)))
steppers = [blocks(MPI.COMM_SELF).stepper]
steppers[0].advance()
factor_age._MOST_CROSSINGS, preconditioner._DIRECT_UP_TO = 0.0, 0
steppers.append(blocks(MPI.COMM_SELF).stepper)
steppers[1].advance()
os.write(1, (str(steppers[1].statistics) + "\\n").encode())
"""
# In a module of its own, since references would keep objects alive.
COUNTED = """
import os

def counted(kind, write=os.write):
    class Counted(kind):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            write(1, f"made {kind.__name__}\\n".encode())

        def __del__(self):
            write(1, f"freed {kind.__name__}\\n".encode())
    return Counted
"""


def test_kernels_of_a_stepper_are_freed_when_the_program_ends(tmp_path):
    (tmp_path / "counted.py").write_text(COUNTED)
    (tmp_path / "script.py").write_text(SCRIPT)
    tests = Path(__file__).parents[3]
    paths = [str(tests), str(tests.parent), os.environ.get("PYTHONPATH", "")]
    result = subprocess.run(
        [sys.executable, tmp_path / "script.py"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        check=True,
    )
    lines = result.stdout.splitlines()
    assert any("GAMG" in line for line in lines)
    for name in ("CellIntegral", "IncompleteFactors", "SingleMatrix", "Segments"):
        assert lines.count(f"made {name}") == lines.count(f"freed {name}") > 0, name
    assert result.stderr == ""
