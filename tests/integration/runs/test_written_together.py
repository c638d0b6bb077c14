"""Several ranks write the same files as one rank, and no rank holds all data in memory."""

import tracemalloc
from contextlib import suppress

from mpi4py import MPI

import h5py
import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.fem.node_numbering import input_ids
from dolfinx_nts.io import checkpoint
from helpers.models.boxed import Box
from helpers.readers import read_grids
from helpers.scenes import blocks

# Gaps, of lengths of about one.
ROUND_OFF = 1e-15
# Memory of a rank that sends, receives and sorts, relative to its share of the file. To collect
# and sort on one rank would take two times the whole.
COPIES = 3.5


def moved(stepper):
    """Set displacement and velocity of each node by its number."""
    V = stepper.u.function_space
    ids = input_ids(V)[:, None] % 1013
    stepper.u.x.array[:] = (1e-3 * np.sin(ids * [0.1, 0.2, 0.3])).ravel()
    stepper.v.x.array[:] = np.cos(ids * [1, 2, 3]).ravel()
    return stepper


def arrays(path):
    """Every array in an HDF5 file by name, without data that depend on the partition."""
    found = {}

    def add(name, item):
        if isinstance(item, h5py.Dataset) and not name.startswith("local/"):
            found[name] = item[()]

    with h5py.File(path, "r") as file:
        file.visititems(add)
    return found


@pytest.mark.several_ranks
@pytest.mark.parametrize(("cell", "degree"), [("hexahedron", 1), ("tetrahedron", 2)])
def test_files_of_several_ranks_equal_files_of_one_rank(comm, folder, agree, cell, degree):
    def written(on, name, kind):
        stepper = moved(blocks(on, cell=cell, degree=degree).stepper)
        with nts.Recorder(folder / name, stepper, fields=kind, stress=True):
            pass
        if kind == "vtkhdf":
            checkpoint.save(folder / f"{name}.h5", stepper)

    for kind in ("vtkhdf", "xdmf"):
        written(comm, f"all_{kind}", kind)
        if comm.rank == 0:
            written(MPI.COMM_SELF, f"one_{kind}", kind)
    comm.barrier()
    for name in (
        *("{}_vtkhdf.vtkhdf", "{}_vtkhdf.h5", "{}_xdmf_fields/mesh.h5"),
        "{}_xdmf_fields/000000000.h5",
    ):
        one, other = (arrays(folder / name.format(who)) for who in ("one", "all"))
        assert agree(one.keys() == other.keys() and len(one) > 2)
        for of, values in one.items():
            assert agree(values.dtype == other[of].dtype and values.shape == other[of].shape), of
            # Positions of nodes in the mesh of DOLFINx, from which gaps follow, have a round-off
            # that depends on the partition.
            atol = ROUND_OFF if of.endswith("gap") else 0
            assert agree(np.allclose(other[of], values, rtol=0, atol=atol, equal_nan=True)), of


def test_an_error_on_all_ranks_writes_buffered_states(comm, folder, agree):
    stepper = blocks(comm).stepper
    with suppress(ZeroDivisionError), nts.Recorder(folder / "run", stepper) as record:
        for step in stepper.run(until=3 * stepper.dt):
            record.write(step)
        raise ZeroDivisionError
    comm.barrier()
    assert agree(len(read_grids(folder / "run.vtkhdf")[0]) == 4)


def peak(write):
    """Peak memory of this rank while writing [bytes]."""
    tracemalloc.start()
    try:
        write()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.several_ranks
@pytest.mark.parametrize("what", ["vtkhdf", "xdmf", "checkpoint"])
def test_memory_for_writing_is_shared_by_the_ranks(comm, folder, agree, what):
    stepper = nts.EnergyMomentum([Box(comm, shape=(14, 14, 14)).body], dt=0.1)
    if what == "checkpoint":
        file = folder / "run.h5"
        checkpoint.save(file, stepper)  # cached data
        mine = peak(lambda: checkpoint.save(file, stepper))
    else:
        with nts.Recorder(folder / "run", stepper, fields=what) as record:
            stepper.step = 1
            files = record._files.fields
            mine = peak(lambda: (files.write(CurrentState(stepper)), files.flush()))
        name = "000000001-000000001.h5" if what == "vtkhdf" else "000000001.h5"
        file = folder / "run_fields" / name
    whole = file.stat().st_size
    assert agree(whole > 48 * 15**3)  # displacement and velocity
    most = comm.allreduce(mine, op=MPI.MAX)
    assert agree(most < COPIES / comm.size * whole), most / whole
