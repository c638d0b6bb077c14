"""Rings and tori, of any axis, for a gmsh model. Local."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.meshing.sizes import check_cells, check_radii
from dolfinx_nts.meshing.structured_blocks import Block, add_body, join

__all__ = ["add_ring", "add_torus"]


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
    check_radii(inner_radius, outer_radius)
    check_cells(cells[0], least=3)
    check_cells(*cells)
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
    check_radii(inner_radius, outer_radius)
    if not radius > outer_radius:
        raise ValueError(f"expected radius > outer radius, given {radius}, {outer_radius}")
    check_cells(*cells[:2], least=3)
    check_cells(cells[2])
    phi = np.linspace(0, 2 * np.pi, cells[0] + 1)[:, None, None]
    theta = np.linspace(0, 2 * np.pi, cells[1] + 1)[:, None]
    r = np.linspace(inner_radius, outer_radius, cells[2] + 1)
    away = radius + r * np.cos(theta)
    grid = np.broadcast_arrays(away * np.cos(phi), away * np.sin(phi), r * np.sin(theta))
    names = {"bottom": "inner", "top": "outer"}
    x = centre + _turned(np.stack(grid, axis=-1), axis)
    add_body(model, name, *join([Block(x, names)]), cell)


def _turned(x: Floats, axis: Sequence[float]) -> Floats:
    """Rotate positions, shape (..., 3), by the rotation from the z axis to another axis."""
    length = float(np.linalg.norm(axis))
    if not (np.isfinite(length) and length > 0):
        raise ValueError(f"expected an axis of length > 0, given {axis}")
    # This is the smallest rotation. Its formula is singular at -z: an axis that points down is
    # first rotated by 180 degrees about x, and the result is rotated back.
    flip = np.array([1, -1, -1]) if axis[2] < 0 else np.ones(3)
    a, b, c = np.asarray(axis) / length * flip
    K = np.array([[0, 0, a], [0, 0, b], [-a, -b, 0]])
    Q = np.eye(3) + K + K @ K / (1 + c)
    return np.asarray(x @ Q.T * flip)
