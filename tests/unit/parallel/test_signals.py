"""Signals that wait, sent by the test itself."""

import signal
import threading

import pytest

from dolfinx_nts.parallel.signals import Interrupts


class Stopped(Exception):
    """What the handler of the test raises."""


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


def test_signal_that_has_waited_does_what_it_would_have_done(comm, handler):
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
