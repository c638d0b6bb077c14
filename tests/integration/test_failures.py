"""An error on one rank ends all ranks at once, with one message and without a hang."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.parallel import errors
from helpers.scenes import blocks

# Wall time from the error to the end of the last process [s], where each rank
# has a core of its own.
LONGEST = 1.0
# Far beyond that: it hangs.
HANGS = 60.0

SCRIPT = """
import sys, time
from pathlib import Path
from mpi4py import MPI
import dolfinx_nts as nts
from dolfinx_nts.contact.implicit import contact_step
from helpers.scenes import blocks

comm, folder, where = MPI.COMM_WORLD, Path(sys.argv[1]), sys.argv[2]
ranks, checkpoint_every = [int(rank) for rank in sys.argv[3].split(",")], int(sys.argv[4]) or None
calls = 0

def fail(place):
    global calls
    if place != where or comm.rank not in ranks:
        return
    calls += 1
    if calls == 3:
        (folder / f"time_{comm.rank}").write_text(repr(time.time()))
        raise KeyError(f"injected in {place}")

def before(owner, name, place):
    function = getattr(owner, name)
    def failing(*arguments, **options):
        fail(place)
        return function(*arguments, **options)
    setattr(owner, name, failing)

def weight(t):
    fail("load")
    return 0.0, 0.0, -1.0

def update(t):
    fail("update")
    if where == "update between messages":
        fail(where)
        comm.barrier()

old = blocks(comm).stepper
stepper = nts.EnergyMomentum(
    old.bodies,
    old.pairs,
    dt=old.dt,
    loads=[nts.Gravity(old.bodies, weight)],
    update=update,
)
stepper.v.x.array[:] = old.v.x.array
stepper._state_was_set()
before(contact_step.ContactStep, "evaluate", "contact")
before(nts.Diagnostics, "balance", "write")
with nts.Recorder(folder / "run", stepper, checkpoint_every=checkpoint_every) as record:
    for step in stepper.run(until=20 * stepper.dt):
        fail("loop")
        record.write(step)
print("the run has finished")
"""


def run(folder: Path, num_ranks: int, where: str, ranks: str, checkpoint_every: int = 0) -> str:
    """Run the script; return what it wrote to stderr, after a look at the time."""
    script = folder / "script.py"
    script.write_text(SCRIPT)
    # A process that has started MPI gives its children an environment of its own.
    own = ("OMPI_COMM_", "OMPI_UNIVERSE", "PMIX_", "PMI_")
    env = {k: v for k, v in os.environ.items() if not k.startswith(own)}
    tests = Path(__file__).parents[1]
    paths = [str(tests), str(tests.parent), env.get("PYTHONPATH", "")]
    env["PYTHONPATH"] = os.pathsep.join(paths)
    command = ["mpirun", "-n", str(num_ranks), sys.executable, str(script), str(folder), where]
    command += [ranks, str(checkpoint_every)]
    lasted = []
    # The machine may be busy with something else.
    longest = LONGEST * max(1.0, max(num_ranks, os.getloadavg()[0]) / (os.cpu_count() or 1))
    while not lasted or (min(lasted) >= longest and len(lasted) < 3):
        pipe = subprocess.PIPE
        with subprocess.Popen(command, env=env, stdout=pipe, stderr=pipe, text=True) as process:
            try:
                output, error = process.communicate(timeout=HANGS)
            except subprocess.TimeoutExpired:
                # Not kill(), which would leave the ranks behind.
                process.terminate()
                raise
        raised = max(float(path.read_text()) for path in folder.glob("time_*"))
        lasted.append(time.time() - raised)
        assert process.returncode != 0
        assert "the run has finished" not in output
        assert error.count("Traceback") == 1, error
        assert error.count(f"KeyError: 'injected in {where}'") == 1, error
    assert min(lasted) < longest, f"{lasted} s"
    return error


PLACES = ["update", "update between messages", "load", "contact", "write", "loop"]


@pytest.mark.serial
@pytest.mark.alone
@pytest.mark.parametrize("where", PLACES)
@pytest.mark.parametrize(("num_ranks", "rank"), [(2, 0), (2, 1), (3, 1)])
def test_an_error_on_one_rank_ends_all_with_one_message(tmp_path, num_ranks, rank, where):
    run(tmp_path, num_ranks, where, str(rank))


@pytest.mark.serial
@pytest.mark.alone
def test_ranks_that_put_off_signals_end_as_well(tmp_path):
    run(tmp_path, 2, "loop", "1", checkpoint_every=1)


@pytest.mark.serial
@pytest.mark.alone
def test_the_same_error_on_all_ranks_is_told_once_and_nothing_is_aborted(tmp_path):
    assert "MPI_ABORT" not in run(tmp_path, 3, "loop", "0,1,2")


@pytest.fixture
def patient(monkeypatch):
    """Wait as long for the other ranks as a busy machine needs."""
    monkeypatch.setattr(errors, "_PATIENCE", HANGS)


def one_rank(comm):
    """Number of the rank that fails."""
    return comm.size - 1


def test_an_error_of_an_update_on_one_rank_can_be_caught_on_all(comm, patient, agree, refused):
    old = blocks(comm).stepper

    def update(t):
        if comm.rank == one_rank(comm) and stepper.step == 1:
            raise KeyError("made to fail")

    stepper = nts.EnergyMomentum(old.bodies, old.pairs, dt=old.dt, update=update)
    stepper.advance()
    before = stepper.u.x.array.copy()
    with refused(KeyError, "made to fail"):
        stepper.advance()
    assert agree(stepper.step == 1 and np.array_equal(before, stepper.u.x.array))


def test_a_load_that_is_not_finite_on_one_rank_is_refused_on_all(comm, patient, refused):
    old = blocks(comm).stepper

    def weight(t):
        return 0.0, 0.0, np.nan if t > 0 and comm.rank == one_rank(comm) else -1.0

    loads = [nts.Gravity(old.bodies, weight)]
    stepper = nts.EnergyMomentum(old.bodies, old.pairs, dt=old.dt, loads=loads)
    with refused(ValueError, "expected a finite Gravity"):
        stepper.advance()


def test_a_velocity_of_the_wrong_shape_on_one_rank_is_refused_on_all(comm, patient, refused):
    stepper = blocks(comm).stepper

    def velocity(X):
        return X[:2] if comm.rank == one_rank(comm) else X

    with refused(ValueError, "expected a velocity of shape"):
        stepper.set_velocity(stepper.bodies[0], velocity)


def test_an_error_that_cannot_be_sent_is_told_by_its_text(comm):
    class Unknown(Exception):
        pass

    old = blocks(comm).stepper

    def update(t):
        raise Unknown("only here")

    stepper = nts.EnergyMomentum(old.bodies, old.pairs, dt=old.dt, update=update)
    with pytest.raises(Unknown if comm.rank == 0 else RuntimeError, match="only here"):
        stepper.advance()


def test_one_process_keeps_the_hook_of_its_own(comm):
    if comm.size > 1:
        pytest.skip("for one rank")
    blocks(comm)
    assert sys.excepthook is sys.__excepthook__
