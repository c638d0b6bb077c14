"""A run that is killed, stopped or resumed elsewhere is the same run."""

import errno
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

from mpi4py import MPI

import h5py
import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.io import checkpoint
from dolfinx_nts.solvers.precond import factor_age
from helpers.interrupted import SCHEMES, layers, scene
from helpers.once import once, once_except
from helpers.readers import read_fields, read_grids
from helpers.scenes import BLOCK_STEP, blocks, of_material

pytestmark = pytest.mark.at_most_two_ranks

# Tolerance between numbers of ranks, relative to lengths of about one.
POSITION_TOLERANCE = 1e-10
NUM_STEPS, BREAK = 9, 5


def record(stepper, path, num_steps, fields="xdmf", **options):
    """Record until a step is done, counted from the start of the run. Collective."""
    options |= {"checkpoint_every": 2, "resume": True, "fields": fields}
    with nts.Recorder(path, stepper, **options) as recorder:
        for step in stepper.run(until=num_steps * stepper.dt):
            recorder.write(step)


def test_a_resumed_run_has_the_steps_of_the_script_if_they_are_new(comm, folder, agree):
    # The run halves its step length, and an unchanged script must continue with the half.
    def part(dt, until):
        stepper = scene(comm).stepper
        stepper.dt = dt
        with nts.Recorder(folder / "run", stepper, checkpoint_every=1, resume=True) as recorder:
            for step in stepper.run(until):
                recorder.write(step)
                stepper.dt = min(stepper.dt, BLOCK_STEP / 2)
        rows = np.genfromtxt(folder / "run.csv", delimiter=",", names=True)
        return rows["dt"][1:] / BLOCK_STEP, rows

    assert agree(part(BLOCK_STEP, 2 * BLOCK_STEP)[0] == pytest.approx([1, 0.5, 0.5]))
    assert agree(part(BLOCK_STEP, 3 * BLOCK_STEP)[0][3:] == pytest.approx([0.5, 0.5]))
    lengths, rows = part(BLOCK_STEP / 4, 4 * BLOCK_STEP)
    assert agree(lengths[5:] == pytest.approx([0.25] * 4))
    energy = rows["total_energy"]
    assert agree(np.ptp(energy) < 1e-11 * energy[0])
    assert agree(np.abs(rows["energy_unaccounted"]).max() < 1e-11 * energy[0])


@pytest.mark.parametrize(
    "scheme", once_except(SCHEMES, "stick", "explicit", "resolved mortar", "plastic")
)
def test_a_resumed_run_repeats_the_whole_one_bit_for_bit(
    comm, folder, agree, scheme, request, monkeypatch
):
    if "strong" in request.node.callspec.id:
        # MUMPS on several ranks is not reproducible bit by bit.
        monkeypatch.setattr(factor_age, "_SLOW", 0.0)
    whole = scene(comm, scheme, owner=layers).stepper
    record(whole, folder / "whole", NUM_STEPS, every=3)
    record(scene(comm, scheme, owner=layers).stepper, folder / "parts", BREAK, every=3)
    stepper = scene(comm, scheme, owner=layers).stepper
    record(stepper, folder / "parts", NUM_STEPS, every=3)
    assert agree(stepper.t == whole.t and stepper.step == NUM_STEPS)
    if "strong" in request.node.callspec.id:
        assert stepper._solver._preconditioner.is_strong
    for name in ("u", "v", "u_n"):
        assert agree(np.array_equal(getattr(stepper, name).x.array, getattr(whole, name).x.array))
    tables = [(folder / f"{name}.csv").read_text() for name in ("whole", "parts")]
    assert agree(tables[0] == tables[1] and len(tables[0].splitlines()) == NUM_STEPS + 2)
    one, other = (read_fields(folder / f"{name}_fields") for name in ("whole", "parts"))
    # The last state of the interrupted run is included.
    extra = {key for key in other if key[0] == f"{BREAK:09d}.h5"}
    assert agree(extra and other.keys() - extra == one.keys())
    assert agree(all(np.array_equal(one[key], other[key], equal_nan=True) for key in one))


