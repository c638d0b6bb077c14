"""Files of gmsh, formats 4.1 and 2.0 to 2.2, text and binary, read without gmsh. Local.

Reference: section "MSH file format" of the gmsh manual.
"""

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats, GlobalInts
from dolfinx_nts.meshing.elements import KINDS, Block, Elements

__all__ = ["read_msh"]

_NAME = re.compile(rb'^\s*(\d+)\s+(-?\d+)\s+"(.*)"\s*$', re.MULTILINE)
# Suffixes of mesh files of other programs, which meshio can convert.
_MESHES = {".inp", ".vtk", ".vtu", ".med", ".bdf", ".nas", ".fem", ".e", ".exo", ".mesh", ".cgns"}
_VERSION_4, _VERSION_2 = b"4.1", (b"2.2", b"2.1", b"2", b"2.0")


def read_msh(path: str | os.PathLike[str]) -> Elements:
    """Read a gmsh mesh.

    Args:
        path: A ``.msh`` file of format 4.1, 2.2, 2.1 or 2.0.

    Returns:
        Its content. Nodes are in the order of gmsh: by dimension and number of their entity if the
        file contains it, otherwise in the order of the file.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is of another format, damaged or partitioned.
    """
    data = Path(path).read_bytes()
    if not data.startswith((b"$MeshFormat", b"$Comments")):
        raise ValueError(f"expected a gmsh mesh (.msh), given {os.fspath(path)}: {_remedy(path)}")
    try:
        return _parsed(data)
    except ValueError as error:
        raise ValueError(
            f"expected a gmsh mesh of format 4.1 or 2.2, given {os.fspath(path)}: {error}"
        ) from error


class _Numbers(Protocol):
    """Numbers of a section in the order of the file."""

    def take(self, kind: str, count: int) -> Array:
        """Read the next numbers, of kind ``"int"``, ``"size"`` or ``"real"``."""

    def heading(self) -> int:
        """Read the number of entries of a section of format 2, which is always text."""

    def positions(self, count: int) -> tuple[Array, Array]:
        """Read rows of a number and a position."""

    def elements(self, count: int) -> Iterator[tuple[int, int, Array]]:
        """Read elements of format 2: type, number of tags, and rows of number, tags, nodes."""


def _ints(numbers: _Numbers, kind: str, count: int) -> list[int]:
    """Read the next numbers as integers."""
    return [int(number) for number in numbers.take(kind, count)]


