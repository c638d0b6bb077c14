"""Simple bodies for a gmsh model: boxes, balls, bowls, rings, tori and rectangles.

Their cells are hexahedra or tetrahedra, in the plane quadrilaterals or triangles. Each function
adds one body with named surfaces to a live model, and `read_mesh` makes the mesh of all of them.
Bodies do not share nodes. All functions are local: they are called on the rank that holds the
model.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.meshing.discrete_entities import add_discrete_entity
from dolfinx_nts.meshing.structured_blocks import (
    SIDES,
    Block,
    add_body,
    hexahedra,
    join,
    quadrangles,
)

__all__ = [
    "add_bowl",
    "add_box",
    "add_hollow_ball",
    "add_rectangle",
    "add_ring",
    "add_solid_ball",
    "add_torus",
]

# The cube in the middle of a solid ball: half of its edge relative to the radius [-], and how
# round its faces are, from 0, a cube, to 1, a sphere; chosen for well-shaped cells.
_CORE, _BULGE = 0.5, 0.6
# gmsh's types of lines and of cells of the plane, and these as corners of quadrilaterals.
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
        ValueError: A size or number is not positive, or ``cell`` is unknown.

    Example:
        >>> bar = {"corner": (0, 0, 0), "size": (4, 1, 1), "cells": (8, 2, 2)}
        >>> data = nts.read_mesh(lambda model: parts.add_box(model, "bar", **bar), comm)
        >>> data.cells.values.size
        32
    """
    _check_sizes(size, cells)
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
        ValueError: A size or number is not positive, or ``cell`` is unknown.

    Example:
        >>> bar = {"corner": (0, 0), "size": (4, 1), "cells": (8, 2)}
        >>> data = nts.read_mesh(lambda model: parts.add_rectangle(model, "bar", **bar), comm)
        >>> sorted(data.tag)
        ['bar', 'bar_bottom', 'bar_left', 'bar_right', 'bar_top']
    """
    _check_sizes(size, cells)
    if cell not in _PLANE_CELLS:
        raise ValueError(f"expected cell out of {sorted(_PLANE_CELLS)}, given {cell!r}")
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


def add_hollow_ball(
    model: Any,
    name: str,
    *,
    centre: Sequence[float],
    inner_radius: float,
    outer_radius: float,
    cells_per_edge: int,
    layers: int,
    cell: str = "hexahedron",
) -> None:
    """Add a hollow ball, an equiangular cubed sphere, to a gmsh model. Local.

    The nodes on a face of the cube have parameters a, b in [-1, 1] and lie in the directions
    ``(tan(pi a / 4), tan(pi b / 4), 1)``, evenly spaced in a, b and the radius. The physical
    volume is called ``name``, the physical surfaces ``name_outer`` and ``name_inner``.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        centre: Centre, shape ``(3,)`` [m].
        inner_radius: Radius of the cavity [m].
        outer_radius: Radius of the ball [m].
        cells_per_edge: Number of hexahedra along an edge of the cube.
        layers: Number of hexahedra through the wall.
        cell: ``"hexahedron"``; ``"tetrahedron"`` cuts each of them into six.

    Raises:
        ValueError: A radius or number is out of range, or ``cell`` is unknown.

    Example:
        >>> ball = {"centre": (0, 0, 1), "inner_radius": 0.8, "outer_radius": 1.0}
        >>> ball |= {"cells_per_edge": 4, "layers": 2}
        >>> data = nts.read_mesh(lambda model: parts.add_hollow_ball(model, "ball", **ball), comm)
        >>> sorted(data.tag)
        ['ball', 'ball_inner', 'ball_outer']
    """
    _check_radii(inner_radius, outer_radius)
    _check_cells(cells_per_edge, layers)
    n = cells_per_edge
    lattice = np.moveaxis(np.indices((n + 1, n + 1, n + 1)), 0, -1)
    on_cube = ((lattice == 0) | (lattice == n)).any(axis=-1)
    direction = np.tan(np.pi / 4 * (2 * lattice[on_cube] - n) / n)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radii = np.linspace(inner_radius, outer_radius, layers + 1)
    x = centre + radii[:, None, None] * direction

    ids = np.full(on_cube.shape, -1)
    ids[on_cube] = np.arange(len(direction))
    # Transposed where the two axes of the face and the outward direction would be left-handed.
    faces = (ids[-1], ids[0].T, ids[:, -1].T, ids[:, 0], ids[:, :, -1], ids[:, :, 0].T)
    wall = len(direction) * np.arange(layers + 1)
    cells = np.stack([hexahedra(face[:, :, None] + wall) for face in faces])
    surfaces = {"outer": quadrangles(cells, "top"), "inner": quadrangles(cells, "bottom")}
    add_body(model, name, x, cells, surfaces, cell)


def add_solid_ball(
    model: Any,
    name: str,
    *,
    centre: Sequence[float],
    radius: float,
    cells_per_edge: int,
    layers: int,
    cell: str = "hexahedron",
) -> None:
    """Add a solid ball, a bulged cube inside six shells, to a gmsh model. Local.

    The physical volume is called ``name``, the physical surface ``name_outer``.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        centre: Centre, shape ``(3,)`` [m].
        radius: Radius [m].
        cells_per_edge: Number of hexahedra along an edge of the cube.
        layers: Number of hexahedra through the shells.
        cell: ``"hexahedron"``; ``"tetrahedron"`` cuts each of them into six.

    Raises:
        ValueError: A radius or number is out of range, or ``cell`` is unknown.

    Example:
        >>> ball = {"centre": (0, 0, 1), "radius": 1.0, "cells_per_edge": 3, "layers": 2}
        >>> data = nts.read_mesh(lambda model: parts.add_solid_ball(model, "ball", **ball), comm)
        >>> data.cells.values.size  # 3 x 3 x 3 in the cube, 6 x 3 x 3 x 2 in the shells
        135
    """
    if not radius > 0:
        raise ValueError(f"expected a radius > 0, given {radius}")
    _check_cells(cells_per_edge, layers)
    p = np.tan(np.pi / 4 * np.linspace(-1, 1, cells_per_edge + 1))
    grid = np.stack(np.meshgrid(p, p, p, indexing="ij"), axis=-1)
    largest = np.abs(grid).max(axis=-1, keepdims=True)
    length = np.linalg.norm(grid, axis=-1, keepdims=True)
    part = _BULGE * largest**2
    core = _CORE * grid * (1 - part + part * largest / np.where(length > 0, length, 1.0))
    s = np.linspace(0, 1, layers + 1)[:, None]
    blocks = [Block(core, {})]
    for axis in range(3):
        for layer in (0, -1):
            inner = core.take(layer, axis=axis)[:, :, None]
            shell = inner + s * (inner / np.linalg.norm(inner, axis=-1, keepdims=True) - inner)
            # The first axis turned towards the second must give the outward direction.
            if (axis == 1) != (layer == 0):
                shell = shell.transpose(1, 0, 2, 3)
            blocks.append(Block(shell, {"top": "outer"}))
    blocks = [Block(centre + radius * block.x, block.names) for block in blocks]
    add_body(model, name, *join(blocks), cell)


def add_bowl(
    model: Any,
    name: str,
    *,
    centre: Sequence[float],
    inner_radius: float,
    outer_radius: float,
    cells_per_edge: int,
    layers: int,
    cell: str = "hexahedron",
) -> None:
    """Add a bowl, the lower half of a hollow ball, to a gmsh model. Local.

    The physical volume is called ``name``, the physical surfaces ``name_inner``, ``name_outer``
    and ``name_rim``.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        centre: Centre of the ball, shape ``(3,)`` [m].
        inner_radius: Radius of the inner surface [m].
        outer_radius: Radius of the outer surface [m].
        cells_per_edge: Number of hexahedra along an edge of the whole cube, as for
            `add_hollow_ball`; an even number.
        layers: Number of hexahedra through the wall.
        cell: ``"hexahedron"``; ``"tetrahedron"`` cuts each of them into six.

    Raises:
        ValueError: A radius or number is out of range, or ``cell`` is unknown.

    Example:
        >>> bowl = {"centre": (0, 0, 1), "inner_radius": 0.9, "outer_radius": 1.0}
        >>> bowl |= {"cells_per_edge": 4, "layers": 1}
        >>> data = nts.read_mesh(lambda model: parts.add_bowl(model, "bowl", **bowl), comm)
        >>> sorted(data.tag)
        ['bowl', 'bowl_inner', 'bowl_outer', 'bowl_rim']
    """
    _check_radii(inner_radius, outer_radius)
    _check_cells(cells_per_edge, layers)
    if cells_per_edge % 2:
        raise ValueError(f"expected an even number of cells per edge, given {cells_per_edge}")
    t = np.tan(np.pi / 4 * np.linspace(-1, 1, cells_per_edge + 1))
    a, b = np.meshgrid(t, t, indexing="ij")
    one = np.ones_like(a)
    faces = [np.stack([b, a, -one], axis=-1)]
    for x, y in ((one, a), (-a, one), (-one, -a), (a, -one)):
        faces.append(np.stack([x, y, b], axis=-1)[:, : cells_per_edge // 2 + 1])
    r = np.linspace(inner_radius, outer_radius, layers + 1)[:, None]
    blocks: list[Block] = []
    for face in faces:
        direction = face / np.linalg.norm(face, axis=-1, keepdims=True)
        names = {"bottom": "inner", "top": "outer"} | ({"back": "rim"} if blocks else {})
        blocks.append(Block(centre + r * direction[:, :, None], names))
    add_body(model, name, *join(blocks), cell)


def add_ring(
    model: Any,
    name: str,
    *,
    centre: Sequence[float],
    inner_radius: float,
    outer_radius: float,
    width: float,
    cells: Sequence[int],
    axis: Sequence[float] = (0.0, 0.0, 1.0),
    cell: str = "hexahedron",
) -> None:
    """Add a ring, a short tube, to a gmsh model. Local.

    The physical volume is called ``name``, the physical surfaces ``name_inner``,
    ``name_outer``, ``name_bottom``, and ``name_top`` at the end to which the axis points.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        centre: Centre, shape ``(3,)`` [m].
        inner_radius: Radius of the hole [m].
        outer_radius: Radius of the ring [m].
        width: Length along the axis [m].
        cells: Numbers of hexahedra around, through the wall and along the axis, shape ``(3,)``.
        axis: Direction of the axis, of any length, shape ``(3,)``.
        cell: ``"hexahedron"``; ``"tetrahedron"`` cuts each of them into six.

    Raises:
        ValueError: A length or number is out of range, or ``cell`` is unknown.

    Example:
        >>> ring = {"centre": (0, 0, 0), "inner_radius": 0.8, "outer_radius": 1.0}
        >>> ring |= {"width": 0.2, "cells": (24, 2, 2), "axis": (0, 1, 0)}
        >>> data = nts.read_mesh(lambda model: parts.add_ring(model, "ring", **ring), comm)
        >>> sorted(data.tag)
        ['ring', 'ring_bottom', 'ring_inner', 'ring_outer', 'ring_top']
    """
    _check_radii(inner_radius, outer_radius)
    _check_cells(cells[0], least=3)
    _check_cells(*cells)
    if width <= 0:
        raise ValueError(f"expected a width > 0, given {width}")
    r = np.linspace(inner_radius, outer_radius, cells[1] + 1)[:, None, None]
    phi = np.linspace(0, 2 * np.pi, cells[0] + 1)[:, None]
    z = np.linspace(-width / 2, width / 2, cells[2] + 1)
    x = np.stack(np.broadcast_arrays(r * np.cos(phi), r * np.sin(phi), z), axis=-1)
    names = {"left": "inner", "right": "outer", "bottom": "bottom", "top": "top"}
    add_body(model, name, *join([Block(centre + _turned(x, axis), names)]), cell)


def add_torus(
    model: Any,
    name: str,
    *,
    centre: Sequence[float],
    radius: float,
    inner_radius: float,
    outer_radius: float,
    cells: Sequence[int],
    axis: Sequence[float] = (0.0, 0.0, 1.0),
    cell: str = "hexahedron",
) -> None:
    """Add a torus, a hollow tube bent into a closed circle, to a gmsh model. Local.

    The physical volume is called ``name``, the physical surfaces ``name_inner`` and
    ``name_outer``.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        centre: Centre, shape ``(3,)`` [m].
        radius: Radius of the circle in the middle of the tube [m].
        inner_radius: Radius of the cavity of the tube [m].
        outer_radius: Radius of the tube [m].
        cells: Numbers of hexahedra along the circle, around the tube and through its wall,
            shape ``(3,)``.
        axis: Direction of the axis, of any length, shape ``(3,)``.
        cell: ``"hexahedron"``; ``"tetrahedron"`` cuts each of them into six.

    Raises:
        ValueError: A radius or number is out of range, or ``cell`` is unknown.

    Example:
        >>> torus = {"centre": (0, 0, 0), "radius": 1.0, "inner_radius": 0.2}
        >>> torus |= {"outer_radius": 0.3, "cells": (16, 8, 1)}
        >>> data = nts.read_mesh(lambda model: parts.add_torus(model, "torus", **torus), comm)
        >>> sorted(data.tag)
        ['torus', 'torus_inner', 'torus_outer']
    """
    _check_radii(inner_radius, outer_radius)
    if not radius > outer_radius:
        raise ValueError(f"expected radius > outer radius, given {radius}, {outer_radius}")
    _check_cells(*cells[:2], least=3)
    _check_cells(cells[2])
    phi = np.linspace(0, 2 * np.pi, cells[0] + 1)[:, None, None]
    theta = np.linspace(0, 2 * np.pi, cells[1] + 1)[:, None]
    r = np.linspace(inner_radius, outer_radius, cells[2] + 1)
    away = radius + r * np.cos(theta)
    grid = np.broadcast_arrays(away * np.cos(phi), away * np.sin(phi), r * np.sin(theta))
    names = {"bottom": "inner", "top": "outer"}
    x = centre + _turned(np.stack(grid, axis=-1), axis)
    add_body(model, name, *join([Block(x, names)]), cell)


def _turned(x: Floats, axis: Sequence[float]) -> Floats:
    """Turn positions, shape (..., 3), by a rotation from the z axis to another axis."""
    length = float(np.linalg.norm(axis))
    if not (np.isfinite(length) and length > 0):
        raise ValueError(f"expected an axis of length > 0, given {axis}")
    # The smallest rotation. An axis that points down is first turned up by half a turn about x,
    # and the result is turned back, as the formula is singular at -z.
    flip = np.array([1, -1, -1]) if axis[2] < 0 else np.ones(3)
    a, b, c = np.asarray(axis) / length * flip
    K = np.array([[0, 0, a], [0, 0, b], [-a, -b, 0]])
    Q = np.eye(3) + K + K @ K / (1 + c)
    return np.asarray(x @ Q.T * flip)


def _check_sizes(size: Sequence[float], cells: Sequence[int]) -> None:
    if min(size) <= 0 or min(cells) < 1:
        raise ValueError(f"expected positive size and cells, given {size} and {cells}")


def _check_radii(inner: float, outer: float) -> None:
    if not 0 < inner < outer:
        raise ValueError(f"expected 0 < inner < outer radius, given {inner}, {outer}")


def _check_cells(*numbers: int, least: int = 1) -> None:
    if min(numbers) < least:
        raise ValueError(f"expected at least {least} cells, given {numbers}")
