"""Linear fields in the reference position over the nodes of a rigid body."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Array, Floats, Ints
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.rigid_body import RigidBody
from dolfinx_nts.parallel import reductions

__all__ = [
    "TURNS",
    "LinearFields",
    "combined",
    "inner_products",
    "nearest",
    "products_of",
    "rigid_motions",
    "solved",
    "spins",
    "turned",
]

# Skew matrices of infinitesimal rotations about the axes x, y and z in space, and z in the plane:
# their product with a vector is the cross product of the axis and the vector.
TURNS = {
    2: np.array([[[0.0, -1.0], [1.0, 0.0]]]),
    3: np.cross(np.eye(3)[:, None], np.eye(3)).transpose(0, 2, 1),
}


class LinearFields:
    """Linear fields in the reference position over the nodes of a body. Collective.

    Coefficients of a vector field have the shape ``(d + 1, d)``.

    Args:
        body: The body.
        point: Origin of the linear fields, shape ``(d,)`` [m]; None: the mean of all nodes.

    Attributes:
        body: The argument.
        nodes: Its owned nodes, shape ``(n,)``.
        point: The origin.
        values: One, and the position from the origin, shape ``(n, d + 1)`` [-, m].
        products: Products of ``values`` summed over all nodes, shape ``(d + 1, d + 1)``.
        reference: Coefficients of the reference position.
        size: Largest coordinate from the origin [m].
        free: Free motions of the body, see `RigidBody.free`.
    """

    def __init__(self, body: RigidBody, point: Floats | None = None) -> None:
        self.body, V = body, body.V
        comm: MPI.Comm = V.mesh.comm
        self.nodes: Ints = body.nodes[body.nodes < V.dofmap.index_map.size_local]
        X = reference_positions(V)[self.nodes, : dimension(V)]
        if point is None:
            *total, count = reductions.total(comm, np.array([*X.sum(axis=0), len(X)]))
            point = np.array(total) / count
        self.point: Floats = point
        self.values: Floats = np.column_stack([np.ones(len(X)), X - point])
        self.size = reductions.largest(comm, _kernels.largest_size(X - point))
        self.products: Floats = reductions.total(comm, self.values.T @ self.values)
        self.reference: Floats = np.vstack([point, np.eye(len(point))])
        self.free: Floats = body.free()

    def prescribed(self, t_n: float, t: float) -> Floats:
        """Prescribed motion of the guide between two times [s]. Local."""
        return self.body.prescribed(self.point, t_n, t)


def rigid_motions(q: Floats) -> Floats:
    """Translations, and rotations about the origin, of fields of positions. Local.

    Args:
        q: Coefficients of the positions, shape ``(..., d + 1, d)``.

    Returns:
        Coefficients of the motions, shape ``(..., k, d + 1, d)``.
    """
    dim, turns = q.shape[-1], TURNS[q.shape[-1]]
    motions = np.zeros((*q.shape[:-2], dim + len(turns), *q.shape[-2:]))
    motions[..., np.arange(dim), 0, np.arange(dim)] = 1.0
    motions[..., dim:, 1:, :] = q[..., None, 1:, :] @ turns.transpose(0, 2, 1)
    return motions


def turned(q: Floats, amplitudes: Floats) -> Floats:
    """Changes of positions by displacements and rotations, of the shape of ``q``. Local.

    Args:
        q: Coefficients of the positions, shape ``(..., d + 1, d)``.
        amplitudes: Displacement of the origin and Cayley vector of the rotation, shape ``(...,
            k)``.
    """
    dim = q.shape[-1]
    spin = spins(amplitudes)
    turn = np.linalg.solve(np.eye(dim) - spin / 2, spin)
    change: Floats = q @ np.swapaxes(turn, -1, -2)
    change[..., 0, :] = amplitudes[..., :dim]
    return change


def spins(amplitudes: Floats) -> Floats:
    """Skew-symmetric matrices of the rotations in amplitudes of motions. Local.

    ``amplitudes`` have the shape ``(..., k)``, the matrices ``(..., d, d)``.
    """
    dim = {3: 2, 6: 3}[amplitudes.shape[-1]]
    matrices: Floats = np.tensordot(amplitudes[..., dim:], TURNS[dim], axes=1)
    return matrices


def nearest(motions: Floats, weights: Floats, sums: Floats) -> Floats:
    """Amplitudes of motions in the best approximation of fields, shape ``(..., k)``. Local.

    Args:
        motions: Coefficients of the motions, none of them zero, shape ``(..., k, d + 1, d)``.
        weights: Products of the linear fields, shape ``(..., d + 1, d + 1)``.
        sums: Products of the linear fields with the approximated fields, shape ``(..., d + 1, d)``.
    """
    return solved(products_of(motions, weights, motions), inner_products(motions, sums))


def inner_products(motions: Floats, sums: Array) -> Floats:
    """Inner products ``(..., k)`` of fields ``(..., k, d + 1, d)`` and sums ``(..., d + 1, d)``."""
    products = _flat(motions) @ sums.reshape(*sums.shape[:-2], -1, 1)
    return np.asarray(products[..., 0], dtype=np.float64)


def combined(amplitudes: Floats, motions: Floats) -> Floats:
    """Sums ``(..., d + 1, d)`` of motions ``(..., k, d + 1, d)`` times amplitudes ``(..., k)``."""
    field: Floats = (amplitudes[..., None, :] @ _flat(motions))[..., 0, :]
    return field.reshape(*amplitudes.shape[:-1], *motions.shape[-2:])


def solved(matrices: Floats, right: Floats) -> Floats:
    """Solutions ``(..., k)`` of systems with matrices ``(..., k, k)``. Local."""
    solutions = np.linalg.solve(matrices, right[..., None])[..., 0]
    return np.asarray(solutions, dtype=np.float64)


def products_of(left: Floats, weights: Floats, right: Floats) -> Floats:
    """Weighted products ``(..., k, k)`` of fields ``(..., k, d + 1, d)`` with each other."""
    weighted = weights[..., None, :, :] @ right
    matrix: Floats = _flat(left) @ np.swapaxes(_flat(weighted), -1, -2)
    return matrix


def _flat(motions: Floats) -> Floats:
    """Coefficients of each motion in a row, ``(..., k, (d + 1) d)``. Local."""
    return motions.reshape(*motions.shape[:-2], -1)
