"""Blocks of hexahedra, from which the bodies of `parts` are built.

A block is a grid of nodes. Blocks are joined where their nodes coincide and become discrete
entities of a gmsh model, as hexahedra or cut into tetrahedra. Everything is local.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Floats, GlobalInts
from dolfinx_nts.meshing.discrete_entities import add_discrete_entity

__all__ = ["SIDES", "Block", "add_body", "hexahedra", "join", "quadrangles"]

_CELLS = {"tetrahedron": (4, 2), "hexahedron": (5, 3)}  # gmsh's types of cells and facets
# Corners of gmsh's hexahedron in its own order, on the unit cube.
_CORNERS = np.array([(*ij, k) for k in (0, 1) for ij in ((0, 0), (1, 0), (1, 1), (0, 1))])
# Sides of a block of hexahedra, shape (nx, ny, nz, 8): axis across the side, layer of hexahedra
# along it, and their corners on the side, anticlockwise from outside.
SIDES = {
    "left": (-4, 0, (3, 0, 4, 7)),
    "right": (-4, -1, (1, 2, 6, 5)),
    "front": (-3, 0, (0, 1, 5, 4)),
    "back": (-3, -1, (2, 3, 7, 6)),
    "bottom": (-2, 0, (0, 3, 2, 1)),
    "top": (-2, -1, (4, 5, 6, 7)),
}

# Distance of two nodes, relative to the size of the body [-], below which they coincide: far larger
# than round-off, and far smaller than cells.
_SAME = 1e-8
# Shift of coordinates before they are rounded to multiples of that distance [-]: frequent
# coordinates, such as 1/2, must not be halfway between two multiples.
_SHIFT = 0.377


class Block(NamedTuple):
    """A grid of nodes, whose axes are right-handed.

    Attributes:
        x: Positions, shape ``(nx + 1, ny + 1, nz + 1, 3)`` [m].
        names: Name of the surface of each side, by the names in `SIDES`; sides without a surface
            are left out.
    """

    x: Floats
    names: Mapping[str, str]


def hexahedra(ids: GlobalInts) -> GlobalInts:
    """Connect a grid of nodes to hexahedra.

    Args:
        ids: Numbers of the nodes, shape ``(nx + 1, ny + 1, nz + 1)``.

    Returns:
        Nodes of each hexahedron in gmsh's order, shape ``(nx, ny, nz, 8)``.
    """
    nx, ny, nz = np.subtract(ids.shape, 1)
    i, j, k = np.indices((nx, ny, nz))[..., None] + _CORNERS.T[:, None, None, None]
    return np.asarray(ids[i, j, k])


def quadrangles(cells: GlobalInts, side: str) -> GlobalInts:
    """Quadrilaterals on one side of blocks of hexahedra.

    Args:
        cells: Nodes of the hexahedra, shape ``(..., nx, ny, nz, 8)``.
        side: Name out of `SIDES`.

    Returns:
        Nodes, anticlockwise from outside, shape ``(..., 4)``.
    """
    axis, layer, corners = SIDES[side]
    return cells.take([layer], axis=axis)[..., corners]


def join(blocks: Sequence[Block]) -> tuple[Floats, GlobalInts, dict[str, GlobalInts]]:
    """Join blocks where their nodes coincide, also two sides of one block.

    Args:
        blocks: The blocks.

    Returns:
        Positions of the nodes in the order of the blocks, shape ``(n, 3)`` [m]; hexahedra,
        shape ``(c, 8)``; and quadrilaterals by name of the surface, shape ``(f, 4)``.
    """
    cells, first = [], 0
    for block in blocks:
        size = block.x[..., 0].size
        cells.append(hexahedra(first + np.arange(size).reshape(block.x.shape[:3])))
        first += size
    surfaces: dict[str, list[GlobalInts]] = {}
    for block, grid in zip(blocks, cells, strict=True):
        for side, name in block.names.items():
            surfaces.setdefault(name, []).append(quadrangles(grid, side).reshape(-1, 4))

    x = np.concatenate([block.x.reshape(-1, 3) for block in blocks])
    cubes = np.round((x - x.min(axis=0)) / (_SAME * np.ptp(x)) + _SHIFT).astype(np.int64)
    _, first_of, same = np.unique(cubes, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first_of)
    number = np.argsort(order)[same.ravel()]
    together = number[np.concatenate([grid.reshape(-1, 8) for grid in cells])]
    return x[first_of[order]], together, {k: number[np.concatenate(v)] for k, v in surfaces.items()}


def add_body(
    model: Any,
    name: str,
    x: Floats,
    cells: GlobalInts,
    surfaces: Mapping[str, GlobalInts],
    cell: str,
) -> None:
    """Add a body with named surfaces to a gmsh model, as discrete entities.

    Args:
        model: Live gmsh model.
        name: Name of the physical volume. The physical surface of ``top`` is called ``name_top``.
        x: Positions of the nodes, shape ``(n, 3)`` [m].
        cells: Nodes of the hexahedra, shape ``(..., 8)``.
        surfaces: Nodes of quadrilaterals by name, shape ``(..., 4)``.
        cell: ``"hexahedron"``; ``"tetrahedron"`` cuts each into six.

    Raises:
        ValueError: ``cell`` is unknown.
    """
    if cell not in _CELLS:
        raise ValueError(f"expected cell to be one of {sorted(_CELLS)}, given {cell!r}")
    volume_type, surface_type = _CELLS[cell]
    split = cell == "tetrahedron"
    first = int(model.mesh.getMaxNodeTag()) + 1
    entities = [add_discrete_entity(model, 2) for _ in surfaces]
    volume = add_discrete_entity(model, 3, entities)
    model.mesh.addNodes(3, volume, first + np.arange(x.size // 3), x.ravel())
    cells = first + (_tetrahedra(cells.reshape(-1, 8)) if split else cells)
    model.mesh.addElementsByType(volume, volume_type, [], cells.ravel())
    model.addPhysicalGroup(3, [volume], name=name)
    for entity, (side, facets) in zip(entities, surfaces.items(), strict=True):
        facets = first + (_triangles(facets) if split else facets)
        model.mesh.addElementsByType(entity, surface_type, [], facets.ravel())
        model.addPhysicalGroup(2, [entity], name=f"{name}_{side}")


def _triangles(facets: GlobalInts) -> GlobalInts:
    """Cut quadrilaterals into triangles from their lowest node, so that neighbours match."""
    turned = (facets.argmin(axis=-1)[..., None] + np.arange(4)) % 4
    return np.take_along_axis(facets, turned, axis=-1)[..., [[0, 1, 2], [0, 2, 3]]]


def _tetrahedra(cells: GlobalInts) -> GlobalInts:
    """Cut hexahedra into six tetrahedra from their lowest node, so that neighbours match."""
    sides = cells[:, [corners for *_, corners in SIDES.values()]]
    lowest = cells.min(axis=1)
    opposite = (sides != lowest[:, None, None]).all(axis=2)  # three of the six tetrahedra
    triangles = _triangles(sides[opposite]).reshape(-1, 3)
    return np.column_stack((np.repeat(lowest, 6), triangles))
