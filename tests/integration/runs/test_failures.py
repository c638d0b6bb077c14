"""An error on one rank ends all ranks immediately, with one message and without a hang."""

import os
import re
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.parallel import errors
from helpers.scenes import blocks

pytestmark = pytest.mark.at_most_two_ranks

# Wall time from the error to the end of the last process [s], where each rank
# has a core of its own.
LONGEST = 2.0
# Far above that time: the run hangs.
HANGS = 60.0

SCRIPT = """
import sys, time
from pathlib import Path
from mpi4py import MPI
from dolfinx import fem
import ufl
import dolfinx_nts as nts
from dolfinx_nts.contact.implicit import contact_step
from helpers.scenes import blocks

comm, folder, where = MPI.COMM_WORLD, Path(sys.argv[1]), sys.argv[2]
ranks, checkpoint_every = [int(rank) for rank in sys.argv[3].split(",")], int(sys.argv[4]) or None
place, _, exits = where.partition(", ")
late = ["update", "update between messages", "load", "contact", "write", "loop", "break"]
calls = dict.fromkeys(late, -2)

def goes_wrong(here):
    if place != here or comm.rank not in ranks:
        return False
    calls[here] = calls.get(here, 0) + 1
    if calls[here] == 1:
        (folder / f"time_{comm.rank}").write_text(repr(time.time()))
    return calls[here] == 1

def fail(here):
    if goes_wrong(here):
        if exits:
            sys.exit(3)
        raise KeyError(f"injected in {here}")

def before(owner, name, here):
    function = getattr(owner, name)
    def failing(*arguments, **options):
        fail(here)
        return function(*arguments, **options)
    setattr(owner, name, failing)

def failing(here, result):
    def function(*arguments, **parameters):
        fail(here)
        return result(*arguments, **parameters)
    return function

def update(t):
    fail("update")
    if place == "update between messages":
        fail(place)
        comm.barrier()

def box(model):
    fail("mesh")
    nts.parts.add_box(model, "box", corner=(0, 0, 0), size=(1, 1, 1), cells=(3, 2, 2))

mesh, cells, facets, tag = nts.read_mesh(box, comm)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
rubber = nts.Hyperelastic(
    failing("energy", lambda C, mu: mu / 2 * (ufl.tr(C) - 3 - ufl.ln(ufl.det(C)))), rho=1.0, mu=1.0
)
body = nts.Body(V, cells, tag["box"], rubber)
nts.boundary_of(body, where=failing("boundary_of", lambda x: x[2] > 0.9))
nts.Surface.where(V, failing("Surface.where", lambda x: x[2] > 0.9))
old = blocks(comm).stepper
space = old.u.function_space
loads = [
    nts.Gravity(old.bodies, failing("first load", lambda t: (0.0, 0.0, -1.0))),
    nts.Gravity(old.bodies, failing("load", lambda t: (0.0, 0.0, -1.0))),
    nts.FormLoad(space, failing("form", lambda u, eta, t: -ufl.inner(u, eta) * ufl.dx)),
]
fail("between calls")
dt = old.dt * (2 if goes_wrong("dt") else 1)
scheme = nts.EnergyMomentum
pairs = old.pairs
if place.startswith("explicit"):
    scheme, dt = nts.CentralDifference, 1e-3
    pairs = [nts.ContactPair(pair.nodes, pair.segments, nts.Penalty()) for pair in pairs]
stepper = scheme(old.bodies, pairs, dt=dt, loads=loads, update=update)
for body in old.bodies:
    stepper.set_velocity(body, failing("velocity", lambda X: 0 * X))
if goes_wrong("new dt") or goes_wrong("explicit dt"):
    stepper.dt /= 2
stepper.v.x.array[:] = old.v.x.array
stepper._state_was_set()
before(contact_step.ContactStep, "evaluate", "contact")
before(nts.Diagnostics, "after_step", "write")
until = 20 * old.dt + (1e-3 if goes_wrong("until") else 0.0)
if place == "loop without recorder":
    for step in stepper.run(until):
        fail(place)
with nts.Recorder(folder / "run", stepper, checkpoint_every=checkpoint_every) as record:
    for step in stepper.run(until):
        fail("loop")
        record.write(step)
        if goes_wrong("break"):
            break
print("the run has finished")
"""


