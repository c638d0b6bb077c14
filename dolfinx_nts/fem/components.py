"""Nodal vectors: as many components as the space has, and positions, which have three.

Positions have three coordinates, as DOLFINx has them, in the plane the third is zero. So have the
normals, forces and gradients of contact. Displacements, residuals and linear systems have the
components of the space.
"""

from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints
from dolfinx_nts.fem.axisymmetry import hoop_gradient, is_axisymmetric

__all__ = [
    "bounds",
    "deformation_gradient",
    "dimension",
    "existing",
    "gradient",
    "in_space",
    "moments",
    "motion_sums",
    "nodal",
    "of_space",
    "possible_motions",
    "resultants",
]


def dimension(V: fem.FunctionSpace) -> int:
    """Components of the displacement at a node, 2 or 3. Local."""
    return int(V.dofmap.index_map_bs)


def nodal(function: fem.Function) -> Floats:
    """Values at the local nodes, a view of shape ``(l, 2)`` or ``(l, 3)``. Local."""
    vector = function.x
    values: Floats = vector.array.reshape(-1, vector.block_size)
    return values


def in_space(vectors: Floats) -> Floats:
    """Vectors, shape ``(..., 2)`` or ``(..., 3)``, with three components. Local.

    Those that have three already are returned as they are.
    """
    if vectors.shape[-1] == 3:
        return vectors
    # NumPy takes five times as long for copies of rows that are so short.
    padded: Floats = _kernels.change_components(vectors.reshape(-1, 2))
    return padded.reshape(*vectors.shape[:-1], 3)


def of_space(vectors: Floats, dim: int) -> Floats:
    """The components of vectors, shape ``(n, 3)``, that a space of 2 or 3 has, ``(n, d)``. Local.

    Those of a space of 3 are returned as they are.
    """
    return vectors if dim == 3 else _kernels.change_components(vectors)


def resultants(vectors: Floats, V: fem.FunctionSpace) -> Floats:
    """Components of resultants, momenta and centres, ``(..., 3)``, that exist in a space. Local.

    Returns:
        A view, shape ``(..., 3)``; in the plane ``(..., 2)``; of rings ``(..., 1)``, along y.
    """
    return vectors[..., existing(V)[0]]


def moments(vectors: Floats, V: fem.FunctionSpace) -> Floats:
    """Components of moments, ``(..., 3)``, that exist in a space. Local.

    Returns:
        A view, shape ``(..., 3)``; in the plane ``(..., 1)``, about z; of rings ``(..., 0)``.
    """
    return vectors[..., existing(V)[1]]


def existing(V: fem.FunctionSpace) -> tuple[slice, slice]:
    """Which components of `resultants` and of `moments` exist in a space. Local."""
    if is_axisymmetric(V.mesh):
        return slice(1, 2), slice(3, None)
    return (slice(2), slice(2, None)) if dimension(V) == 2 else (slice(3), slice(3))


def possible_motions(V: fem.FunctionSpace) -> Flags:
    """Which translations and rotations are motions of a rigid body in a space, ``(k,)``. Local.

    Translations in x, y, z and rotations about these axes, in the plane in x, y and about z. All
    of them are; of a ring only the translation along y keeps its radius.
    """
    if is_axisymmetric(V.mesh):
        return np.array([False, True, False])
    return np.ones({2: 3, 3: 6}[dimension(V)], dtype=bool)


def bounds(x: Floats, nodes: Ints) -> Floats:
    """Least and greatest coordinates of some nodes, ``(2, 3)`` [m]; inf and -inf of none. Local.

    Args:
        x: Positions of the local nodes, shape ``(l, 3)`` [m].
        nodes: Some of them, shape ``(n,)``.
    """
    return _kernels.bounds(x, nodes)


def motion_sums(x: Floats, p: Floats, v: Floats) -> Floats:
    """Kinetic energy, linear and angular momentum of nodes, shape ``(7,)``. Local.

    Args:
        x: Positions of at least these nodes, the first ones, shape ``(l, 3)`` [m].
        p: Their momenta, shape ``(n, 2)`` or ``(n, 3)`` [kg m/s].
        v: Their velocities, of the same shape [m/s].
    """
    return _kernels.motion_sums(x, p, v)


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
