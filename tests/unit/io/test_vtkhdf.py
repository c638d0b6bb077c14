"""Fields in a VTKHDF file and a folder after interruptions and damage of files."""

import time
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.io.fields import RunFields
from dolfinx_nts.io.formats import vtkhdf
from dolfinx_nts.io.formats.vtkhdf import VtkHdfFile
from helpers.killed import Killed, kill_at
from helpers.numbered_run import Run
from helpers.readers import read_grids

pytestmark = pytest.mark.serial

NUM_STATES, BREAK = 4, 1
UNTOUCHED = ("notes.txt", "000000001.h5", "12-14.h5", "mesh.h5", "my_grid.h5")


@pytest.fixture(scope="module")
def run():
    """Return one run for all tests, as they do not advance it."""
    return Run()


@pytest.fixture
def at_once(monkeypatch):
    """Let each state be written immediately."""
    monkeypatch.setattr(vtkhdf, "_LATEST", 0.0)
    monkeypatch.setattr(vtkhdf, "_RARELY", 0.0)


def resumed(path, run, steps, at):
    """File of a run that continues after these steps."""
    file = VtkHdfFile(path, run, RunFields(run))
    run.go_to(at)
    file.serialize(SimpleNamespace(same=lambda name, value: np.array(steps)))
    file.open(True)
    return file


def record(path, run, steps, resume_at=None):
    """Write states from the start, or after the states up to a step."""
    if resume_at is None:
        file = VtkHdfFile(path, run, RunFields(run))
        file.open(False)
    else:
        file = resumed(path, run, range(resume_at + 1), resume_at)
    for step in steps:
        run.go_to(step)
        file.write(CurrentState(run))
    file.close()


def steps_of(path):
    """Steps of the states that a reader finds, after a check of their values."""
    if not path.exists():
        return []
    times, grids = read_grids(path)
    steps = [round(4 * t) for t in times]
    for step, grid in zip(steps, grids, strict=True):
        assert (grid["displacement"] == step).all() and set(grid["body"]) == {0, 1}
    return steps


def names_in(folder):
    return {path.name for path in folder.iterdir()}


def files_of(*blocks):
    return {"grid.h5", *(f"{first:09d}-{last:09d}.h5" for first, last in blocks)}


@pytest.mark.parametrize("name", ["run", "a & <b>", "v1.2", "-- ?>", "100%b %20", "ünï 日本"])
def test_states_are_held_back_and_share_files(tmp_path, run, name):
    path = tmp_path / f"{name}.vtkhdf"
    record(path, run, [0, 10, 50, 50, 51])
    assert names_in(tmp_path) == {f"{name}.vtkhdf", f"{name}_fields"}
    # The first state is written immediately, for viewing.
    assert names_in(tmp_path / f"{name}_fields") == files_of((0, 0), (10, 51))
    assert steps_of(path) == [0, 10, 50, 51]