@pytest.mark.several_ranks
@pytest.mark.parametrize("scheme", SCHEMES.values(), ids=SCHEMES)
def test_any_number_of_ranks_continues(comm, folder, agree, scheme):
    whole = scene(comm, scheme)
    for step in range(NUM_STEPS):
        if step == BREAK:
            checkpoint.save(folder / "all.h5", whole.stepper)
        whole.stepper.advance()
    alone = scene(MPI.COMM_SELF, scheme)
    checkpoint.load(folder / "all.h5", alone.stepper)
    if comm.rank == 0:
        checkpoint.save(folder / "one.h5", alone.stepper)
    comm.barrier()
    again = scene(comm, scheme)
    checkpoint.load(folder / "one.h5", again.stepper)
    positions = whole.positions()
    for other in (alone, again):
        for _ in range(NUM_STEPS - BREAK):
            other.stepper.advance()
        assert agree(np.abs(other.positions() - positions).max() <= POSITION_TOLERANCE)
        assert agree(other.stepper.t == whole.stepper.t)


@pytest.mark.serial
def test_a_checkpoint_does_not_change_the_run(comm, folder, agree):
    plain, saved = (scene(comm, owner=layers).stepper for _ in range(2))
    for _ in range(NUM_STEPS):
        plain.advance()
        saved.advance()
        checkpoint.save(folder / "run.h5", saved)
    assert agree(np.array_equal(plain.u.x.array, saved.u.x.array))


def test_other_scenes_are_refused_with_the_differences(comm, folder, refused):
    path = folder / "run.h5"
    stepper = blocks(comm).stepper
    checkpoint.save(path, stepper)
    with refused(ValueError, "integrator is EnergyMomentum instead of Midpoint"):
        checkpoint.load(path, blocks(comm, nts.Midpoint).stepper)
    with refused(ValueError, r"pair 1 is .*impact=elastic.* instead of .*impact=plastic"):
        checkpoint.load(path, blocks(comm, enforcement=nts.LagrangeMultiplier("plastic")).stepper)
    with refused(ValueError, r"body 3 is missing instead of .*; .*mesh is .*; pair 2 is missing"):
        checkpoint.load(path, blocks(comm, num_bodies=3).stepper)
    softer = nts.SaintVenantKirchhoff(E=2.0, nu=0.3, rho=1.0)
    bodies = [of_material(body, softer) for body in blocks(comm).stepper.bodies]
    with refused(ValueError, "body 1 is .*rho=10.0.* instead of .*rho=1.0"):
        checkpoint.load(path, nts.EnergyMomentum(bodies, dt=1.0))
    same = blocks(comm, dt=2 * BLOCK_STEP).stepper
    checkpoint.load(path, same)
    assert same.dt == stepper.dt


