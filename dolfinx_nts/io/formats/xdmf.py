"""XDMF file with the fields of a run, and the HDF5 files that hold their values.

``run.xdmf`` lists the states for ParaView, VTK and meshio. The values are in the folder
``run_fields``: the mesh in ``mesh.h5``, and each state in its own file, step 50 in
``000000050.h5``. Each of these files is created atomically, so a killed program leaves complete
states. All ranks write their rows, in the input numbering of the mesh. The files do not depend on
the partition, and a run on another number of ranks can continue them.
"""

import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import h5py

from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.fields import RunFields, mesh_arrays
from dolfinx_nts.io.formats.fields_file import FieldsFile
from dolfinx_nts.io.formats.xml_series import XmlSeries
from dolfinx_nts.io.states import CELLS
from dolfinx_nts.parallel.communication import on_root
from dolfinx_nts.parallel.slabs import Slab

__all__ = ["XdmfFile", "mesh_xml", "state_xml"]


_logger = logging.getLogger("dolfinx_nts")

_HEAD = """<?xml version="1.0" encoding="utf-8"?>
<Xdmf Version="3.0">
  <Domain>
    <Grid Name="states" GridType="Collection" CollectionType="Temporal">
"""
_TAIL = """    </Grid>
  </Domain>
</Xdmf>
"""
_MESH = "mesh.h5"
_STATE = re.compile(r"\d{9}\.h5")
# A killed program may leave a temporary file with the suffix ``.new``.
_OWN = re.compile(r"(\d{9}|mesh)\.h5(\.new)?")

# Names in XDMF by the kind of cells.
_CELLS = {
    "triangle": "Triangle",
    "quadrilateral": "Quadrilateral",
    "tetrahedron": "Tetrahedron",
    "hexahedron": "Hexahedron",
}


def mesh_xml(file: str, mesh: Mapping[str, Any], cell: str) -> str:
    """Describe a mesh. Local.

    Args:
        file: HDF5 file of the mesh, relative to the XDMF file.
        mesh: The arrays of `fields.mesh_arrays`.
        cell: Kind of the cells, as DOLFINx names it.

    Returns:
        XML, a part of the description of each state.
    """
    number = mesh["cells"].shape[0]
    return (
        f'        <Topology TopologyType="{_CELLS[cell]}" NumberOfElements="{number}">\n'
        f"{_item(file, 'cells', mesh['cells'])}        </Topology>\n"
        '        <Geometry GeometryType="XYZ">\n'
        f"{_item(file, 'points', mesh['points'])}        </Geometry>\n"
        f"{_attribute('Cell', file, 'body', mesh['body'])}"
    )


def state_xml(file: str, mesh: str, time: float, fields: Mapping[str, Any]) -> str:
    """Describe a state. Local.

    Args:
        file: HDF5 file of the state, relative to the XDMF file.
        mesh: XML of the mesh.
        time: Time of the state [s].
        fields: Values at the nodes by name, shape ``(n,)`` or ``(n, 3)``. Names of cell values
            begin with ``cells/``, or they are in a group ``cells``; their shape may also be ``(m,
            9)``.

    Returns:
        XML element, without the indentation of its first line.
    """
    cells = CELLS.rstrip("/")
    group = fields.get(cells, {})
    every = {name: fields[name] for name in fields if name != cells}
    every |= {f"{CELLS}{name}": group[name] for name in group}
    attributes = (_attribute(_centre(name), file, name, every[name]) for name in sorted(every))
    return (
        '<Grid Name="state" GridType="Uniform">\n'
        f'{mesh}        <Time Value="{time!r}"/>\n{"".join(attributes)}      </Grid>\n'
    )


def _centre(name: str) -> str:
    return "Cell" if name.startswith(CELLS) else "Node"


def _attribute(centre: str, file: str, name: str, values: Any) -> str:
    kind = {(): "Scalar", (3,): "Vector", (9,): "Tensor"}[values.shape[1:]]
    label = name.removeprefix(CELLS)
    return (
        f'        <Attribute Name="{label}" AttributeType="{kind}" Center="{centre}">\n'
        f"{_item(file, name, values)}        </Attribute>\n"
    )


def _item(file: str, name: str, values: Any) -> str:
    dimensions = " ".join(str(n) for n in values.shape)
    kind = "Float" if values.dtype.kind == "f" else "Int"
    return (
        f'          <DataItem Dimensions="{dimensions}" NumberType="{kind}" '
        f'Precision="{values.dtype.itemsize}" Format="HDF">{escape(file)}:/{name}</DataItem>\n'
    )


class XdmfFile(FieldsFile):
    """Writes the fields of a run as XDMF, ``run.xdmf``; see the module and `FieldsFile`."""

    _own = _OWN

    def __init__(self, path: Path, stepper: Stepper, fields: RunFields) -> None:
        super().__init__(path, stepper, fields)
        first = path.name[0]
        # VTK drops a leading space and leading letters that are not ASCII.
        self._prefix = "" if first.isascii() and first != " " else "./"
        self._series = XmlSeries(path, _HEAD, _TAIL)
        self._mesh_xml = ""
        self._cell = stepper.u.function_space.mesh.topology.cell_name()

    def open(self, resume: bool) -> None:
        mesh = mesh_arrays(self._stepper)
        self._steps = on_root(self._comm, lambda: self._begin(mesh, resume))
        self._folder.write(self._comm, _MESH, {name: [slab] for name, slab in mesh.items()}, {})

    def write(self, now: CurrentState) -> None:
        step = self._stepper.step
        if step in self._steps:
            return
        fields, name, t = self._rows_of(now), f"{step:09d}.h5", self._stepper.t
        slabs = {of: [slab] for of, slab in fields.items()}
        self._folder.write(self._comm, name, slabs, {"time": t})
        on_root(self._comm, lambda: self._series.append(self._state_xml(name, t, fields)))
        self._steps.add(step)

    def close(self) -> None:
        """Remove the padding for more states from the XDMF file."""
        on_root(self._comm, self._series.close)

    def leave(self) -> None:
        """Do nothing: no state is buffered."""

    # --- on rank 0 --------------------------------------------------------

    def _begin(self, mesh: dict[str, Slab], resume: bool) -> set[int]:
        """Remove outdated states; return the steps of the remaining ones."""
        self._mesh_xml = mesh_xml(self._reference(_MESH), mesh, self._cell)
        states = self._states() if resume else {}
        # References to states are removed before the states.
        self._series.start(states.values())
        self._folder.begin({_MESH, *states})
        return {int(Path(name).stem) for name in states}

    def _states(self) -> dict[str, str]:
        """XML of the states up to the current step, by the names of their files."""
        found = {path.name for path in self._folder.files(_STATE)}
        names = found | {f"{step:09d}.h5" for step in self._steps}
        last, states = f"{self._stepper.step:09d}.h5", {}
        for name in sorted(name for name in names if name <= last):
            path = self._folder.path / name
            try:
                with h5py.File(path, "r") as file:
                    states[name] = self._state_xml(name, float(file.attrs["time"]), file)
            except Exception as error:  # of many kinds
                # The files were changed by others; the run itself is complete.
                moved = self._folder.move_aside()
                _logger.warning(
                    "%s cannot be read: %s; the fields begin at this step, %s", path, error, moved
                )
                return {}
        return states

    def _state_xml(self, name: str, time: float, fields: Mapping[str, Any]) -> str:
        return state_xml(self._reference(name), self._mesh_xml, time, fields)

    def _reference(self, name: str) -> str:
        """Path by which the XDMF file refers to a file in the folder."""
        return f"{self._prefix}{self._folder.path.name}/{name}"
