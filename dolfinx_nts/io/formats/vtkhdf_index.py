"""Index of a VTKHDF file: its mesh and its states, whose values lie in other HDF5 files.

The format is VTK's for an unstructured grid with time steps, with one partition and a constant
mesh. Arrays are virtual datasets of HDF5: readers get the values from the files of the folder. The
index itself is small, so it can be replaced as a whole.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from dolfinx_nts.io.states import CELLS
from dolfinx_nts.parallel.slabs import Slab

__all__ = ["Block", "Field", "grid_arrays", "write_index"]

# Numbers of VTK by the kind of cells.
_CELLS = {"triangle": 5, "quadrilateral": 9, "tetrahedron": 10, "hexahedron": 12}
# Datasets of lengths and offsets of the mesh, which are the same in all steps.
_OFFSETS = ("PointOffsets", "CellOffsets", "ConnectivityIdOffsets")


@dataclass(frozen=True)
class Field:
    """Shape of a field of one state, with a row for each node or cell, and its type."""

    shape: tuple[int, ...]
    dtype: Any

    @classmethod
    def of(cls, values: Any) -> "Field":
        """Shape and type of the values of a field."""
        return cls(values.shape, values.dtype)


@dataclass(frozen=True)
class Block:
    """States in one file, with the values of each field concatenated state by state.

    Attributes:
        file: The file, relative to the index.
        steps: Number of the step of each state.
        times: Their times [s].
        fields: Fields by name; names of fields of cells begin with ``cells/``.
    """

    file: str
    steps: tuple[int, ...]
    times: tuple[float, ...]
    fields: Mapping[str, Field]

    @classmethod
    def read(cls, path: Path) -> "Block":
        """Describe a file of states. Local.

        Raises:
            Exception: The file cannot be read or is incomplete; the type depends on the error.
        """
        with h5py.File(path, "r") as file:
            steps, times = (tuple(file.attrs[name].tolist()) for name in ("steps", "times"))
            fields: dict[str, Field] = {}

            def add(name: str, item: Any) -> None:
                if isinstance(item, h5py.Dataset):
                    rows, rest = divmod(len(item), len(steps))
                    if rest:
                        raise ValueError(f"{name} has no whole states")
                    fields[name] = Field((rows, *item.shape[1:]), item.dtype)

            file.visititems(add)
        return cls(f"{path.parent.name}/{path.name}", steps, times, fields)


def grid_arrays(mesh: Mapping[str, Slab], cell: str) -> dict[str, Slab]:
    """Arrays that describe a mesh in VTK. Local.

    Args:
        mesh: Arrays of `fields.mesh_arrays`.
        cell: Kind of the cells, as DOLFINx names it.

    Returns:
        Rows for this rank of arrays by their names in VTK, and of ``body``.
    """
    (cells, begin, length), size = mesh["cells"], mesh["cells"].shape[1]
    # There is one more offset than cells; the rank with the last cell writes it.
    more = 1 if len(cells) and begin + len(cells) == length else 0
    offsets = size * np.arange(begin, begin + len(cells) + more, dtype=np.int64)
    return {
        "Points": mesh["points"],
        "Connectivity": mesh["cells"].split(size),
        "Offsets": Slab(offsets, begin, length + 1),
        "Types": Slab(np.full(len(cells), _CELLS[cell], dtype=np.uint8), begin, length),
        "CellData/body": mesh["body"],
    }


def write_index(
    file: h5py.File, grid: str, arrays: Mapping[str, Field], blocks: Sequence[Block]
) -> None:
    """Write the index of a mesh and its states. Local.

    Args:
        file: File that is written, empty.
        grid: File with the arrays of the mesh, relative to the index.
        arrays: Arrays of the file, see `grid_arrays`.
        blocks: The states, at least one, all with the same fields.
    """
    root = file.create_group("VTKHDF")
    root.attrs["Version"] = np.array([2, 0], dtype=np.int64)
    root.attrs["Type"] = np.bytes_("UnstructuredGrid")
    for name, array in arrays.items():
        _join(root, name, [(grid, name, array)])
    lengths = {"Points": "Points", "Cells": "Types", "ConnectivityIds": "Connectivity"}
    for name, of in lengths.items():
        root[f"NumberOf{name}"] = np.array([arrays[of].shape[0]], dtype=np.int64)

    times = np.concatenate([block.times for block in blocks])
    count = len(times)
    steps, zeros = root.create_group("Steps"), np.zeros(count, dtype=np.int64)
    steps.attrs["NSteps"] = count
    steps["Values"] = times
    steps["PartOffsets"] = steps["PointOffsets"] = zeros
    steps["NumberOfParts"] = zeros + 1
    steps["CellOffsets"] = steps["ConnectivityIdOffsets"] = zeros[:, None]
    steps["CellDataOffsets/body"] = zeros
    for name, field in blocks[0].fields.items():
        kind = "CellData" if name.startswith(CELLS) else "PointData"
        label, rows = name.removeprefix(CELLS), field.shape[0]
        parts = [
            (block.file, name, Field((len(block.times) * rows, *field.shape[1:]), field.dtype))
            for block in blocks
        ]
        _join(root, f"{kind}/{label}", parts)
        steps[f"{kind}Offsets/{label}"] = rows * np.arange(count, dtype=np.int64)


def _join(root: h5py.Group, name: str, parts: Sequence[tuple[str, str, Field]]) -> None:
    """Create a virtual dataset of the rows of datasets, given by file, name and shape."""
    begins = list(accumulate((field.shape[0] for _, _, field in parts), initial=0))
    first = parts[0][2]
    layout = h5py.VirtualLayout((begins[-1], *first.shape[1:]), first.dtype)
    for begin, end, (file, of, field) in zip(begins[:-1], begins[1:], parts, strict=True):
        # In HDF5 a single % is the start of a pattern.
        source = h5py.VirtualSource(file.replace("%", "%%"), of, field.shape, field.dtype)
        layout[begin:end] = source
    root.create_virtual_dataset(name, layout)
