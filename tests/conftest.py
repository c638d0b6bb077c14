"""Fixtures shared by all tests."""

import gc
from collections.abc import Iterator

from mpi4py import MPI

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marks of this suite."""
    config.addinivalue_line("markers", "serial: runs on one rank only")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip tests marked ``serial`` on several ranks."""
    if item.get_closest_marker("serial") and MPI.COMM_WORLD.size > 1:
        pytest.skip("runs on one rank only")


@pytest.fixture
def comm() -> Iterator[MPI.Comm]:
    """World communicator; collects garbage on all ranks together."""
    yield MPI.COMM_WORLD
    gc.collect()
    MPI.COMM_WORLD.barrier()
