"""Fields in an XDMF file and a folder after interruptions and damage of files."""

import time
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import h5py
import numpy as np
import pytest

from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.io import fields_folder
from dolfinx_nts.io.fields import RunFields
from dolfinx_nts.io.formats.xdmf import XdmfFile
from helpers.killed import Killed, kill_at
from helpers.numbered_run import Run
from helpers.readers import read_grids

pytestmark = pytest.mark.serial

NUM_STATES, BREAK = 4, 1
UNTOUCHED = ("notes.txt", "12.h5", "000000001.h5.copy", "0000000001.h5", "my_mesh.h5")


@pytest.fixture(scope="module")
def run():
    """Return one run for all tests, as they do not advance it."""
    return Run()


def record(path, run, steps, resume_at=None):
    """Write states from the start, or after the states up to a step."""
    file = XdmfFile(path, run, RunFields(run))
    if resume_at is not None:
        run.go_to(resume_at)
        written = np.arange(resume_at + 1)
        file.serialize(SimpleNamespace(same=lambda name, value: written))
    file.open(resume_at is not None)
    for step in steps:
        run.go_to(step)
        file.write(CurrentState(run))
    file.close()


def steps_of(path):
    """Steps of the states that a reader finds, after a check of their values."""
    if not list(ET.parse(path).iter("Time")):
        return []
    times, grids = read_grids(path)
    steps = [round(4 * t) for t in times]
    for step, grid in zip(steps, grids, strict=True):
        assert (grid["displacement"] == step).all() and set(grid["body"]) == {0, 1}
    return steps


def names_in(folder):
    return {path.name for path in folder.iterdir()}


def files_of(*steps):
    return {"mesh.h5", *(f"{step:09d}.h5" for step in steps)}


def test_each_state_has_a_file_of_its_own(tmp_path, run):
    record(tmp_path / "run.xdmf", run, [0, 50, 50])
    assert names_in(tmp_path) == {"run.xdmf", "run_fields"}
    assert names_in(tmp_path / "run_fields") == files_of(0, 50)
    with h5py.File(tmp_path / "run_fields" / "000000050.h5") as file:
        assert set(file) >= {"displacement", "velocity"} and file.attrs["time"] == 12.5
    places = [item.text for item in ET.parse(tmp_path / "run.xdmf").iter("DataItem")]
    assert "run_fields/000000050.h5:/displacement" in places
    assert steps_of(tmp_path / "run.xdmf") == [0, 50]


@pytest.mark.parametrize("name", ["a & <b>", "v1.2", "-- ?>"])
def test_any_name_will_do(tmp_path, run, name):
    record(tmp_path / f"{name}.xdmf", run, range(3))
    assert steps_of(tmp_path / f"{name}.xdmf") == [0, 1, 2]


@pytest.mark.parametrize("resume_at", [None, BREAK])
def test_files_are_whole_after_a_kill_at_any_instant(tmp_path, run, monkeypatch, resume_at):
    count, done, found = 0, False, set()
    # Later steps of another run distinguish its states from these.
    new = list(range(BREAK + 1, NUM_STATES)) if resume_at else list(range(10, 10 + NUM_STATES))
    before = list(range(BREAK + 1)) if resume_at else []
    while not done:
        count += 1
        folder = tmp_path / str(count)
        folder.mkdir()
        path = folder / "run.xdmf"
        record(path, run, range(NUM_STATES))
        with monkeypatch.context() as patch:
            kill_at(patch, count)
            try:
                record(path, run, new, resume_at)
                done = True
            except Killed:
                pass
        steps = steps_of(path)
        found.add(tuple(steps))
        record(path, run, new, resume_at)
        assert steps_of(path) == before + new
        assert names_in(folder / "run_fields") == files_of(*before, *new)
    beginnings = {tuple(before + new[:n]) for n in range(len(new) + 1)}
    assert found == {tuple(range(NUM_STATES)), *beginnings} and count > 3 * len(new)


@pytest.mark.parametrize("resume_at", [None, BREAK])
def test_states_of_an_earlier_run_go_and_nothing_else(tmp_path, run, resume_at):
    record(tmp_path / "run.xdmf", run, range(NUM_STATES))
    folder = tmp_path / "run_fields"
    for name in UNTOUCHED:
        (folder / name).write_text("mine")
    for name in ("mesh.h5.new", "000000000.h5.new", "000000009.h5.new"):
        (folder / name).write_text("half written")
    record(tmp_path / "run.xdmf", run, [7], resume_at)
    steps = [7] if resume_at is None else [0, 1, 7]
    assert names_in(folder) == {*files_of(*steps), *UNTOUCHED}
    assert all((folder / name).read_text() == "mine" for name in UNTOUCHED)


def cut(path):
    path.write_bytes(path.read_bytes()[:-100])


def without_time(path):
    with h5py.File(path, "r+") as file:
        del file.attrs["time"]


@pytest.mark.parametrize(
    "damage", [cut, without_time, Path.unlink, lambda path: path.write_text("else")]
)
def test_damaged_states_are_moved_aside_with_a_warning(tmp_path, run, caplog, damage):
    for attempt in (1, 2):
        caplog.clear()
        record(tmp_path / "run.xdmf", run, range(NUM_STATES))
        damage(tmp_path / "run_fields" / "000000001.h5")
        others = names_in(tmp_path / "run_fields")
        record(tmp_path / "run.xdmf", run, [5], resume_at=2)
        assert steps_of(tmp_path / "run.xdmf") == [5]
        assert names_in(tmp_path / "run_fields") == files_of(5)
        aside = tmp_path / f"run_fields.damaged{attempt}"
        assert names_in(aside) == others
        (text,) = caplog.messages
        state = tmp_path / "run_fields" / "000000001.h5"
        assert text.startswith(f"{state} cannot be read: ")
        assert text.endswith(
            f"; the fields begin at this step, and the earlier ones were moved to {aside}"
        )


def test_a_missing_folder_is_reported(tmp_path, run, caplog):
    record(tmp_path / "run.xdmf", run, [5], resume_at=2)
    assert steps_of(tmp_path / "run.xdmf") == [5]
    assert caplog.messages[0].endswith(
        f"; the fields begin at this step, as there is no folder {tmp_path / 'run_fields'}"
    )


@pytest.mark.parametrize("damage", [cut, Path.unlink])
def test_a_damaged_mesh_is_written_again(tmp_path, run, caplog, damage):
    record(tmp_path / "run.xdmf", run, range(2))
    before = (tmp_path / "run_fields" / "mesh.h5").read_bytes()
    damage(tmp_path / "run_fields" / "mesh.h5")
    time.sleep(1.1)  # HDF5 knows seconds, which must not be in the file
    record(tmp_path / "run.xdmf", run, [2], resume_at=1)
    assert (tmp_path / "run_fields" / "mesh.h5").read_bytes() == before
    assert steps_of(tmp_path / "run.xdmf") == [0, 1, 2] and not caplog.messages


def test_flushed_files_are_on_disk_and_each_once(tmp_path, run, monkeypatch):
    synced = []
    keep = synced.append
    monkeypatch.setattr(fields_folder, "sync", lambda *paths: keep({p.name for p in paths}))
    file = XdmfFile(tmp_path / "run.xdmf", run, RunFields(run))
    run.go_to(0)
    file.open(False)
    always = {"run.xdmf", "run_fields", tmp_path.name}
    for step in range(2):
        run.go_to(step)
        file.write(CurrentState(run))
        file.flush()
    assert synced == [files_of(0) | always, {"000000001.h5"} | always]