def run(folder: Path, num_ranks: int, where: str, ranks: str, checkpoint_every: int = 0) -> str:
    """Run the script; return its output to stderr, after a check of the time."""
    script = folder / "script.py"
    script.write_text(SCRIPT)
    # A process that has started MPI gives its children an environment of its own.
    own = ("OMPI_COMM_", "OMPI_UNIVERSE", "PMIX_", "PMI_")
    env = {k: v for k, v in os.environ.items() if not k.startswith(own)}
    # Open MPI leaves a folder of a killed run, which confuses later ones.
    env["PRTE_MCA_prte_tmpdir_base"] = str(folder)
    tests = Path(__file__).parents[2]
    paths = [str(tests), str(tests.parent), env.get("PYTHONPATH", "")]
    env["PYTHONPATH"] = os.pathsep.join(paths)
    command = ["mpirun", "-n", str(num_ranks), sys.executable, str(script), str(folder), where]
    command += [ranks, str(checkpoint_every)]
    lasted = []
    # The machine may be under load.
    longest = LONGEST * max(1.0, max(num_ranks, os.getloadavg()[0]) / (os.cpu_count() or 1))
    while not lasted or (min(lasted) >= longest and len(lasted) < 3):
        pipe = subprocess.PIPE
        with subprocess.Popen(command, env=env, stdout=pipe, stderr=pipe, text=True) as process:
            try:
                output, error = process.communicate(timeout=HANGS)
            except subprocess.TimeoutExpired:
                # Not kill(), which would not end the ranks.
                process.terminate()
                raise
        raised = max(float(path.read_text()) for path in folder.glob("time_*"))
        lasted.append(time.time() - raised)
        assert process.returncode != 0
        assert "the run has finished" not in output
    assert min(lasted) < longest, f"{lasted} s"
    return error


def is_reported_once(error: str, text: str) -> bool:
    """Whether exactly one traceback ends with a text, or one line contains it without traceback."""
    return error.count("Traceback") == text.count("Error") and len(re.findall(text, error)) == 1


# All places at which user code, or the package, may fail on one rank.
PLACES = [
    *("mesh", "energy", "boundary_of", "Surface.where", "first load", "form", "velocity"),
    *("between calls", "update", "update between messages", "load", "contact", "write", "loop"),
    "loop without recorder",
]
# In user code, or outside of any call of the package.
EXITS = ["mesh", "energy", "boundary_of", "Surface.where", "form", "update", "load", "loop"]
EXITS += ["velocity", "between calls", "loop without recorder"]
# Reaction of the ranks if one has another dt or end time, or leaves the loop.
DIFFERENT = {
    "dt": ("make EnergyMomentum .* dt = 0.02 s", "make EnergyMomentum .* dt = 0.04 s"),
    "new dt": ("step 1 from t = 0.0 s by dt = 0.02 s", "step 1 from t = 0.0 s by dt = 0.01 s"),
    "explicit dt": ("step 1 from .* by dt = 0.001 s", "step 1 from .* by dt = 0.0005 s"),
    "until": ("run from t = 0.0 s until 0.4 s", "run from t = 0.0 s until 0.401 s"),
    "break": ("step 4 from t = 0.06 s by dt = 0.02 s", "close .*run after step 3"),
}
CASES = [
    *((place, rf"KeyError: .*injected in {place}") for place in PLACES),
    *((f"{place}, exit", "has left the program, while rank . waits for it in") for place in EXITS),
    *(
        (place, f"ValueError: .*given ({a} on some and {b}|{b} on some and {a}) on others")
        for place, (a, b) in DIFFERENT.items()
    ),
]
# Numbers of ranks, and the rank that fails.
JOBS = [(2, 0), (2, 1), (3, 1)]


@pytest.mark.serial
@pytest.mark.alone
@pytest.mark.parametrize(
    ("where", "text", "num_ranks", "rank"),
    [(*case, *JOBS[i % len(JOBS)]) for i, case in enumerate(CASES)],
    ids=[where for where, _ in CASES],
)
def test_a_failure_on_one_rank_ends_all_with_one_message(tmp_path, where, text, num_ranks, rank):
    if where.startswith("mesh"):
        rank = 0  # which alone reads it
    error = run(tmp_path, num_ranks, where, str(rank))
    assert is_reported_once(error, text), error


@pytest.mark.serial
@pytest.mark.alone
def test_ranks_that_put_off_signals_end_as_well(tmp_path):
    error = run(tmp_path, 2, "loop", "1", checkpoint_every=1)
    assert is_reported_once(error, "KeyError: .*injected in loop"), error


