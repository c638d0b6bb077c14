"""A field file is whole, whatever instant its process is killed in."""

import errno
import os

import h5py
import numpy as np
import pytest

from dolfinx_nts.io.crash_safe_file import JournaledFile

NUM_STATES = 12
FIELDS = ("displacement", "velocity", "gap")

pytestmark = pytest.mark.serial


class Killed(BaseException):
    pass


def append(path, first, count):
    """Add states as a recorder does."""
    file = JournaledFile(path, new=first == 0)
    data = h5py.File(file, "w" if first == 0 else "r+")
    for number in range(first, first + count):
        for field in FIELDS:
            data[f"states/{number:03d}/{field}"] = np.full((30, 3), float(number))
        data.flush()
        file.commit()
    data.close()
    file.commit()
    file.close()


def states(path):
    """Numbers of the states, all of whose values are right."""
    file = JournaledFile(path, new=False)
    with h5py.File(file, "r") as data:
        found = [int(name) for name in data.get("states", ())]
        for name in found:
            for field in FIELDS:
                assert (data[f"states/{name:03d}/{field}"][()] == name).all()
    file.close()
    return found


def fail_at(monkeypatch, count, failure):
    """Let the n-th change of a file fail, after half of it where it is a write."""
    calls = 0

    def failing(name):
        function = getattr(os, name)

        def call(*arguments, **options):
            nonlocal calls
            calls += 1
            if calls == count:
                if name == "pwrite":
                    file, data, place = arguments
                    function(file, data[: len(data) // 2], place)
                raise failure
            return function(*arguments, **options)

        monkeypatch.setattr(os, name, call)

    for name in ("pwrite", "replace", "unlink", "truncate"):
        failing(name)


def test_file_is_the_one_that_hdf5_writes(tmp_path):
    append(tmp_path / "a.h5", 0, NUM_STATES)
    assert states(tmp_path / "a.h5") == list(range(NUM_STATES))
    with h5py.File(tmp_path / "a.h5", "r") as data:
        assert len(data["states"]) == NUM_STATES
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_file_can_be_read_and_continued_after_a_kill_at_any_instant(tmp_path, monkeypatch):
    path, count, done = tmp_path / "a.h5", 0, False
    lengths = set()
    while not done:
        count += 1
        append(path, 0, 2)
        with monkeypatch.context() as patch:
            fail_at(patch, count, Killed)
            try:
                append(path, 2, NUM_STATES - 2)
                done = True
            except Killed:
                pass
        found = states(path)
        assert found == list(range(len(found))) and len(found) >= 2
        lengths.add(len(found))
        if len(found) < NUM_STATES:
            append(path, len(found), NUM_STATES - len(found))
        assert states(path) == list(range(NUM_STATES))
    assert lengths == set(range(2, NUM_STATES + 1)) and count > 5 * NUM_STATES


def test_full_disk_leaves_what_was_there(tmp_path, monkeypatch):
    path = tmp_path / "a.h5"
    append(path, 0, 3)
    with monkeypatch.context() as patch:
        patch.setattr(os, "posix_fallocate", lambda *arguments: (_ for _ in ()).throw(full))
        full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        with pytest.raises(OSError, match="No space left"):
            append(path, 3, 3)
    assert states(path) == [0, 1, 2]


def test_a_new_file_has_nothing_of_an_old_journal(tmp_path, monkeypatch):
    path = tmp_path / "a.h5"
    append(path, 0, 2)
    (tmp_path / "a.h5.journal").write_bytes(b"0" * 64)
    append(path, 0, 1)
    assert states(path) == [0]
