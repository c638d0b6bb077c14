"""Elements, entities and physical groups of a gmsh model, without gmsh. Local."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats, GlobalInts

__all__ = ["ENTITIES", "KINDS", "Block", "Elements", "Kind", "names", "stacked"]

ENTITIES = ("point", "curve", "surface", "volume")  # by dimension


class Kind(NamedTuple):
    """An element type of gmsh.

    Attributes:
        name: Its name in gmsh, with the number of nodes.
        dim: Topological dimension.
        order: Polynomial degree.
        num_nodes: Number of nodes.
    """

    name: str
    dim: int
    order: int
    num_nodes: int


# Element types by gmsh's number: all types up to second order, and complete ones of third order.
# Messages name other types by their number.
KINDS = {
    1: Kind("Line 2", 1, 1, 2),
    2: Kind("Triangle 3", 2, 1, 3),
    3: Kind("Quadrilateral 4", 2, 1, 4),
    4: Kind("Tetrahedron 4", 3, 1, 4),
    5: Kind("Hexahedron 8", 3, 1, 8),
    6: Kind("Prism 6", 3, 1, 6),
    7: Kind("Pyramid 5", 3, 1, 5),
    8: Kind("Line 3", 1, 2, 3),
    9: Kind("Triangle 6", 2, 2, 6),
    10: Kind("Quadrilateral 9", 2, 2, 9),
    11: Kind("Tetrahedron 10", 3, 2, 10),
    12: Kind("Hexahedron 27", 3, 2, 27),
    13: Kind("Prism 18", 3, 2, 18),
    14: Kind("Pyramid 14", 3, 2, 14),
    15: Kind("Point", 0, 0, 1),
    16: Kind("Quadrilateral 8", 2, 2, 8),
    17: Kind("Hexahedron 20", 3, 2, 20),
    18: Kind("Prism 15", 3, 2, 15),
    19: Kind("Pyramid 13", 3, 2, 13),
    21: Kind("Triangle 10", 2, 3, 10),
    26: Kind("Line 4", 1, 3, 4),
    29: Kind("Tetrahedron 20", 3, 3, 20),
    36: Kind("Quadrilateral 16", 2, 3, 16),
    92: Kind("Hexahedron 64", 3, 3, 64),
}


class Block(NamedTuple):
    """Elements of one type on one entity.

    Attributes:
        dim: Dimension of the entity.
        entity: Number of the entity.
        kind: gmsh's number of the element type.
        numbers: Numbers of the elements, shape ``(m,)``.
        nodes: Numbers of their nodes in gmsh's order, shape ``(m, k)``.
    """

    dim: int
    entity: int
    kind: int
    numbers: GlobalInts
    nodes: GlobalInts


class Elements(NamedTuple):
    """Nodes, elements, entities and physical groups of a model.

    Attributes:
        numbers: Numbers of the nodes, shape ``(n,)``.
        x: Their positions, shape ``(n, 3)`` [m].
        groups: Tags of the physical groups of each entity, by its dimension and number.
        names: Names of physical groups by dimension and tag; a group may have none.
        blocks: The elements; entities in ascending order.
    """

    numbers: GlobalInts
    x: Floats
    groups: Mapping[tuple[int, int], tuple[int, ...]]
    names: Mapping[tuple[int, int], str]
    blocks: tuple[Block, ...]

    def kinds(self, dim: int) -> dict[int, int]:
        """Numbers of elements of one dimension by type, in ascending order."""
        found: dict[int, int] = {}
        for block in self.blocks:
            if block.dim == dim and len(block.numbers):
                found[block.kind] = found.get(block.kind, 0) + len(block.numbers)
        return dict(sorted(found.items()))

    def entities(self, dim: int) -> list[int]:
        """Numbers of the entities of one dimension, in ascending order."""
        return sorted(entity for of, entity in self.groups if of == dim)

    def positions(self, nodes: GlobalInts) -> Floats:
        """Positions of nodes, shape ``(*nodes.shape, 3)`` [m]."""
        order = np.argsort(self.numbers)
        x: Floats = self.x[order[np.searchsorted(self.numbers, nodes, sorter=order)]]
        return x

    def name(self, dim: int, tag: int) -> str:
        """Name of a physical group, or else its kind and tag, such as "surface 3"."""
        return self.names.get((dim, tag)) or f"{ENTITIES[dim]} {tag}"

    def physical(self, dim: int) -> dict[int, list[Block]]:
        """Elements of the physical groups of one dimension, by tag in ascending order."""
        found: dict[int, list[Block]] = {}
        for (of, _), tags in self.groups.items():
            if of == dim:
                found |= {tag: [] for tag in tags if tag not in found}
        for block in self.blocks:
            if block.dim == dim:
                for tag in self.groups[dim, block.entity]:
                    found[tag].append(block)
        return dict(sorted(found.items()))


def names(kinds: Iterable[int]) -> str:
    """Names of element types, for messages."""
    known = (KINDS[kind].name if kind in KINDS else f"element type {kind}" for kind in kinds)
    return ", ".join(known) or "no elements"


def stacked(arrays: Iterable[Array], *shape: int) -> Array:
    """Concatenate arrays of rows as 64-bit integers; without arrays the result is empty."""
    rows = [np.asarray(a, dtype=np.int64).reshape(-1, *shape) for a in arrays]
    return np.concatenate(rows) if rows else np.empty((0, *shape), dtype=np.int64)
