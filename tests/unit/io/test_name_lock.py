"""A lock on a name, held by processes that know nothing of this package."""

import errno
import fcntl
import os
import socket
import subprocess
import sys

import pytest

from dolfinx_nts.io.name_lock import NameLock

pytestmark = pytest.mark.serial

HOLDER = """
import fcntl, sys
file = open(sys.argv[1], "w")
fcntl.flock(file, fcntl.LOCK_EX)
file.write("process 12 on elsewhere since noon")
file.flush()
print("held", flush=True)
input()
"""


@pytest.fixture
def path(tmp_path):
    """File of the lock."""
    return tmp_path / "run.v2.lock"


@pytest.fixture
def holder(path):
    """Another process that holds the lock."""
    command = [sys.executable, "-c", HOLDER, path]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_name_that_another_process_has_is_refused_with_host_and_process(path, holder):
    message = r"no other run writes to, given .*run\.v2, which belong to process 12 on elsewhere"
    with pytest.raises(OSError, match=message):
        NameLock(path).take()
    assert path.read_text() == "process 12 on elsewhere since noon"


def test_lock_of_a_killed_process_does_not_block(path, holder):
    holder.kill()
    holder.wait()
    assert path.exists()
    lock = NameLock(path)
    lock.take()
    assert path.read_text().startswith(f"process {os.getpid()} on {socket.gethostname()} since ")
    lock.release()
    assert not path.exists()


def test_one_process_cannot_take_a_name_twice_before_it_is_released(path):
    first, second = NameLock(path), NameLock(path)
    first.take()
    with pytest.raises(OSError, match=f"process {os.getpid()} on"):
        second.take()
    second.release()
    assert path.exists()
    first.release()
    second.take()
    second.release()


def test_file_that_was_removed_while_it_was_opened_is_not_taken_for_the_lock(path, monkeypatch):
    first, second = NameLock(path), NameLock(path)
    first.take()
    flock = fcntl.flock

    def released_at_once(*arguments):
        first.release()
        flock(*arguments)

    monkeypatch.setattr(fcntl, "flock", released_at_once)
    second.take()
    monkeypatch.undo()
    with pytest.raises(OSError, match="belong to process"):
        NameLock(path).take()
    second.release()


def test_file_system_without_locks_is_told(path, monkeypatch, caplog):
    def refuse(*arguments):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    lock = NameLock(path)
    lock.take()
    lock.release()
    (text,) = caplog.messages
    reason = os.strerror(errno.ENOLCK)
    assert text.startswith(f"{path} cannot be locked: {reason}; this is harmless")