def test_states_are_written_after_a_second_or_when_they_need_memory(tmp_path, run, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    path = tmp_path / "run.vtkhdf"
    file = VtkHdfFile(path, run, RunFields(run))
    file.open(False)
    found = []
    for step, clock[0] in enumerate([0.0, 0.4, 0.9, 1.0, 1.5, 1.9, 2.1]):
        run.go_to(step)
        file.write(CurrentState(run))
        found.append(len(steps_of(path)))
    assert found == [1, 1, 1, 4, 4, 4, 7]
    monkeypatch.setattr(vtkhdf, "_MOST", 2 * run.u.x.array.nbytes)
    run.go_to(7)
    file.write(CurrentState(run))
    assert len(steps_of(path)) == 8


def test_memory_of_written_states_is_used_again(tmp_path, run, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    path = tmp_path / "run.vtkhdf"
    file, places = VtkHdfFile(path, run, RunFields(run)), set()
    file.open(False)
    for step in range(20):
        run.go_to(step)
        clock[0] += 0.4
        file.write(CurrentState(run))
        held = [state["displacement"].values.ctypes.data for _, _, state in file._buffered]
        assert len(set(held)) == len(held) <= 3
        places |= set(held)
    file.close()
    assert len(places) <= 3
    assert steps_of(path) == list(range(20))


def test_an_error_keeps_buffered_fields(tmp_path, run):
    file = VtkHdfFile(tmp_path / "run.vtkhdf", run, RunFields(run))
    run.go_to(0)
    file.open(False)
    for step in range(3):
        run.go_to(step)
        file.write(CurrentState(run))
    file.leave()
    assert steps_of(tmp_path / "run.vtkhdf") == [0, 1, 2]


@pytest.mark.parametrize("resume_at", [None, BREAK])
def test_files_are_whole_after_a_kill_at_any_instant(
    tmp_path, run, monkeypatch, at_once, resume_at
):
    count, done, found = 0, False, set()
    # Later steps of another run distinguish its states from these.
    new = list(range(BREAK + 1, NUM_STATES)) if resume_at else list(range(10, 10 + NUM_STATES))
    before = list(range(BREAK + 1)) if resume_at else []
    while not done:
        count += 1
        folder = tmp_path / str(count)
        folder.mkdir()
        path = folder / "run.vtkhdf"
        record(path, run, range(NUM_STATES))
        with monkeypatch.context() as patch:
            kill_at(patch, count)
            try:
                record(path, run, new, resume_at)
                done = True
            except Killed:
                pass
        found.add(tuple(steps_of(path)))
        record(path, run, new, resume_at)
        assert steps_of(path) == before + new
        blocks = [(step, step) for step in before + new]
        assert names_in(folder / "run_fields") == files_of(*blocks)
    beginnings = {tuple(before + new[:n]) for n in range(len(new) + 1)}
    assert found == {tuple(range(NUM_STATES)), *beginnings} and count > 3 * len(new)


@pytest.mark.parametrize("resume_at", [None, BREAK])
def test_states_of_an_earlier_run_go_and_nothing_else(tmp_path, run, at_once, resume_at):
    record(tmp_path / "run.vtkhdf", run, range(NUM_STATES))
    folder = tmp_path / "run_fields"
    for name in UNTOUCHED:
        (folder / name).write_text("mine")
    for name in ("grid.h5.new", "000000000-000000007.h5.new"):
        (folder / name).write_text("half written")
    record(tmp_path / "run.vtkhdf", run, [7], resume_at)
    steps = [7] if resume_at is None else [0, 1, 7]
    assert names_in(folder) == {*files_of(*zip(steps, steps, strict=True)), *UNTOUCHED}
    assert all((folder / name).read_text() == "mine" for name in UNTOUCHED)
    assert steps_of(tmp_path / "run.vtkhdf") == steps


def cut(path):
    path.write_bytes(path.read_bytes()[:-100])


def without_times(path):
    with h5py.File(path, "r+") as file:
        del file.attrs["times"]


@pytest.mark.parametrize(
    "damage", [cut, without_times, Path.unlink, lambda path: path.write_text("else")]
)
def test_damaged_states_are_moved_aside_with_a_warning(tmp_path, run, caplog, at_once, damage):
    record(tmp_path / "run.vtkhdf", run, range(NUM_STATES))
    state = tmp_path / "run_fields" / "000000001-000000001.h5"
    damage(state)
    others = names_in(tmp_path / "run_fields")
    record(tmp_path / "run.vtkhdf", run, [5], resume_at=2)
    assert steps_of(tmp_path / "run.vtkhdf") == [5]
    assert names_in(tmp_path / "run_fields") == files_of((5, 5))
    aside = tmp_path / "run_fields.damaged1"
    assert names_in(aside) == others
    (text,) = caplog.messages
    lacks = f"{tmp_path / 'run_fields'} lacks the fields of step 1"
    assert text.startswith((f"{state} cannot be read: ", lacks))
    assert text.endswith(
        f"; the fields begin at this step, and the earlier ones were moved to {aside}"
    )


def test_flushed_states_are_on_disk_and_each_once(tmp_path, run, monkeypatch):
    synced = []
    monkeypatch.setattr(
        "dolfinx_nts.io.fields_folder.sync", lambda *paths: synced.append({p.name for p in paths})
    )
    file = VtkHdfFile(tmp_path / "run.vtkhdf", run, RunFields(run))
    run.go_to(0)
    file.open(False)
    always = {"run.vtkhdf", "run_fields", tmp_path.name}
    for step in range(4):
        run.go_to(step)
        file.write(CurrentState(run))
        if step % 2:
            file.flush()
    assert synced == [files_of((0, 0), (1, 1)) | always, {"000000002-000000003.h5"} | always]