class _Text:
    """Numbers of a text section."""

    def __init__(self, text: bytes) -> None:
        self._all = np.array(text.split()).astype(np.float64)
        self._next = 0

    def take(self, kind: str, count: int) -> Array:
        found = self._all[self._next : self._next + count]
        if len(found) < count:
            raise ValueError(
                f"expected {count} more numbers in a section, as its heading says, "
                f"given {len(found)}"
            )
        self._next += count
        return found if kind == "real" else found.astype(np.int64)

    def heading(self) -> int:
        return int(self.take("int", 1)[0])

    def positions(self, count: int) -> tuple[Array, Array]:
        rows = self.take("real", 4 * count).reshape(count, 4)
        return rows[:, 0].astype(np.int64), rows[:, 1:]

    def elements(self, count: int) -> Iterator[tuple[int, int, Array]]:
        # Consecutive elements of one type and number of tags have rows of equal length. Their
        # number is unknown, so rows are compared in windows of doubling size.
        done, window = 0, 1
        while done < count:
            head = self._all[self._next : self._next + 3].astype(np.int64)
            if len(head) < 3:
                raise ValueError(f"expected {count} elements, given {done}")
            kind, num_tags = int(head[1]), int(head[2])
            length = 3 + num_tags + _num_nodes(kind)
            size = min(window, count - done, (len(self._all) - self._next) // length)
            rows = self._all[self._next : self._next + size * length].reshape(size, length)
            other = np.flatnonzero((rows[:, 1] != kind) | (rows[:, 2] != num_tags))
            same = int(other[0]) if len(other) else size
            if same == 0:
                raise ValueError(f"expected {count} elements, given {done}")
            window = 1 if len(other) else 2 * window
            self._next, done = self._next + same * length, done + same
            yield kind, num_tags, np.delete(rows[:same], (1, 2), axis=1).astype(np.int64)


class _Binary:
    """Numbers of a binary section.

    Attributes:
        position: Position of the next number in the file.
    """

    def __init__(self, data: bytes, position: int, order: str, size: int) -> None:
        self._data, self.position = data, position
        self._types = {"int": f"{order}i4", "size": f"{order}u{size}", "real": f"{order}f8"}

    def take(self, kind: str, count: int) -> Array:
        found = self._records(np.dtype(self._types[kind]), count)
        return found.astype(np.float64 if kind == "real" else np.int64)

    def heading(self) -> int:
        end = self._data.index(b"\n", self.position)
        count = int(self._data[self.position : end])
        self.position = end + 1
        return count

    def positions(self, count: int) -> tuple[Array, Array]:
        row = np.dtype([("number", self._types["int"]), ("x", self._types["real"], 3)])
        rows = self._records(row, count)
        return rows["number"].astype(np.int64), rows["x"].astype(np.float64)

    def elements(self, count: int) -> Iterator[tuple[int, int, Array]]:
        done = 0
        while done < count:
            kind, size, num_tags = _ints(self, "int", 3)
            length = 1 + num_tags + _num_nodes(kind)
            yield kind, num_tags, self.take("int", size * length).reshape(size, length)
            done += size

    def _records(self, dtype: "np.dtype[Any]", count: int) -> Array:
        left = (len(self._data) - self.position) // dtype.itemsize
        if not 0 <= count <= left:
            raise ValueError(f"expected {count} more numbers, given at most {left}")
        found = np.frombuffer(self._data, dtype, count, self.position)
        self.position += count * dtype.itemsize
        return found


class _Content:
    """Content of a file, section by section.

    Attributes:
        names: Names of the physical groups by dimension and tag.
    """

    def __init__(self) -> None:
        self.names: dict[tuple[int, int], str] = {}
        self._groups: dict[tuple[int, int], set[int]] = {}
        self._nodes: list[tuple[int, int, GlobalInts, Floats]] = []  # dimension, entity, ...
        self._blocks: list[Block] = []

    def read_entities(self, numbers: _Numbers) -> None:
        """Read the physical groups of the entities from ``$Entities`` of format 4.1."""
        for dim, count in enumerate(_ints(numbers, "size", 4)):
            for _ in range(count):
                (entity,) = _ints(numbers, "int", 1)
                numbers.take("real", 6 if dim else 3)  # bounding box
                tags = _ints(numbers, "int", *_ints(numbers, "size", 1))
                if dim:
                    numbers.take("int", *_ints(numbers, "size", 1))  # boundary
                # A negative tag reverses the orientation.
                self._groups[dim, entity] = {abs(tag) for tag in tags}

    def read_nodes_4(self, numbers: _Numbers) -> None:
        """Read the section ``$Nodes`` of a file of format 4.1."""
        blocks = _ints(numbers, "size", 4)[0]
        for _ in range(blocks):
            dim, entity, parametric = _ints(numbers, "int", 3)
            (count,) = _ints(numbers, "size", 1)
            own = numbers.take("size", count)
            width = 3 + (dim if parametric else 0)
            x = numbers.take("real", count * width).reshape(count, width)[:, :3]
            self._nodes.append((dim, entity, own, x))

    def read_elements_4(self, numbers: _Numbers) -> None:
        """Read the section ``$Elements`` of a file of format 4.1."""
        blocks = _ints(numbers, "size", 4)[0]
        for _ in range(blocks):
            dim, entity, kind = _ints(numbers, "int", 3)
            (count,) = _ints(numbers, "size", 1)
            width = 1 + _num_nodes(kind)
            rows = numbers.take("size", count * width).reshape(count, width)
            self._groups.setdefault((dim, entity), set())
            self._blocks.append(Block(dim, entity, kind, rows[:, 0], rows[:, 1:]))

    def read_nodes_2(self, numbers: _Numbers) -> None:
        """Read the section ``$Nodes`` of a file of format 2.2."""
        self._nodes.append((0, 0, *numbers.positions(numbers.heading())))

    def read_elements_2(self, numbers: _Numbers) -> None:
        """Read ``$Elements``, with the physical groups of their entities, of format 2.2."""
        for kind, num_tags, rows in numbers.elements(numbers.heading()):
            # First tag: physical group, 0 for none; second: entity.
            tags = np.zeros((len(rows), 2), dtype=np.int64)
            tags[:, : min(num_tags, 2)] = np.abs(rows[:, 1 : 1 + min(num_tags, 2)])
            dim = KINDS[kind].dim
            for physical, entity in ((int(p), int(e)) for p, e in np.unique(tags, axis=0)):
                own = rows[(tags == (physical, entity)).all(axis=1)]
                groups = self._groups.setdefault((dim, entity), set())
                groups.update({physical} - {0})
                self._blocks.append(Block(dim, entity, kind, own[:, 0], own[:, 1 + num_tags :]))

    def elements(self) -> Elements:
        """Combine the sections."""
        if not self._nodes or not self._blocks:
            raise ValueError("sections $Nodes and $Elements are missing")
        self._nodes.sort(key=lambda block: block[:2])
        self._blocks.sort(key=lambda block: block[:2])
        numbers = np.concatenate([own for _, _, own, _ in self._nodes])
        x = np.concatenate([x for *_, x in self._nodes])
        for block in self._blocks:
            if not np.isin(block.nodes, numbers).all():
                raise ValueError(f"elements of {block.dim}D entity {block.entity} lack nodes")
        groups = {entity: tuple(sorted(tags)) for entity, tags in sorted(self._groups.items())}
        return Elements(numbers, x, groups, self.names, tuple(self._blocks))


_READERS = {
    b"Entities": (_Content.read_entities, None),
    b"Nodes": (_Content.read_nodes_4, _Content.read_nodes_2),
    b"Elements": (_Content.read_elements_4, _Content.read_elements_2),
}  # readers by section, of format 4.1 and of format 2


def _parsed(data: bytes) -> Elements:
    """Read all sections of a file."""
    content = _Content()
    is_4, binary, order, size = True, False, "<", 8
    position = 0
    while (start := data.find(b"$", position)) >= 0:
        end_of_line = data.find(b"\n", start)
        if end_of_line < 0:
            raise ValueError("the file is cut off")
        section, position = data[start + 1 : end_of_line].strip(), end_of_line + 1
        reader = _READERS.get(section, (None, None))[0 if is_4 else 1]
        end_mark = b"$End" + section
        try:
            if reader and binary:
                numbers = _Binary(data, position, order, size)
                reader(content, numbers)
                position = numbers.position
            end = data.find(end_mark, position)
            if end < 0:
                raise ValueError("the file is cut off")
            text = data[position:end]
            if section == b"MeshFormat":
                is_4, binary, order, size = _format(text)
            elif section == b"PhysicalNames":
                for dim, tag, name in _NAME.findall(text):
                    content.names[int(dim), abs(int(tag))] = name.decode(errors="replace")
            elif section == b"PartitionedEntities":
                raise ValueError(
                    "a partitioned mesh, but read_mesh partitions meshes itself: call "
                    "gmsh.model.mesh.unpartition() and write the file again"
                )
            elif reader and not binary:
                reader(content, _Text(text))
            position = end + len(end_mark)
        except ValueError as error:
            raise ValueError(f"section ${section.decode(errors='replace')}: {error}") from error
    return content.elements()


def _format(text: bytes) -> tuple[bool, bool, str, int]:
    """Format of the file: whether 4.1, whether binary, byte order, and bytes of a ``size_t``."""
    version, kind, size = text.split(maxsplit=3)[:3]
    if version != _VERSION_4 and version not in _VERSION_2:
        raise ValueError(
            f"format {version.decode(errors='replace')}: write it again by "
            "`gmsh FILE -save -format msh41 -o NEW.msh`"
        )
    binary = int(kind) == 1
    order = "<"
    if binary:  # The number 1 follows, in the byte order of the file.
        one = text.split(b"\n", 1)[1][:4]
        order = "<" if int.from_bytes(one, "little") == 1 else ">"
    return version == _VERSION_4, binary, order, int(size)


def _num_nodes(kind: int) -> int:
    """Number of nodes of an element type."""
    if kind not in KINDS:
        raise ValueError(
            f"element type {kind}, of third or higher order: call gmsh.model.mesh.setOrder(2) or "
            "(1) and write the file again"
        )
    return KINDS[kind].num_nodes


def _remedy(source: str | os.PathLike[str]) -> str:
    """Instructions to convert a file that is not a gmsh mesh, by its suffix."""
    suffix = Path(source).suffix.lower()
    if suffix in _MESHES:
        return (
            f"convert the {suffix[1:].upper()} file by meshio, with the number of the body of each "
            'cell as cell_data "gmsh:physical" and "gmsh:geometrical", and write it as "gmsh22" '
            "(the page on geometry has the script)"
        )
    return (
        "mesh a geometry first (gmsh -3 part.geo, or part.step); a mesh and tags that DOLFINx "
        "reads by itself (XDMFFile) can be used without read_mesh"
    )
