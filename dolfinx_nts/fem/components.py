"""Number of components of nodal vectors: three for positions, two or three for unknowns.

Positions have three coordinates as in DOLFINx; in the plane the third one is zero. The same holds
for normals, forces and gradients of contact. Displacements, residuals and linear systems have the
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
    """View of the values at the local nodes, shape ``(l, 2)`` or ``(l, 3)``. Local."""
    vector = function.x
    values: Floats = vector.array.reshape(-1, vector.block_size)
    return values


def in_space(vectors: Floats) -> Floats:
    """Vectors, shape ``(..., 2)`` or ``(..., 3)``, extended to three components. Local.

    Vectors with three components are returned unchanged.
    """
    if vectors.shape[-1] == 3:
        return vectors
    # Column by column, as NumPy takes five times as long to copy such short rows.
    padded: Floats = _kernels.change_components(vectors.reshape(-1, 2))
    return padded.reshape(*vectors.shape[:-1], 3)


def of_space(vectors: Floats, dim: int) -> Floats:
    """Components of vectors, shape ``(n, 3)``, in a space of dimension d, ``(n, d)``. Local.

    For d = 3 they are returned unchanged.
    """
    return vectors if dim == 3 else _kernels.change_components(vectors)


def resultants(vectors: Floats, V: fem.FunctionSpace) -> Floats:
    """Components of resultants, momenta and centres, ``(..., 3)``, that exist in a space. Local.

    Returns:
        A view, shape ``(..., 3)``; in the plane ``(..., 2)``; axisymmetric ``(..., 1)``, along y.
    """
    return vectors[..., existing(V)[0]]


def moments(vectors: Floats, V: fem.FunctionSpace) -> Floats:
    """Components of moments, ``(..., 3)``, that exist in a space. Local.

    Returns:
        A view, shape ``(..., 3)``; in the plane ``(..., 1)``, about z; axisymmetric ``(..., 0)``.
    """
    return vectors[..., existing(V)[1]]


def existing(V: fem.FunctionSpace) -> tuple[slice, slice]:
    """Slices of the components of vectors, and of moments, that exist in a space. Local."""
    if is_axisymmetric(V.mesh):
        return slice(1, 2), slice(3, None)
    return (slice(2), slice(2, None)) if dimension(V) == 2 else (slice(3), slice(3))


def possible_motions(V: fem.FunctionSpace) -> Flags:
    """Flags of the translations and rotations that are rigid motions in a space, ``(k,)``. Local.

    The order is translations in x, y, z and rotations about these axes, in the plane x, y and about
    z. In an axisymmetric mesh only the translation along y is a rigid motion.
    """
    if is_axisymmetric(V.mesh):
        return np.array([False, True, False])
    return np.ones({2: 3, 3: 6}[dimension(V)], dtype=bool)


def bounds(x: Floats, nodes: Ints) -> Floats:
    """Smallest and largest coordinates of nodes, ``(2, 3)`` [m]; inf and -inf without nodes. Local.

    Args:
        x: Positions of the local nodes, shape ``(l, 3)`` [m].
        nodes: Selected local nodes, shape ``(n,)``.
    """
    return _kernels.bounds(x, nodes)


def motion_sums(x: Floats, p: Floats, v: Floats) -> Floats:
    """Kinetic energy, linear and angular momentum of nodes, shape ``(7,)``. Local.

    Args:
        x: Positions of the local nodes, shape ``(l, 3)`` [m], l >= n.
        p: Momenta of the first n nodes, shape ``(n, 2)`` or ``(n, 3)`` [kg m/s].
        v: Their velocities, of the same shape [m/s].
    """
    return _kernels.motion_sums(x, p, v)


def gradient(v: Any, *, on_axis: bool = False) -> Any:
    """Gradient of a vector field, UFL (3, 3).

    In the plane derivatives along z vanish; in an axisymmetric mesh the last entry is the hoop
    component.

    Args:
        v: Vector field, UFL.
        on_axis: Whether the gradient is also evaluated on the axis.
    """
    grad = ufl.grad(v)
    if grad.ufl_shape == (3, 3):
        return grad
    hoop = hoop_gradient(v, on_axis=on_axis)
    rows = [[grad[0, 0], grad[0, 1], 0], [grad[1, 0], grad[1, 1], 0], [0, 0, hoop]]
    return ufl.as_matrix(rows)


def deformation_gradient(u: Any, *, on_axis: bool = False) -> Any:
    """Deformation gradient of a displacement, UFL (3, 3), in plane meshes for plane strain.

    Arguments as for `gradient`.
    """
    return ufl.Identity(3) + gradient(u, on_axis=on_axis)
