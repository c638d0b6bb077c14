"""Hollow and solid balls, and bowls, for a gmsh model. Local."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_nts.meshing.sizes import check_cells, check_radii
from dolfinx_nts.meshing.structured_blocks import (
    Block,
    add_body,
    hexahedra,
    join,
    quadrangles,
)

__all__ = ["add_bowl", "add_hollow_ball", "add_solid_ball"]

# Core of a solid ball, a cube with bulged faces: half of its edge relative to the radius [-], and
# roundness of its faces [-], from 0, a cube, to 1, a sphere. Chosen for well-shaped cells.
_CORE, _BULGE = 0.5, 0.6


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
    check_radii(inner_radius, outer_radius)
    check_cells(cells_per_edge, layers)
    n = cells_per_edge
    lattice = np.moveaxis(np.indices((n + 1, n + 1, n + 1)), 0, -1)
    on_cube = ((lattice == 0) | (lattice == n)).any(axis=-1)
    direction = np.tan(np.pi / 4 * (2 * lattice[on_cube] - n) / n)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radii = np.linspace(inner_radius, outer_radius, layers + 1)
    x = centre + radii[:, None, None] * direction

    ids = np.full(on_cube.shape, -1)
    ids[on_cube] = np.arange(len(direction))
    # Transposed if the two axes of the face and the outward direction are left-handed.
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
    check_cells(cells_per_edge, layers)
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
            # The rotation from the first to the second axis must be about the outward direction.
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
    check_radii(inner_radius, outer_radius)
    check_cells(cells_per_edge, layers)
    if cells_per_edge % 2:
        raise ValueError(
            f"expected an even number of cells per edge of a bowl, given {cells_per_edge}"
        )
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
