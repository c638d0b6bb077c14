"""XDMF file with the fields of a stepper, one time series for ParaView.

Rank 0 collects and writes them, in the numbers of the mesh as read: files do
not depend on the partition, and another number of ranks can go on with them.
"""

import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from mpi4py import MPI

import h5py
import numpy as np

from dolfinx_nts.common.arrays import Array
from dolfinx_nts.compat import geometry_nodes
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import input_ids
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.crash_safe_file import JournaledFile
from dolfinx_nts.io.fields import nodal_fields
from dolfinx_nts.parallel.communication import gathered, on_root

__all__ = ["FieldFile"]


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
# Name in XDMF, and order of its vertices in the one of DOLFINx.
_CELLS = {
    "tetrahedron": ("Tetrahedron", [0, 1, 2, 3]),
    "hexahedron": ("Hexahedron", [0, 1, 3, 2, 4, 5, 7, 6]),
}


class FieldFile:
    """The fields of `nodal_fields` and the number of the body of each cell.

    On cells of degree 1: cells of degree 2 become eight, on their nodes.

    Each state is on disk at once. Collective, as all its methods but `abandon`.

    Args:
        path: The file, ``.xdmf``; a file ``.h5`` comes with it.
        stepper: What is run.
        resume: Go on with the files that are there, whose states after
            the present step are dropped, instead of replacing them.

    Raises:
        OSError: The files cannot be written.
    """

    def __init__(self, path: Path, stepper: Stepper, *, resume: bool = False) -> None:
        """Open the files; write the mesh, or drop what comes later."""
        self._path, self._stepper = path, stepper
        self._comm: MPI.Comm = stepper.u.function_space.mesh.comm
        self._data: Any = None
        self._file: JournaledFile | None = None
        self._text: IO[bytes] | None = None
        mesh = self._mesh()
        on_root(self._comm, lambda: self._open(mesh, resume))

    def write(self) -> None:
        """Write the present state, unless it has been written.

        Raises:
            OSError: The disk is full, for instance.
        """
        name = f"states/{self._stepper.step:09d}"
        if on_root(self._comm, lambda: name in self._data):
            return
        ids = self._stepper.node_ids
        fields = {
            key: gathered(self._comm, ids, f)[1] for key, f in nodal_fields(self._stepper).items()
        }
        on_root(self._comm, lambda: self._append(name, self._stepper.t, fields))

    def flush(self) -> None:
        """Bring all states to the disk itself."""
        on_root(self._comm, self._sync)

    def close(self) -> None:
        """Close the files; then any rank may read them."""
        on_root(self._comm, self.abandon)

    def abandon(self) -> None:
        """Close the files where the ranks may be apart after an error. Local."""
        if self._text is not None:
            self._text.close()
        if self._file is not None:
            self._data.close()
            self._file.commit()
            self._file.close()
            self._file = None

    def _mesh(self) -> dict[str, Array]:
        """Nodes, cells and number of the body by original numbers. Collective."""
        V = self._stepper.u.function_space
        mesh, element = V.mesh, Element.of(V)
        # Vertices as read; computed ones have a round-off of the partition.
        points = V.tabulate_dof_coordinates()
        corners = geometry_nodes(mesh)
        points[V.dofmap.list[:, : corners.shape[1]]] = mesh.geometry.x[corners]
        cell = np.arange(mesh.topology.index_map(3).size_local)
        original = mesh.topology.original_cell_index[cell]
        body = np.empty(len(cell), dtype=np.int32)
        for number, b in enumerate(self._stepper.bodies):
            body[b.cells] = number
        order = _CELLS[mesh.topology.cell_name()][1]
        pieces = input_ids(V)[V.dofmap.list[cell]][:, element.pieces[:, order]]
        cells = gathered(self._comm, original, pieces)[1].reshape(-1, len(order))
        ids = self._stepper.node_ids
        numbers, points = gathered(self._comm, ids, points[: len(ids)])
        bodies = gathered(self._comm, original, body)[1]
        return {
            "points": points,
            "cells": np.searchsorted(numbers, cells),
            "body": np.repeat(bodies, len(element.pieces)),
        }

    def _open(self, mesh: dict[str, Array], resume: bool) -> None:
        data = self._path.with_suffix(".h5")
        if resume:
            try:
                self._file = JournaledFile(data, new=False)
                self._data = h5py.File(self._file, "r+")
                states = self._data["states"]
                for name in [name for name in states if int(name) > self._stepper.step]:
                    del states[name]
            except (OSError, KeyError, RuntimeError) as error:
                # Someone else has changed it; the run itself is whole.
                _logger.warning("the fields begin anew, as %s cannot be read: %s", data, error)
                if data.exists():
                    data.replace(f"{data}.damaged")
                resume = False
        if not resume:
            self._file = JournaledFile(data, new=True)
            self._data = h5py.File(self._file, "w")
            states = self._data.create_group("states")
            for name, values in mesh.items():
                self._data[f"mesh/{name}"] = values
        self._commit()
        self._text = open(self._path, "wb")
        self._text.write(_HEAD.encode())
        self._end = self._text.tell()
        self._add_text("".join(self._grid(f"states/{name}") for name in sorted(states)))

    def _append(self, name: str, t: float, fields: dict[str, Array]) -> None:
        for key, values in fields.items():
            self._data[f"{name}/{key}"] = values
        self._data[name].attrs["time"] = t
        self._commit()
        self._add_text(self._grid(name))

    def _commit(self) -> None:
        assert self._file is not None
        self._data.flush()
        self._file.commit()

    def _add_text(self, text: str) -> None:
        assert self._text is not None
        self._text.seek(self._end)
        self._text.write((text + _TAIL).encode())
        self._text.flush()
        self._end += len(text.encode())

    def _grid(self, name: str) -> str:
        """XML of a state."""
        group = self._data[name]
        item: Callable[[str], str] = self._item
        cell = _CELLS[self._stepper.u.function_space.mesh.topology.cell_name()][0]
        number = len(self._data["mesh/cells"])
        fields = "".join(
            f'        <Attribute Name="{key}" AttributeType="{kind}" Center="{centre}">\n'
            f"{item(where)}        </Attribute>\n"
            for key, where, centre in [
                *((key, f"{name}/{key}", "Node") for key in group),
                ("body", "mesh/body", "Cell"),
            ]
            for kind in ["Vector" if self._data[where].ndim == 2 else "Scalar"]
        )
        return (
            '      <Grid Name="state" GridType="Uniform">\n'
            f'        <Topology TopologyType="{cell}" NumberOfElements="{number}">\n'
            f"{item('mesh/cells')}        </Topology>\n"
            f'        <Geometry GeometryType="XYZ">\n{item("mesh/points")}        </Geometry>\n'
            f'        <Time Value="{float(group.attrs["time"])!r}"/>\n{fields}      </Grid>\n'
        )

    def _item(self, name: str) -> str:
        """XML of a dataset."""
        data = self._data[name]
        dimensions = " ".join(str(n) for n in data.shape)
        kind = "Float" if data.dtype.kind == "f" else "Int"
        file = self._path.with_suffix(".h5").name
        return (
            f'          <DataItem Dimensions="{dimensions}" NumberType="{kind}" '
            f'Precision="{data.dtype.itemsize}" Format="HDF">{file}:/{name}</DataItem>\n'
        )

    def _sync(self) -> None:
        for path in (self._path, self._path.with_suffix(".h5")):
            with open(path, "rb") as file:
                os.fsync(file.fileno())
