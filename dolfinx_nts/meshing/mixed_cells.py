"""Division of mixed cells into cells of one type, as DOLFINx has no spaces on mixed meshes.

Cells are cut at the midpoints of their edges and the centres of their faces: a tetrahedron
becomes four hexahedra, a prism six, a hexahedron eight; in the plane, a triangle becomes three
quadrilaterals, a quadrilateral four. Adjacent cells of any kind share their nodes also after the
division, and volumes do not change.
"""

import logging
from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import GlobalInts
from dolfinx_nts.meshing.elements import KINDS, Block, Elements

__all__ = ["only_one_kind"]

_logger = logging.getLogger("dolfinx_nts")

_LINE, _TRIANGLE, _QUADRILATERAL, _TETRAHEDRON, _HEXAHEDRON, _PRISM = 1, 2, 3, 4, 5, 6

# For each corner of an element, the corners connected to it by edges: anticlockwise in the plane,
# in right-handed order in space.
_NEIGHBOURS = {
    _LINE: ((1,), (0,)),
    _TRIANGLE: ((1, 2), (2, 0), (0, 1)),
    _QUADRILATERAL: ((1, 3), (2, 0), (3, 1), (0, 2)),
    _TETRAHEDRON: ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)),
    _PRISM: ((1, 2, 3), (2, 0, 4), (0, 1, 5), (5, 4, 0), (3, 5, 1), (4, 3, 2)),
    _HEXAHEDRON: (
        *((1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7)),
        *((7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)),
    ),
}
_FACES = {
    _LINE: (),
    _TRIANGLE: ((0, 1, 2),),
    _QUADRILATERAL: ((0, 1, 2, 3),),
    _TETRAHEDRON: ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)),
    _PRISM: ((0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    _HEXAHEDRON: (
        *((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4)),
        *((1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    ),
}
_INTO = {1: _LINE, 2: _QUADRILATERAL, 3: _HEXAHEDRON}  # pieces by dimension
_CUT = {2: {_TRIANGLE, _QUADRILATERAL}, 3: {_TETRAHEDRON, _HEXAHEDRON, _PRISM}}
_NAMES = {2: "quadrilaterals", 3: "hexahedra"}


class _Pieces(NamedTuple):
    """Division of an element into pieces, one at each vertex.

    Attributes:
        shared: Corners of the edges and faces that get a node at the midpoint, shared with adjacent
            cells; rows of four, padded with -1.
        nodes: Nodes of the pieces, numbered: corners, then the nodes of `shared`, then the node at
            the centre of a cell.
    """

    shared: GlobalInts
    nodes: GlobalInts


def _pieces(kind: int) -> _Pieces:
    """Divide an element of a type into pieces."""
    neighbours, faces = _NEIGHBOURS[kind], _FACES[kind]
    edges = sorted({tuple(sorted((i, j))) for i, others in enumerate(neighbours) for j in others})
    shared = [*edges, *faces]
    number = {frozenset(corners): len(neighbours) + i for i, corners in enumerate(shared)}
    centre = len(neighbours) + len(shared)
    nodes = []
    for corner, others in enumerate(neighbours):
        middles = [number[frozenset((corner, other))] for other in others]
        if len(others) == 1:
            nodes.append([corner, *middles][:: 1 if corner == 0 else -1])
            continue
        around = zip(others, (*others[1:], others[0]), strict=True)
        within = [
            next(number[frozenset(face)] for face in faces if {corner, *pair} <= set(face))
            for pair in around
        ]
        piece = [corner, middles[0], within[0], middles[1]]
        if len(others) == 3:
            piece += [middles[2], within[2], centre, within[1]]
        nodes.append(piece)
    filled = [[*corners, *[-1] * (4 - len(corners))] for corners in shared]
    return _Pieces(np.array(filled), np.array(nodes))


_PIECES = {kind: _pieces(kind) for kind in _NEIGHBOURS}


def only_one_kind(mesh: Elements, dim: int) -> Elements:
    """Cut cells that are prisms or of several kinds, and their facets. Local.

    A warning is logged. Pyramids and cells of higher order are returned unchanged, and refused by
    `bodies_of`.

    Args:
        mesh: The elements.
        dim: Dimension of the cells, 2 or 3.

    Returns:
        The same elements, or pieces of one kind, which have the numbers of the elements that
        they are cut from.
    """
    kinds = mesh.kinds(dim)
    if (len(kinds) < 2 and _PRISM not in kinds) or not _CUT[dim].issuperset(kinds):
        return mesh
    blocks = [block for block in mesh.blocks if block.dim >= dim - 1 and block.kind in _PIECES]
    rest = [block for block in mesh.blocks if block.dim >= dim - 1 and block.kind not in _PIECES]

    # Edges and faces by their sorted corners, padded with leading -1.
    corners = [
        np.sort(np.where(shared < 0, -1, block.nodes[:, shared]), axis=2)
        for block in blocks
        for shared in [_PIECES[block.kind].shared]
    ]
    found, inverse = np.unique(
        np.concatenate([c.reshape(-1, 4) for c in corners]), axis=0, return_inverse=True
    )
    used = found >= 0
    of_corners = mesh.positions(np.where(used, found, found[:, -1:]))
    x = [mesh.x, np.einsum("ij,ijk->ik", used, of_corners) / used.sum(axis=1)[:, None]]
    first = mesh.numbers.max() + 1
    middle, centre, begin = first + inverse.ravel(), first + len(found), 0
    pieces = []
    for block, shared in zip(blocks, corners, strict=True):
        size, rows = len(block.nodes), shared.shape[0] * shared.shape[1]
        nodes = [block.nodes, middle[begin : begin + rows].reshape(size, -1)]
        begin += rows
        if block.dim == 3:
            nodes.append(centre + np.arange(size)[:, None])
            x.append(mesh.positions(block.nodes).mean(axis=1))
            centre += size
        cut = np.hstack(nodes)[:, _PIECES[block.kind].nodes]
        cut = cut.reshape(-1, cut.shape[-1])
        numbers = np.repeat(block.numbers, len(cut) // max(size, 1))
        pieces.append(Block(block.dim, block.entity, _INTO[block.dim], numbers, cut))
    numbers = np.concatenate([mesh.numbers, np.arange(first, centre)])
    blocks = sorted([*pieces, *rest], key=lambda block: block[:2])
    result = mesh._replace(numbers=numbers, x=np.concatenate(x), blocks=tuple(blocks))
    _logger.warning(
        "DOLFINx has spaces on cells of one kind, without prisms: %s are cut into %d "
        "%s. New nodes lie in the middle of edges: round surfaces keep the kinks of their former "
        "facets, where contact pressures are too large. If round surfaces touch, mesh all bodies "
        "with cells of one kind",
        ", ".join(f"{count} {KINDS[kind].name}" for kind, count in kinds.items()),
        result.kinds(dim)[_INTO[dim]],
        _NAMES[dim],
    )
    return result