@pytest.mark.serial
@pytest.mark.alone
def test_the_same_error_on_all_ranks_is_reported_once_without_abort(tmp_path):
    error = run(tmp_path, 3, "loop", "0,1,2")
    assert is_reported_once(error, "KeyError: .*injected in loop") and "MPI_ABORT" not in error, (
        error
    )


@pytest.fixture
def patient(monkeypatch):
    """Extend the waiting time for other ranks, for busy machines."""
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


def of_load(V, bodies, amount):
    return {"loads": [nts.Gravity(bodies, amount)]}


def of_function(V, bodies, amount):
    return {"loads": [nts.Gravity(bodies, lambda t: amount if t > 0 else np.zeros(3))]}


def of_constant(V, bodies, amount):
    value = fem.Constant(V.mesh, np.zeros(3))
    update = lambda t: value.value.__setitem__(slice(None), amount)  # noqa: E731
    return {"loads": [nts.Gravity(bodies, value)], "update": update}


def of_support(V, bodies, amount):
    value = fem.Constant(V.mesh, np.zeros(3))
    top = fem.locate_dofs_geometrical(V, lambda x: x[2] > 0.9)
    update = lambda t: value.value.__setitem__(slice(None), amount)  # noqa: E731
    return {"bcs": [fem.dirichletbc(value, top, V)], "update": update}


@pytest.mark.several_ranks
@pytest.mark.parametrize("given", [of_load, of_function, of_constant, of_support])
@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.CentralDifference])
def test_loads_and_supports_that_differ_between_ranks_are_refused(comm, refused, given, scheme):
    old = blocks(comm).stepper
    amount = np.array([0.0, 0.0, -1e-3 if comm.rank == one_rank(comm) else -2e-3])
    stepper = scheme(old.bodies, (), dt=1e-4, **given(old.u.function_space, old.bodies, amount))
    name = r"bcs\[0\]" if given is of_support else "Gravity"
    each = rf"step 1 from t = 0.0 s by dt = 0.0001 s with {name}.* = 0 0 -0.00[12]"
    with refused(ValueError, f"do the same, given .*{each} on some and .*{each} on others"):
        stepper.advance()


@pytest.mark.several_ranks
def test_motions_of_obstacles_that_differ_between_ranks_are_refused(comm, refused):
    old = blocks(comm).stepper
    speed = 1.0 + (comm.rank == one_rank(comm))
    motion = nts.Motion(translation=lambda t: (0.0, 0.0, -speed * t))
    lid = nts.RigidPlane((0, 0, 99.0), (0, 0, -1)).moving(motion)
    pairs = nts.all_pairs(
        old.bodies, obstacles=[lid], enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    stepper = nts.EnergyMomentum(old.bodies, pairs, dt=1e-3)
    with refused(ValueError, "with a moving RigidPlane = 0 0 -0.00"):
        stepper.advance()


COLLECTIVE = {
    "make Diagnostics": nts.Diagnostics,
    "make Fields": nts.Fields,
    "Diagnostics.balance()": lambda stepper: nts.Diagnostics(stepper).balance,
    "Diagnostics.overlaps()": lambda stepper: nts.Diagnostics(stepper).overlaps,
    "Diagnostics.centre_of_mass(body 0)": lambda stepper: partial(
        nts.Diagnostics(stepper).centre_of_mass, stepper.bodies[0]
    ),
    "Fields.gap()": lambda stepper: nts.Fields(stepper).gap,
}


@pytest.mark.several_ranks
@pytest.mark.parametrize("name", COLLECTIVE)
def test_diagnostics_on_one_rank_alone_are_refused(comm, refused, name):
    stepper = blocks(comm).stepper
    make = COLLECTIVE[name]
    call = partial(make, stepper) if name.startswith("make") else make(stepper)
    for others in (stepper.advance, nts.Diagnostics(stepper).kinetic_energy):
        with refused(ValueError, f"do the same, given .*{re.escape(name)}"):
            call() if comm.rank == one_rank(comm) else others()
    assert stepper.step == 0
    call()
    stepper.advance()


def test_a_velocity_of_the_wrong_shape_on_one_rank_is_refused_on_all(comm, patient, refused):
    stepper = blocks(comm).stepper

    def velocity(X):
        return X[:2] if comm.rank == one_rank(comm) else X

    with refused(ValueError, "expected a velocity of shape"):
        stepper.set_velocity(stepper.bodies[0], velocity)


def test_an_error_that_cannot_be_sent_is_reported_by_its_text(comm):
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
