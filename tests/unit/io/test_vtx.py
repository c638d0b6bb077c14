"""VTX files of the recorder, read back by ADIOS2 where it is installed."""

import dolfinx.io
import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.diagnostics.nodal_fields import NodalFields
from dolfinx_nts.parallel.slabs import Some
from helpers.scenes import BLOCK_STEP, blocks

pytestmark = pytest.mark.at_most_two_ranks

needs_adios = pytest.mark.skipif(
    not hasattr(dolfinx.io, "VTXWriter"), reason="DOLFINx has no ADIOS2"
)


def sliding_blocks(comm, cell="hexahedron"):
    """Return blocks with friction, so that there are all fields."""
    old = blocks(comm, cell=cell).stepper
    pairs = [
        nts.ContactPair(
            p.nodes,
            p.segments,
            friction=nts.Coulomb(0.3),
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
        for p in old.pairs
    ]
    stepper = nts.EnergyMomentum(old.bodies, pairs, dt=BLOCK_STEP)
    stepper.v.x.array[:] = old.v.x.array
    return stepper


def record(stepper, path, **options):
    """Record four steps; returns the last fields on all ranks, by position."""
    with nts.Recorder(path, stepper, fields="vtx", **options) as recorder:
        for step in stepper.run(until=stepper.t + 4 * BLOCK_STEP):
            recorder.write(step)
    X = stepper.u.function_space.tabulate_dof_coordinates()[: len(stepper.node_ids)]
    comm = stepper.u.function_space.mesh.comm
    fields = {"X": X, **NodalFields(stepper).of(CurrentState(stepper))}
    fields = {k: f.whole(len(X)) if isinstance(f, Some) else f for k, f in fields.items()}
    return {name: np.concatenate(comm.allgather(values)) for name, values in fields.items()}


@needs_adios
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_states_are_read_back(comm, folder, agree, cell):
    adios2 = pytest.importorskip("adios2")
    stepper = sliding_blocks(comm, cell)
    expected = record(stepper, folder / "run", every=2)
    comm.barrier()
    times = []
    with adios2.Stream(str(folder / "run.bp"), "r") as stream:
        for _ in stream.steps():
            times.append(float(stream.read("step")))
            data = {
                name: np.concatenate([stream.read(name, block_id=i) for i in range(comm.size)])
                for name in ["geometry", "body", *expected]
                if name != "X"
            }
    assert agree(np.allclose(times, BLOCK_STEP * np.array([0, 2, 4])))
    # A block is what a rank knows: its own nodes and its ghosts.
    distance = np.linalg.norm(data.pop("geometry")[:, None] - expected.pop("X"), axis=2)
    at = distance.argmin(axis=1)
    assert agree(distance.min(axis=1).max() < 1e-12 and set(at) == set(range(distance.shape[1])))
    for name, values in expected.items():
        found = data[name].reshape(len(at), *values.shape[1:])
        assert agree(np.array_equal(found, values[at], equal_nan=True)), name
    assert agree(np.array_equal(np.unique(data["body"]), [0, 1]))


@needs_adios
def test_the_table_comes_with_it_and_xdmf_does_not(comm, folder, agree):
    record(sliding_blocks(comm), folder / "run")
    comm.barrier()
    assert agree({path.name for path in folder.iterdir()} == {"run.bp", "run.csv"})
    rows = (folder / "run.csv").read_text().splitlines()
    assert agree(len(rows) == 6)


@needs_adios
def test_a_folder_is_replaced_and_a_file_is_not(comm, folder, refused):
    stepper = sliding_blocks(comm)
    record(stepper, folder / "run")
    record(stepper, folder / "run")
    if comm.rank == 0:
        (folder / "other.bp").write_text("mine")
    comm.barrier()
    with refused(OSError, "expected a folder that can be replaced, given .*other.bp"):
        record(stepper, folder / "other")
    assert (folder / "other.bp").read_text() == "mine"


@needs_adios
def test_a_file_that_cannot_go_on_is_refused_with_resume(comm, folder, refused):
    with refused(ValueError, "expected fields='vtkhdf' with resume"):
        record(sliding_blocks(comm), folder / "run", resume=True)


def test_without_adios_it_is_refused(comm, folder, monkeypatch, refused):
    monkeypatch.delattr(dolfinx.io, "VTXWriter", raising=False)
    with refused(RuntimeError, "expected a DOLFINx with ADIOS2"):
        record(sliding_blocks(comm), folder / "run")
    assert not any(folder.iterdir())


def test_other_kinds_are_refused(comm, folder, refused):
    with refused(ValueError, "expected fields to be one of 'vtkhdf', 'xdmf', 'vtx', given 'vtk'"):
        nts.Recorder(folder / "run", sliding_blocks(comm), fields="vtk")
