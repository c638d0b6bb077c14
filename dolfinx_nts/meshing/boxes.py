"""Boxes, also bars and plates, and rectangles of the plane for a gmsh model. Local."""

from collections.abc import Sequence
from numbers import Integral
from typing import Any

import numpy as np

from dolfinx_nts.meshing.discrete_entities import add_discrete_entity
from dolfinx_nts.meshing.structured_blocks import SIDES, add_body, hexahedra, quadrangles

__all__ = ["add_box", "add_rectangle"]

# gmsh's types of lines and plane cells; corners of a quadrilateral that form each plane cell.
_LINE = 1
_PLANE_CELLS = {"triangle": (2, [[0, 1, 2], [0, 2, 3]]), "quadrilateral": (3, [[0, 1, 2, 3]])}


def add_box(
    model: Any,
    name: str,
    *,
    corner: Sequence[float],
    size: Sequence[float],
    cells: Sequence[int],
    cell: str = "hexahedron",
) -> None:
    """Add a box, a bar or a plate of equal cells to a gmsh model. Local.

    The physical volume is called ``name``. The physical surfaces are ``name_left`` and
    ``name_right`` at the lowest and highest x, ``name_front`` and ``name_back`` for y,
    ``name_bottom`` and ``name_top`` for z.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        corner: Corner with the lowest coordinates, shape ``(3,)`` [m].
        size: Lengths of the edges, shape ``(3,)`` [m].
        cells: Numbers of hexahedra along the edges, shape ``(3,)``.
        cell: ``"hexahedron"``; ``"tetrahedron"`` cuts each of them into six.

    Raises:
        TypeError: A number of cells is not an integer.
        ValueError: A size or number is not positive, or ``cell`` is unknown.

    Example:
        >>> bar = {"corner": (0, 0, 0), "size": (4, 1, 1), "cells": (8, 2, 2)}
        >>> data = nts.read_mesh(lambda model: parts.add_box(model, "bar", **bar), comm)
        >>> data.cells.values.size
        32
    """
    _check_sizes(3, corner=corner, size=size, cells=cells)
    ids = np.arange(np.prod(np.add(cells, 1))).reshape(np.add(cells, 1))
    x = corner + np.argwhere(ids >= 0) / cells * size
    grid = hexahedra(ids)
    add_body(model, name, x, grid, {side: quadrangles(grid, side) for side in SIDES}, cell)


def add_rectangle(
    model: Any,
    name: str,
    *,
    corner: Sequence[float],
    size: Sequence[float],
    cells: Sequence[int],
    cell: str = "quadrilateral",
) -> None:
    """Add a rectangle of equal cells to a gmsh model of the plane z = 0. Local.

    The physical surface is called ``name``. The physical curves are ``name_left`` and
    ``name_right`` at the lowest and highest x, ``name_bottom`` and ``name_top`` for y.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        corner: Corner with the lowest coordinates, shape ``(2,)`` [m].
        size: Lengths of the edges, shape ``(2,)`` [m].
        cells: Numbers of quadrilaterals along the edges, shape ``(2,)``.
        cell: ``"quadrilateral"``; ``"triangle"`` cuts each of them into two.

    Raises:
        TypeError: A number of cells is not an integer.
        ValueError: A size or number is not positive, or ``cell`` is unknown.

    Example:
        >>> bar = {"corner": (0, 0), "size": (4, 1), "cells": (8, 2)}
        >>> data = nts.read_mesh(lambda model: parts.add_rectangle(model, "bar", **bar), comm)
        >>> sorted(data.tag)
        ['bar', 'bar_bottom', 'bar_left', 'bar_right', 'bar_top']
    """
    _check_sizes(2, corner=corner, size=size, cells=cells)
    if cell not in _PLANE_CELLS:
        raise ValueError(f"expected cell to be one of {sorted(_PLANE_CELLS)}, given {cell!r}")
    kind, corners = _PLANE_CELLS[cell]
    first = int(model.mesh.getMaxNodeTag()) + 1
    ids = first + np.arange(np.prod(np.add(cells, 1))).reshape(np.add(cells, 1))
    x = np.zeros((ids.size, 3))
    x[:, :2] = corner + np.argwhere(ids) / cells * size
    quads = np.stack([ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]], axis=-1)
    sides = {"left": ids[0], "right": ids[-1], "bottom": ids[:, 0], "top": ids[:, -1]}
    curves = [add_discrete_entity(model, 1) for _ in sides]
    surface = add_discrete_entity(model, 2, curves)
    model.mesh.addNodes(2, surface, ids.ravel(), x.ravel())
    model.mesh.addElementsByType(surface, kind, [], quads[..., corners].ravel())
    model.addPhysicalGroup(2, [surface], name=name)
    for curve, (side, nodes) in zip(curves, sides.items(), strict=True):
        lines = np.stack([nodes[:-1], nodes[1:]], axis=-1)
        model.mesh.addElementsByType(curve, _LINE, [], lines.ravel())
        model.addPhysicalGroup(1, [curve], name=f"{name}_{side}")


def _check_sizes(dim: int, corner: Any, size: Any, cells: Any) -> None:
    for name, given in {"corner": corner, "size": size, "cells": cells}.items():
        if np.shape(given) != (dim,):
            raise ValueError(f"expected {dim} numbers for {name}, given {given!r}")
    if not all(isinstance(number, Integral) for number in cells):
        raise TypeError(f"expected integers as numbers of cells, given {cells}")
    if min(size) <= 0 or min(cells) < 1:
        raise ValueError(f"expected positive size and cells, given {size} and {cells}")
