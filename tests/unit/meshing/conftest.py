"""Fixtures of the tests of meshes."""

from collections.abc import Iterator
from typing import Any

from mpi4py import MPI

import pytest


@pytest.fixture
def model(comm: MPI.Comm) -> Iterator[Any]:
    """Empty live gmsh model on rank 0, None elsewhere."""
    if comm.rank != 0:
        yield None
        return
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("test")
    yield gmsh.model
    gmsh.finalize()
