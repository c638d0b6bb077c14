"""A file is replaced as a whole or not at all."""

import os

import pytest

from dolfinx_nts.io import atomic_file
from dolfinx_nts.io.atomic_file import replace
from helpers.killed import Killed, kill_at

pytestmark = pytest.mark.serial


@pytest.mark.parametrize("exists", [True, False])
def test_a_kill_at_any_instant_leaves_the_former_file_or_the_new_one(tmp_path, monkeypatch, exists):
    path, found = tmp_path / "a", []
    for count in (1, 2, 3, 4):
        path.unlink(missing_ok=True)
        if exists:
            path.write_bytes(b"former")
        with monkeypatch.context() as patch:
            kill_at(patch, count)
            try:
                replace(path, b"new")
            except Killed:
                pass
        found.append(path.read_bytes() if path.exists() else None)
    former = b"former" if exists else None
    assert found == [former, former, former, b"new"]


@pytest.mark.parametrize(
    ("durable", "calls"), [(False, ["replace"]), (True, ["fsync", "replace", "fsync"])]
)
def test_a_synced_file_is_on_disk_before_it_has_its_name(tmp_path, monkeypatch, durable, calls):
    found = []

    def noted(name, function):
        return lambda *arguments: (found.append(name), function(*arguments))

    for name in ("fsync", "replace"):
        monkeypatch.setattr(os, name, noted(name, getattr(os, name)))
    replace(tmp_path / "a", b"new", durable=durable)
    assert found == calls


def test_an_error_leaves_the_former_file_and_no_other(tmp_path, monkeypatch):
    path = tmp_path / "a"
    monkeypatch.setattr(atomic_file.os, "replace", lambda *arguments: os.stat(tmp_path / "nowhere"))
    with pytest.raises(FileNotFoundError, match=r"No such file or directory: '.*/a'$"):
        replace(path, b"new")
    assert list(tmp_path.iterdir()) == []
    path.write_bytes(b"former")
    with pytest.raises(FileNotFoundError, match="a file of this name from before is unchanged"):
        replace(path, b"new")
    assert path.read_bytes() == b"former" and list(tmp_path.iterdir()) == [path]


def test_no_link_is_followed(tmp_path):
    mine, path = tmp_path / "mine", tmp_path / "a"
    mine.write_bytes(b"precious")
    path.with_name("a.new").symlink_to(mine)
    replace(path, b"new")
    assert mine.read_bytes() == b"precious" and path.read_bytes() == b"new"
    assert sorted(tmp_path.iterdir()) == [path, mine]
