"""Fixtures of all tests, and hooks that keep several ranks in step."""

import faulthandler
import gc
import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_nts import compat
from helpers import traps, verified

# Seconds that a rank on which a test failed waits for the others.
_PATIENCE = 30.0


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let `make verification` write its table."""
    note = "run only what measures numbers of the page on verification, and write them to it"
    parser.addoption("--publish", action="store_true", help=note)


def pytest_configure(config: pytest.Config) -> None:
    """Give the fixtures' own messages a communicator and an output."""
    config.stash[_ROWS] = []
    config.stash[_TALK] = MPI.COMM_WORLD.Dup()
    # Tests compile the same forms again and again.
    loaded_once = compat.modules_loaded_once()
    loaded_once.__enter__()
    config.add_cleanup(lambda: loaded_once.__exit__(None, None, None))
    # While tests run, pytest captures their output.
    config.stash[_STDERR] = os.dup(2)


_TALK: pytest.StashKey[MPI.Comm] = pytest.StashKey()
_STDERR: pytest.StashKey[int] = pytest.StashKey()
_ROWS: pytest.StashKey[list[verified.Row]] = pytest.StashKey()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep only tests that measure numbers of the page, if these are to be written."""
    if config.getoption("publish"):
        items[:] = [item for item in items if "table_row" in getattr(item, "fixturenames", ())]


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Write the numbers of the page, unless a test has failed."""
    if session.config.getoption("publish") and exitstatus == pytest.ExitCode.OK:
        verified.write(session.config.stash[_ROWS])


def pytest_collection_finish() -> None:
    """Exclude objects of imported modules from garbage collection, see `comm`."""
    gc.collect()
    gc.freeze()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip tests marked ``serial`` on several ranks, and ``several_ranks`` on one."""
    if MPI.COMM_WORLD.size > 1:
        if item.get_closest_marker("serial"):
            pytest.skip("runs on one rank only")
    elif item.get_closest_marker("several_ranks"):
        pytest.skip("runs on several ranks only")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Run tests with floating-point traps if they are asked for, see `traps`."""
    if not traps.WANTED or item.get_closest_marker("untrapped"):
        return (yield)
    # Above the handler of PETSc, which does not report the place in Python.
    faulthandler.enable(item.config.stash[_STDERR])
    with traps.trapped():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """Let setup, test and teardown fail on all ranks if they fail on one.

    So all ranks continue with the same test. A rank whose fellows never come,
    because they wait for it inside the test, ends the run.
    """
    report = yield
    talk = item.config.stash[_TALK]
    if talk.size == 1:
        return report
    request, start = talk.Ibarrier(), time.monotonic()
    while not request.Test():
        time.sleep(1e-4)
        if report.failed and time.monotonic() - start > _PATIENCE:
            print(f"rank {talk.rank}: {item.nodeid}\n{report.longreprtext}", file=sys.stderr)
            sys.stderr.flush()
            MPI.COMM_WORLD.Abort(1)
    texts = talk.allgather(report.longreprtext if report.failed else "")
    if any(texts) and not report.failed:
        report.outcome = "failed"
        report.longrepr = "\n".join(f"rank {r}: {text}" for r, text in enumerate(texts) if text)
    return report


@pytest.fixture
def comm() -> Iterator[MPI.Comm]:
    """World communicator; collects garbage on all ranks together.

    What survives is kept for good (caches of UFL above all), and not looked at
    again: that took a third of the time of all tests.
    """
    yield MPI.COMM_WORLD
    gc.collect()
    gc.freeze()
    MPI.COMM_WORLD.barrier()


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same in every run and on every rank."""
    return np.random.default_rng(20110401)


@pytest.fixture
def folder(comm: MPI.Comm, tmp_path: Path) -> Path:
    """One empty folder for all ranks. Collective."""
    return comm.bcast(tmp_path)


@pytest.fixture
def agree(comm: MPI.Comm) -> Callable[[object], bool]:
    """Whether something is true on all ranks. Collective."""

    def everywhere(flag: object) -> bool:
        return bool(comm.allreduce(bool(flag), op=MPI.LAND))

    return everywhere


@pytest.fixture
def refused(comm: MPI.Comm) -> Callable[[type[Exception], str], AbstractContextManager[None]]:
    """Context in which all ranks must raise the same error. Collective."""

    @contextmanager
    def context(error: type[Exception], match: str) -> Iterator[None]:
        raised: Exception | None = None
        try:
            yield
        except Exception as caught:
            raised = caught
        found = comm.allgather((type(raised).__name__, str(raised)))
        assert len(set(found)) == 1, f"different on the ranks: {found}"
        assert isinstance(raised, error), f"expected {error.__name__}, raised {found[0]}"
        assert re.search(match, str(raised)), f"expected {match!r}, raised {found[0]}"

    return context


@pytest.fixture
def table_row(request: pytest.FixtureRequest) -> Callable[[str, str, str], None]:
    """Function by which a test reports case, reference and result of a row of `verified.TABLE`."""
    section = request.module.__doc__.splitlines()[0].removesuffix(".")
    path = str(request.path.relative_to(Path(__file__).parents[1]))

    def add(case: str, reference: str, ours: str) -> None:
        row = verified.Row(section, path, case, reference, ours)
        request.config.stash[_ROWS].append(row)
        if not request.config.getoption("publish"):
            (printed,) = (other for other in verified.read() if other.case == case)
            assert row._replace(ours=printed.ours) == printed
            assert not verified.differs(ours, printed.ours), f"{ours}, on the page {printed.ours}"

    return add