def test_damaged_and_foreign_files_are_refused_with_the_reason(comm, folder, refused):
    path = folder / "run.h5"
    checkpoint.save(path, blocks(comm).stepper)
    stepper, whole = blocks(comm).stepper, path.read_bytes()
    with h5py.File("other", "w", driver="core", backing_store=False) as other:
        other["x"] = np.ones(3)
        other.flush()
        foreign = other.id.get_file_image()
    at = whole.index(stepper.u.x.array[:0].tobytes() + np.float64(BLOCK_STEP).tobytes())
    flipped = whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :]
    for content, reason in (
        (whole[: len(whole) // 2], "truncated"),
        (b"", "checkpoint, given"),
        (b"something else", "signature"),
        (foreign, "HDF5 file of another kind"),
        (flipped, "values are damaged"),
        (whole.replace(b"start_time\0", b"start_tim\xff\0"), "a name that is not text"),
    ):
        comm.barrier()
        if comm.rank == 0:
            path.write_bytes(content)
        comm.barrier()
        with refused(ValueError, reason):
            checkpoint.load(path, stepper)
    assert stepper.t == 0 and not stepper.u.x.array.any()


@pytest.mark.serial
def test_any_damage_to_a_checkpoint_is_refused_or_harmless(folder, rng):
    path, stepper = folder / "run.h5", blocks(MPI.COMM_SELF).stepper
    stepper.advance()
    checkpoint.save(path, stepper)
    whole, u = path.read_bytes(), stepper.u.x.array.copy()
    refused = 0
    # What HDF5 and the description of the scene need lies at the start.
    for begin in range(0, 6000, 100):
        damaged = bytearray(whole)
        at = begin + rng.integers(100)
        damaged[at : at + 8] = rng.bytes(8)
        path.write_bytes(damaged)
        try:
            checkpoint.load(path, stepper)
        except ValueError as error:
            assert str(error).startswith("expected a ")
            refused += 1
        assert np.array_equal(stepper.u.x.array, u)
    assert 10 < refused < 60


def test_a_table_that_is_too_short_or_foreign_is_refused(comm, folder, refused):
    record(blocks(comm).stepper, folder / "run", 3)
    if comm.rank == 0:
        (folder / "run.csv").write_text("")
    comm.barrier()
    with refused(ValueError, "expected a table .*run.csv of .* bytes or more"):
        record(blocks(comm).stepper, folder / "run", 4)
    if comm.rank == 0:
        (folder / "run.csv").write_text(1000 * "somebody else's, table\n")
    comm.barrier()
    with refused(ValueError, "expected a table .*run.csv that begins with the rows"):
        record(blocks(comm).stepper, folder / "run", 4)


def test_a_second_run_of_the_same_name_is_refused_and_changes_nothing(comm, folder, refused):
    with nts.Recorder(folder / "run", blocks(comm).stepper) as first:
        first.write(first._stepper.advance())
        comm.barrier()
        before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for resume in (False, True):
            second = nts.Recorder(folder / "run", blocks(comm).stepper, resume=resume)
            owner = comm.bcast(os.getpid())
            with refused(OSError, f"belong to process {owner} on {socket.gethostname()}"):
                second.__enter__()
        assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    comm.barrier()
    assert not (folder / "run.lock").exists()


def test_a_full_disk_is_an_error_that_leaves_the_last_checkpoint(comm, folder, refused):
    path = folder / "run.h5"
    stepper = blocks(comm).stepper
    checkpoint.save(path, stepper)
    stepper.advance()
    before, limits = path.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    comm.barrier()
    # Limit on the size of files, as if the disk were full.
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) // 2, limits[1]))
    try:
        with refused(
            OSError, f"{os.strerror(errno.EFBIG)}; a file of this name from before is unchanged"
        ):
            checkpoint.save(path, stepper)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before
    assert [file.name for file in folder.iterdir()] == ["run.h5"]


def test_a_full_disk_ends_a_recorded_run_that_can_be_resumed(comm, folder, agree, refused):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def fill_up():
        stepper = blocks(comm).stepper
        options = {"checkpoint_every": 2, "fields": "xdmf"}
        with nts.Recorder(folder / "run", stepper, **options) as recorder:
            for step in stepper.run(1.0):
                recorder.write(step)
                if step.step == 3:
                    size = (folder / "run_fields" / "000000003.h5").stat().st_size
                    comm.barrier()
                    resource.setrlimit(resource.RLIMIT_FSIZE, (size - 1, limits[1]))

    try:
        with refused(OSError, os.strerror(errno.EFBIG)):
            fill_up()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    comm.barrier()
    stepper = blocks(comm).stepper
    with nts.Recorder(folder / "run", stepper, resume=True, fields="xdmf") as recorder:
        assert agree(stepper.step == 2)
        recorder.write(stepper.advance())
    comm.barrier()
    names = {path.stem for path in (folder / "run_fields").iterdir()}
    assert agree(names == {"mesh", *(f"{step:09d}" for step in range(4))})


@pytest.mark.serial
def test_without_resume_an_old_checkpoint_goes(comm, folder):
    record(blocks(comm).stepper, folder / "run", 3)
    comm.barrier()
    with nts.Recorder(folder / "run", blocks(comm).stepper):
        pass
    assert not (folder / "run.checkpoint.h5").exists()


@pytest.mark.parametrize("step", [once(1), 3])
def test_a_run_continues_without_removed_fields(comm, folder, agree, caplog, step):
    record(blocks(comm).stepper, folder / "run", 3)
    if comm.rank == 0:
        (folder / "run_fields" / f"{step:09d}.h5").unlink()
    comm.barrier()
    caplog.clear()
    record(blocks(comm).stepper, folder / "run", 5)
    comm.barrier()
    assert agree(len(read_fields(folder / "run_fields.damaged1")) > 3)
    times, _ = read_grids(folder / "run.xdmf")
    assert agree(np.allclose(times, BLOCK_STEP * np.array([4, 5])))
    assert agree(len((folder / "run.csv").read_text().splitlines()) == 7)
    warned = any("the fields begin at this step" in text for text in caplog.messages)
    assert agree(warned == (comm.rank == 0))


# --- processes that end before their time -------------------------------

SCRIPT = """
import os, sys
sys.path.insert(0, sys.argv[1])
from mpi4py import MPI
import dolfinx_nts as nts
from dolfinx_nts.io import shared_file
from helpers.scenes import blocks
stepper = blocks(MPI.COMM_WORLD, num_bodies=3).stepper
when, signum = sys.argv[3], int(sys.argv[4])
calls = 0
def once(function, *arguments):
    global calls
    calls += 1
    if calls == int(sys.argv[5]):
        if when == "_write":
            comm, path, pieces, durable = arguments
            pieces = list(pieces)
            function(comm, path, pieces[: len(pieces) // 2], durable)
        os.kill(os.getpid(), signum)
    return function(*arguments)
for owner, name in ((os, "fsync"), (os, "replace"), (shared_file, "_write")):
    if when == name:
        function = getattr(owner, name)
        setattr(owner, name, lambda *arguments: once(function, *arguments))
options = {"checkpoint_every": 2, "resume": True, "fields": sys.argv[6]}
with nts.Recorder(sys.argv[2], stepper, **options) as record:
    for step in stepper.run(until=8 * stepper.dt):
        if when == "step":
            once(int)
        record.write(step)
"""


@pytest.fixture(scope="module")
def facet_nodes(tmp_path_factory):
    """Folders with the files of an uninterrupted script, by kind of fields."""
    folders = {fields: tmp_path_factory.mktemp(fields) for fields in ("xdmf", "vtkhdf")}
    for fields, folder in folders.items():
        record(blocks(MPI.COMM_SELF, num_bodies=3).stepper, folder / "whole", 8, fields)
    return folders


def run_script(path, fields, when="never", signum=0, call=0):
    """Run the script, which sends itself a signal; returns how it ended."""
    arguments = [str(Path(__file__).parents[2]), path, when, signum, call, fields]
    return subprocess.run(
        [sys.executable, "-c", SCRIPT, *map(str, arguments)], capture_output=True, text=True
    )


@pytest.mark.serial
@pytest.mark.parametrize(
    ("when", "signum", "call", "fields"),
    [
        ("step", signal.SIGKILL, 6, "xdmf"),  # between checkpoints
        ("step", signal.SIGKILL, 6, "vtkhdf"),
        # The second checkpoint, of step 4: before it is written, before it is renamed,
        ("fsync", signal.SIGKILL, 17, "xdmf"),
        ("replace", signal.SIGKILL, 9, "xdmf"),
        ("_write", signal.SIGKILL, 9, "xdmf"),  # and is half written.
        ("replace", signal.SIGKILL, 8, "xdmf"),  # The state of step 4 is about to get its name,
        ("_write", signal.SIGKILL, 8, "xdmf"),  # and is half written.
        ("step", signal.SIGTERM, 5, "vtkhdf"),
        ("step", signal.SIGINT, 5, "vtkhdf"),
    ],
)
def test_a_killed_script_continues_after_restart(tmp_path, facet_nodes, when, signum, call, fields):
    folder = shutil.copytree(facet_nodes[fields], tmp_path / "runs")
    killed = run_script(folder / "parts", fields, when, signum, call)
    assert killed.returncode in (-signum, 128 + signum), killed.stderr
    rows = (folder / "parts.csv").read_text().splitlines()
    assert 3 < len(rows) < 10
    assert (folder / "parts.lock").exists() == (signum != signal.SIGINT)
    times, _ = read_grids(folder / f"parts.{fields}")
    assert len(rows) - 2 <= len(times) <= len(rows) - 1
    if signum != signal.SIGKILL:
        # Stopped with a checkpoint of the last step.
        stepper = blocks(MPI.COMM_SELF, num_bodies=3).stepper
        with nts.Recorder(folder / "parts", stepper, resume=True, fields=fields):
            assert stepper.step == len(rows) - 2
        expected = f"parts.checkpoint.h5 holds step {len(rows) - 2}, t = {BLOCK_STEP * call:g}: the"
        assert killed.stderr.count(expected) == 1
    record(blocks(MPI.COMM_SELF, num_bodies=3).stepper, folder / "parts", 8, fields)
    tables = [(folder / f"{name}.csv").read_text() for name in ("whole", "parts")]
    assert tables[0] == tables[1]
    grids = [read_grids(folder / f"{name}.{fields}") for name in ("whole", "parts")]
    assert np.array_equal(*(times for times, _ in grids))
    for one, other in zip(*(states for _, states in grids), strict=True):
        assert one.array_names == other.array_names
        for name in one.array_names:
            assert np.array_equal(one[name], other[name], equal_nan=True)
    if fields == "vtkhdf":
        return
    one, other = (read_fields(folder / f"{name}_fields") for name in ("whole", "parts"))
    assert one.keys() == other.keys()
    assert all(np.array_equal(one[key], other[key], equal_nan=True) for key in one)
    texts = [(folder / f"{name}.xdmf").read_text() for name in ("whole", "parts")]
    assert texts[0].replace("whole", "parts") == texts[1]


PRINTING = """
import os, signal, sys
sys.path.insert(0, sys.argv[1])
from mpi4py import MPI
import dolfinx_nts as nts
from helpers.scenes import blocks
stepper = blocks(MPI.COMM_SELF, num_bodies=3).stepper
with nts.Recorder(sys.argv[2], stepper, checkpoint_every=100) as record:
    for step in stepper.run(until=8 * stepper.dt):
        if step.step == 2:
            sys.stdin.readline()  # until nobody reads the output any more
            os.kill(os.getpid(), int(sys.argv[3]))
        print(step.step, flush=True)
        record.write(step)
"""


@pytest.mark.serial
@pytest.mark.parametrize(
    ("signum", "status"), [(signal.SIGINT, -signal.SIGINT), (0, 1)], ids=["interrupted", "alone"]
)
def test_a_run_whose_output_nobody_reads_ends_with_a_checkpoint(tmp_path, signum, status):
    """Ctrl-C in ``python3 run.py | tee log`` ends ``tee`` before the run prints again."""
    script = [sys.executable, "-c", PRINTING, str(Path(__file__).parents[2])]
    end, other = os.pipe()
    with subprocess.Popen(
        [*script, str(tmp_path / "run"), str(int(signum))],
        stdin=subprocess.PIPE,
        stdout=other,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        os.close(other)
        with os.fdopen(end) as output:
            assert output.readline() == "1\n"
        _, errors = process.communicate("\n")
    assert process.returncode == status, errors
    assert f"run.checkpoint.h5 holds step 2, t = {BLOCK_STEP * 2:g}: the same script" in errors
    assert not (tmp_path / "run.lock").exists()
    assert len((tmp_path / "run.csv").read_text().splitlines()) == 2 + 2
