"""XML by which an XDMF file describes a mesh and a state.

The values themselves lie in HDF5 files. Each array is described by its shape, its type and the
file that holds it, so datasets of HDF5 serve as well as arrays of NumPy.
"""

from collections.abc import Mapping
from typing import Any
from xml.sax.saxutils import escape

from dolfinx_nts.io.states import CELLS

__all__ = ["mesh_xml", "state_xml"]

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
        XML, a part of that of each state.
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
        fields: Values at the nodes by name, shape ``(n,)`` or ``(n, 3)``; those of cells, also
            tensors ``(m, 9)``, have names that begin with ``cells/``, or are in such a group.

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
