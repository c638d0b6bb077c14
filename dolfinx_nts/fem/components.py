"""Nodal vectors: as many components as the space has, and positions, which have three.

Positions have three coordinates, as DOLFINx has them, in the plane the third is zero. So have the
normals, forces and gradients of contact. Displacements, residuals and linear systems have the
components of the space.
"""

from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.fem.axisymmetry import hoop_gradient, is_axisymmetric

__all__ = [
    "deformation_gradient",
    "dimension",
    "gradient",
    "in_space",
    "moments",
    "nodal",
    "possible_motions",
    "resultants",
    "total_moment",
]


def dimension(V: fem.FunctionSpace) -> int:
    """Components of the displacement at a node, 2 or 3. Local."""
    return int(V.dofmap.index_map_bs)


def nodal(function: fem.Function) -> Floats:
    """Values at the local nodes, a view of shape ``(l, 2)`` or ``(l, 3)``. Local."""
    values: Floats = function.x.array.reshape(-1, function.x.block_size)
    return values


def in_space(vectors: Floats) -> Floats:
    """Vectors, shape ``(..., 2)`` or ``(..., 3)``, with three components. Local.

    Those that have three already are returned as they are.
    """
    if vectors.shape[-1] == 3:
        return vectors
    padded: Floats = np.zeros((*vectors.shape[:-1], 3))
    padded[..., :2] = vectors
    return padded


def resultants(vectors: Floats, V: fem.FunctionSpace) -> Floats:
    """Components of resultants, momenta and centres, ``(..., 3)``, that exist in a space. Local.

    Returns:
        A view, shape ``(..., 3)``; in the plane ``(..., 2)``; of rings ``(..., 1)``, along y.
    """
    if is_axisymmetric(V.mesh):
        return vectors[..., 1:2]
    return vectors[..., : dimension(V)]


def moments(vectors: Floats, V: fem.FunctionSpace) -> Floats:
    """Components of moments, ``(..., 3)``, that exist in a space. Local.

    Returns:
        A view, shape ``(..., 3)``; in the plane ``(..., 1)``, about z; of rings ``(..., 0)``.
    """
    if is_axisymmetric(V.mesh):
        return vectors[..., 3:]
    return vectors[..., 2:] if dimension(V) == 2 else vectors


def possible_motions(V: fem.FunctionSpace) -> Flags:
    """Which translations and rotations leave bodies in a space as they are, ``(k,)``. Local.

    Translations in x, y, z and rotations about these axes, in the plane in x, y and about z: all
    of them do, but of rings that along y alone.
    """
    if is_axisymmetric(V.mesh):
        return np.array([False, True, False])
    return np.ones({2: 3, 3: 6}[dimension(V)], dtype=bool)


def total_moment(x: Floats, vectors: Floats) -> Floats:
    """Sum of x times vectors, the cross product, both ``(n, 3)``, shape ``(3,)``. Local."""
    m = x.T @ vectors
    return np.array([m[1, 2] - m[2, 1], m[2, 0] - m[0, 2], m[0, 1] - m[1, 0]])


def gradient(v: Any, *, on_axis: bool = False) -> Any:
    """Gradient of a vector field, UFL (3, 3).

    In the plane nothing changes along z; of rings the last entry is that around the axis.

    Args:
        v: Vector field, UFL.
        on_axis: Whether it is evaluated on the axis of rings too.
    """
    grad = ufl.grad(v)
    if grad.ufl_shape == (3, 3):
        return grad
    hoop = hoop_gradient(v, on_axis=on_axis)
    rows = [[grad[0, 0], grad[0, 1], 0], [grad[1, 0], grad[1, 1], 0], [0, 0, hoop]]
    return ufl.as_matrix(rows)


def deformation_gradient(u: Any, *, on_axis: bool = False) -> Any:
    """Deformation gradient of a displacement, UFL (3, 3); in the plane that of plane strain.

    Arguments are those of `gradient`.
    """
    return ufl.Identity(3) + gradient(u, on_axis=on_axis)
