"""Deferred signals, sent by the test itself."""

import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress

import pytest

from dolfinx_nts.parallel.signals import Interrupts


class Stopped(Exception):
    """Exception that the handler of the test raises."""


def _drop(pipe):
    """Close a pipe whose reader is gone, with buffered data."""
    with suppress(BrokenPipeError):
        pipe.close()


@pytest.fixture
def handler():
    """Handler of Ctrl-C, as a user's program may have its own."""

    def stop(signum, frame):
        raise Stopped

    former = signal.signal(signal.SIGINT, stop)
    yield stop
    signal.signal(signal.SIGINT, former)


def test_first_signal_waits_and_all_ranks_learn_of_it(comm, handler, agree):
    with Interrupts(comm) as interrupts:
        assert agree(interrupts.received() == 0)
        if comm.rank == comm.size - 1:
            signal.raise_signal(signal.SIGINT)
        assert agree(interrupts.received() == signal.SIGINT)


def test_second_signal_takes_effect_at_once(comm, handler):
    with Interrupts(comm):
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(Stopped):
            signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is handler


def test_a_delayed_signal_has_its_effect(comm, handler):
    with Interrupts(comm) as interrupts:
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(Stopped):
            interrupts.take_effect(signal.SIGINT)


def test_handlers_are_given_back_also_after_an_error(comm, handler):
    terminate = signal.getsignal(signal.SIGTERM)
    with pytest.raises(ZeroDivisionError), Interrupts(comm):
        assert signal.getsignal(signal.SIGINT) is not handler
        assert signal.getsignal(signal.SIGTERM) is not terminate
        raise ZeroDivisionError
    assert signal.getsignal(signal.SIGINT) is handler
    assert signal.getsignal(signal.SIGTERM) is terminate


def test_another_thread_leaves_the_signals_alone(comm, handler):
    found = []

    def work():
        with Interrupts(comm):
            found.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [handler]


@pytest.mark.parametrize("ignored", [signal.SIGINT, signal.SIGTERM])
def test_ignored_signals_stay_ignored(comm, handler, agree, ignored):
    former = signal.signal(ignored, signal.SIG_IGN)
    try:
        with Interrupts(comm) as interrupts:
            for _ in range(2):
                signal.raise_signal(ignored)
                assert agree(interrupts.received() == 0)
        assert signal.getsignal(ignored) is signal.SIG_IGN
    finally:
        signal.signal(ignored, former)


def test_ranks_stop_together_where_one_ignores_the_signal(comm, agree):
    former = signal.getsignal(signal.SIGINT)
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler if comm.rank else signal.SIG_IGN)
        with Interrupts(comm) as interrupts:
            if comm.rank:
                signal.raise_signal(signal.SIGINT)
            signum = interrupts.received()
            assert agree(signum == (signal.SIGINT if comm.size > 1 else 0))
            if signum:
                with pytest.raises(KeyboardInterrupt):
                    interrupts.take_effect(signum)
    finally:
        signal.signal(signal.SIGINT, former)


def test_handler_that_returns_lets_the_run_continue_and_be_interrupted_again(comm, agree):
    calls = []
    former = signal.signal(signal.SIGINT, lambda *_: calls.append(1))
    try:
        with Interrupts(comm) as interrupts:
            for count in (1, 2):
                signal.raise_signal(signal.SIGINT)
                interrupts.take_effect(interrupts.received())
                assert agree(len(calls) == count and interrupts.received() == 0)
            assert not interrupts.took_effect
    finally:
        signal.signal(signal.SIGINT, former)


def test_closed_pipe_is_a_signal_and_output_to_it_is_dropped(comm, agree, monkeypatch):
    end, other = os.pipe()
    pipe = os.fdopen(other, "w")
    monkeypatch.setattr(sys, "stdout", pipe)
    with Interrupts(comm) as interrupts:
        print("read", flush=True)
        assert agree(os.read(end, 10) == b"read\n" and interrupts.received() == 0)
        os.close(end)
        if comm.rank == comm.size - 1:
            for _ in range(2):
                print("dropped", flush=True)
        assert agree(interrupts.received() == signal.SIGPIPE)
        with pytest.raises(BrokenPipeError, match="nobody reads the output"):
            interrupts.take_effect(signal.SIGPIPE)
    assert sys.stdout is pipe
    monkeypatch.undo()
    _drop(pipe)


@pytest.mark.serial
def test_one_interrupt_after_a_closed_pipe_still_waits(comm, handler, monkeypatch):
    """Ctrl-C ends the reader of the pipe and reaches the run, in any order."""
    end, other = os.pipe()
    os.close(end)
    pipe = os.fdopen(other, "w")
    monkeypatch.setattr(sys, "stdout", pipe)
    with Interrupts(comm) as interrupts:
        print(flush=True)
        signal.raise_signal(signal.SIGINT)
        assert interrupts.received() == signal.SIGINT
    monkeypatch.undo()
    _drop(pipe)


@pytest.mark.serial
def test_writing_to_a_closed_pipe_is_an_error_of_python():
    """The handler of PETSc would abort the program."""
    script = "import os, dolfinx_nts; r, w = os.pipe(); os.close(r); os.write(w, b'x')"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 1 and "BrokenPipeError" in done.stderr, done.stderr
