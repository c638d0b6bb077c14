"""Files of a Recorder, read by programs that know nothing of this package.

VTK has the reader of ParaView, meshio its own. Their results are compared
with the run itself.
"""

from dataclasses import dataclass

import numpy as np
import pytest

import dolfinx_nts as nts
from helpers.once import once
from helpers.readers import read_grids
from helpers.scene import gathered, input_ids
from helpers.scenes import BLOCK_STEP, blocks

pytestmark = pytest.mark.at_most_two_ranks

STEPS = 6
VERTICES = {"hexahedron": 8, "tetrahedron": 4}
# File numbers of a hexahedron's vertices; tetrahedra have one order only.
VTK_ORDER = {"hexahedron": [0, 1, 3, 2, 4, 5, 7, 6], "tetrahedron": [0, 1, 2, 3]}

readers = pytest.mark.parametrize(
    ("reader", "fields"), [("vtk", "vtkhdf"), once("vtk", "xdmf"), ("meshio", "xdmf")]
)
cells_ = pytest.mark.parametrize("cell", ["hexahedron", once("tetrahedron")])


@dataclass
class File:
    """What a reader finds: cells in VTK's order, fields by state."""

    times: np.ndarray
    points: np.ndarray
    cells: np.ndarray
    nodal: list[dict[str, np.ndarray]]
    cellwise: list[dict[str, np.ndarray]]


def read_vtk(path):
    """Read with VTK's reader of this kind of file."""
    times, grids = read_grids(path)
    (cells,) = grids[0].cells_dict.values()
    return File(
        times,
        grids[0].points,
        cells,
        [dict(grid.point_data) for grid in grids],
        [dict(grid.cell_data) for grid in grids],
    )


def read_meshio(path):
    """Read with meshio's reader of time series."""
    meshio = pytest.importorskip("meshio")
    with meshio.xdmf.TimeSeriesReader(path) as reader:
        points, (block,) = reader.read_points_cells()
        states = [reader.read_data(i) for i in range(reader.num_steps)]
    return File(
        np.array([t for t, _, _ in states]),
        points,
        block.data,
        [nodal for _, nodal, _ in states],
        [{name: values for name, (values,) in fields.items()} for _, _, fields in states],
    )


def nodal_fields(stepper):
    """Fields of the present state by input number, from the pairs. Collective."""
    V = stepper.u.function_space
    n = len(V.tabulate_dof_coordinates())
    (pair,), (contact,) = stepper.pairs, stepper.contacts
    here = {
        "displacement": stepper.u.x.array.reshape(-1, 3),
        "velocity": stepper.v.x.array.reshape(-1, 3),
    }
    surface = {
        "gap": pair.gap(stepper.x),
        "contact_pressure": pair.pressure,
        "active": pair.history.active,
        "slip_state": np.where(pair.history.sliding, 2, pair.history.active),
        "accumulated_slip": pair.history.slip,
        "contact_traction": pair.history.force / contact.area[:, None],
        "friction_traction": -pair.history.traction / contact.area[:, None],
    }
    for name, values in surface.items():
        here[name] = np.zeros((n, 3))
        here[name][:] = np.nan if name == "gap" else 0.0
        here[name][pair.nodes.nodes] = values if values.ndim == 2 else values[:, None]
    fields = {name: gathered(V, values) for name, values in here.items()}
    vectors = ("displacement", "velocity", "contact_traction", "friction_traction")
    return {name: values if name in vectors else values[:, 0] for name, values in fields.items()}


def mesh_of(stepper, cell):
    """Input numbers of each cell's nodes, sorted, with its body. Collective."""
    V = stepper.u.function_space
    ids, rows = input_ids(V), []
    for number, body in enumerate(stepper.bodies):
        for nodes in ids[V.dofmap.list[body.cells]]:
            rows.append((*nodes[VTK_ORDER[cell]].tolist(), number))
    return sorted(row for part in V.mesh.comm.allgather(rows) for row in part)


@readers
@cells_
def test_another_reader_finds_the_data_of_the_run(comm, tmp_path, agree, reader, fields, cell):
    folder = comm.bcast(tmp_path)
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
    expected = [nodal_fields(stepper)]
    with nts.Recorder(folder / "run", stepper, fields=fields) as record:
        for step in stepper.run(until=STEPS * BLOCK_STEP):
            record.write(step)
            expected.append(nodal_fields(stepper))
    comm.barrier()

    found = {"vtk": read_vtk, "meshio": read_meshio}[reader](folder / f"run.{fields}")
    X = gathered(stepper.u.function_space, stepper.u.function_space.tabulate_dof_coordinates())
    assert agree(np.allclose(found.times, BLOCK_STEP * np.arange(STEPS + 1), rtol=0, atol=1e-15))
    assert agree(np.allclose(found.points, X, rtol=0, atol=1e-14))
    assert agree(found.cells.shape[1] == VERTICES[cell])
    rows = mesh_of(stepper, cell)
    for nodal, cellwise, known in zip(found.nodal, found.cellwise, expected, strict=True):
        assert agree(nodal.keys() == known.keys() and cellwise.keys() == {"body"})
        for name, values in known.items():
            assert agree(np.array_equal(nodal[name], values, equal_nan=True)), name
        body = cellwise["body"].astype(int)
        assert agree(sorted(map(tuple, np.c_[found.cells, body].tolist())) == rows)
    # The scene has contact.
    assert agree(expected[-1]["slip_state"].any() and expected[-1]["contact_pressure"].any())


def test_hexahedra_are_not_turned_inside_out(comm, tmp_path, agree):
    folder = comm.bcast(tmp_path)
    with nts.Recorder(folder / "run", blocks(comm).stepper):
        pass
    comm.barrier()
    grid = read_grids(folder / "run.vtkhdf")[1][0]
    volumes = grid.compute_cell_sizes(length=False, area=False)["Volume"]
    # The blocks are twisted a little.
    assert agree((volumes > 0).all())
    assert agree(abs(volumes.sum() / (1.2 * 1.2 * 0.5 + 0.8 * 0.8 * 0.4) - 1) < 0.05)


NAMES = ["a&b", "a<b>c", "\"a'b'", "a  b", " a ", "ünïcödé", "日本", "a?>b]]>--", "$HOME%20;#"]


@pytest.mark.serial
@pytest.mark.parametrize("name", NAMES)
def test_files_of_any_name_can_be_read(comm, tmp_path, name):
    folder = tmp_path / name
    folder.mkdir()
    for read, kind in ((read_vtk, "vtkhdf"), (read_vtk, "xdmf"), (read_meshio, "xdmf")):
        with nts.Recorder(f"{folder}/{name}", blocks(comm).stepper, fields=kind):
            pass
        file = read(folder / f"{name}.{kind}")
        assert len(file.points) > 0
        assert not file.nodal[0]["displacement"].any()


@pytest.mark.parametrize("name", [*map(once, ["a\\b", "a\nb", "a/", "a/..", "", "a\udcff"]), "a:b"])
def test_names_that_no_reader_would_take_are_refused(comm, tmp_path, refused, name):
    path = f"{comm.bcast(tmp_path)}/{name}"
    with refused(ValueError, "expected the path of files|expected a name that readers"):
        nts.Recorder(path, blocks(comm).stepper)
