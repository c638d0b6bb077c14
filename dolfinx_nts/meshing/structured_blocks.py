"""Blocks of hexahedra: what the bodies of `parts` are made of.

A block is a grid of nodes. Blocks are joined where their nodes coincide
and become discrete entities of a gmsh model, as hexahedra or cut into
tetrahedra.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Floats, GlobalInts

__all__ = ["SIDES", "Block", "add_body", "hexahedra", "join", "quadrangles"]


_CELLS = {"tetrahedron": (4, 2), "hexahedron": (5, 3)}  # gmsh types of cells and facets

# Corners of the gmsh hexahedron, and its sides: axis of a block of
# hexahedra (nx, ny, nz, 8), layer, corners anticlockwise from outside.
_CORNERS = np.array([(*ij, k) for k in (0, 1) for ij in ((0, 0), (1, 0), (1, 1), (0, 1))])
SIDES = {
    "left": (-4, 0, (3, 0, 4, 7)),
    "right": (-4, -1, (1, 2, 6, 5)),
    "front": (-3, 0, (0, 1, 5, 4)),
    "back": (-3, -1, (2, 3, 7, 6)),
    "bottom": (-2, 0, (0, 3, 2, 1)),
    "top": (-2, -1, (4, 5, 6, 7)),
}

# Nodes are the same if they agree to this part of the size of the body.
_SAME = 1e-8
# No coordinate that a shape has by design, such as 1/2, may lie where
# rounding to multiples of it is ambiguous.
_SHIFT = 0.377


class Block(NamedTuple):
    """Grid of nodes whose axes are right-handed.

    Attributes:
        x: Nodes, shape ``(nx + 1, ny + 1, nz + 1, 3)`` [m].
        names: Names of surfaces by side out of `SIDES`.
    """

    x: Floats
    names: Mapping[str, str]


def hexahedra(ids: GlobalInts) -> GlobalInts:
    """Connect a grid of nodes (nx + 1, ...) to hexahedra (nx, ..., 8)."""
    nx, ny, nz = np.subtract(ids.shape, 1)
    i, j, k = np.indices((nx, ny, nz))[..., None] + _CORNERS.T[:, None, None, None]
    return np.asarray(ids[i, j, k])


def quadrangles(cells: GlobalInts, side: str) -> GlobalInts:
    """Quadrangles on one side of blocks of hexahedra."""
    axis, layer, corners = SIDES[side]
    return cells.take([layer], axis=axis)[..., corners]


def join(blocks: Sequence[Block]) -> tuple[Floats, GlobalInts, dict[str, GlobalInts]]:
    """Join blocks, also the ends of one, where their nodes coincide.

    Returns:
        Nodes ``(n, 3)`` [m] in the order of the blocks, hexahedra
        ``(c, 8)``, and quadrangles ``(f, 4)`` by name of the surface.
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
    _, kept, same = np.unique(cubes, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(kept)
    number = np.argsort(order)[same.ravel()]
    together = number[np.concatenate([grid.reshape(-1, 8) for grid in cells])]
    return x[kept[order]], together, {k: number[np.concatenate(v)] for k, v in surfaces.items()}


def add_body(
    model: Any,
    name: str,
    x: Floats,
    cells: GlobalInts,
    surfaces: Mapping[str, GlobalInts],
    cell: str,
) -> None:
    """Add nodes, cells and named surfaces as discrete gmsh entities. Local.

    Args:
        model: Live gmsh model.
        name: Name of the volume; a surface is called ``name_surface``.
        x: Nodes, shape ``(n, 3)`` [m].
        cells: Hexahedra, shape ``(..., 8)``.
        surfaces: Quadrangles by name, shape ``(..., 4)``.
        cell: ``"hexahedron"`` or ``"tetrahedron"``.

    Raises:
        ValueError: Unknown ``cell``.
    """
    if cell not in _CELLS:
        raise ValueError(f"expected cell out of {sorted(_CELLS)}, given {cell!r}")
    volume_type, surface_type = _CELLS[cell]
    split = cell == "tetrahedron"
    first = int(model.mesh.getMaxNodeTag()) + 1
    entities = [model.addDiscreteEntity(2) for _ in surfaces]
    volume = model.addDiscreteEntity(3, boundary=entities)
    model.mesh.addNodes(3, volume, first + np.arange(x.size // 3), x.ravel())
    cells = first + (_tetrahedra(cells.reshape(-1, 8)) if split else cells)
    model.mesh.addElementsByType(volume, volume_type, [], cells.ravel())
    model.addPhysicalGroup(3, [volume], name=name)
    for entity, (side, facets) in zip(entities, surfaces.items(), strict=True):
        facets = first + (_triangles(facets) if split else facets)
        model.mesh.addElementsByType(entity, surface_type, [], facets.ravel())
        model.addPhysicalGroup(2, [entity], name=f"{name}_{side}")


def _triangles(facets: GlobalInts) -> GlobalInts:
    """Cut quadrangles from their lowest node, so that neighbours agree."""
    turned = (facets.argmin(axis=-1)[..., None] + np.arange(4)) % 4
    return np.take_along_axis(facets, turned, axis=-1)[..., [[0, 1, 2], [0, 2, 3]]]


def _tetrahedra(cells: GlobalInts) -> GlobalInts:
    """Cut hexahedra into six from their lowest node: conforming."""
    sides = cells[:, [corners for *_, corners in SIDES.values()]]
    lowest = cells.min(axis=1)
    opposite = (sides != lowest[:, None, None]).all(axis=2)  # three of the six sides
    triangles = _triangles(sides[opposite]).reshape(-1, 3)
    return np.column_stack((np.repeat(lowest, 6), triangles))
