"""Fields over the nodes of a rigid body that are linear in the reference position."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.components import dimension, in_space
from dolfinx_nts.model.rigid_body import RigidBody
from dolfinx_nts.parallel import reductions

__all__ = ["TURNS", "LinearFields", "nearest", "products_of", "rigid_motions", "turned"]

# Rotations by a unit vector: of x, y and z in space, of z in the plane.
TURNS = {
    2: np.array([[[0.0, -1.0], [1.0, 0.0]]]),
    3: np.cross(np.eye(3)[:, None], np.eye(3)).transpose(0, 2, 1),
}


class LinearFields:
    """Fields over the nodes of a body that are linear in the reference position. Collective.

    Coefficients of a vector field have the shape ``(d + 1, d)``.

    Args:
        body: The body.
        point: Where all but the first field are zero, shape ``(d,)`` [m]; None: the mean of all
            nodes.

    Attributes:
        body: The argument.
        nodes: Its owned nodes, shape ``(n,)``.
        point: The argument.
        values: One, and the position from the point, shape ``(n, d + 1)`` [-, m].
        products: Products of these, summed over all nodes, shape ``(d + 1, d + 1)``.
        reference: Coefficients of the reference position.
        size: Greatest coordinate from the point [m].
        free: Motions in which the guide of the body leaves it free, all without one, see
            `Guide.free`.
    """

    def __init__(self, body: RigidBody, point: Floats | None = None) -> None:
        """Find the nodes, and their mean position."""
        self.body, V = body, body.V
        comm: MPI.Comm = V.mesh.comm
        self.nodes: Ints = body.nodes[body.nodes < V.dofmap.index_map.size_local]
        X = V.tabulate_dof_coordinates()[self.nodes, : dimension(V)]
        if point is None:
            *total, count = reductions.total(comm, np.array([*X.sum(axis=0), len(X)]))
            point = np.array(total) / count
        self.point: Floats = point
        self.values: Floats = np.column_stack([np.ones(len(X)), X - point])
        self.size = reductions.largest(comm, float(np.abs(X - point).max(initial=0.0)))
        self.products: Floats = reductions.total(comm, self.values.T @ self.values)
        self.reference: Floats = np.vstack([point, np.eye(len(point))])
        dim = len(point)
        self.free: Floats = (
            np.eye(dim + len(TURNS[dim])) if body.guide is None else body.guide.free(dim)
        )

    def led(self, t_n: float, t: float) -> Floats:
        """How the guide moves the body between two times [s], see `Guide.led`. Local."""
        if self.body.guide is None:
            return np.zeros(self.free.shape[1])
        return self.body.guide.led(in_space(self.point), t_n, t, len(self.point))

    def sums(self, vectors: Floats) -> Floats:
        """Products of the fields with nodal vectors ``(f, N, d)`` on this rank, ``(f, d + 1, d)``.

        Local.
        """
        products: Floats = np.matmul(self.values.T, vectors[:, self.nodes])
        return products

    def fit(self, sums: Floats) -> Floats:
        """Coefficients of a field by its total `sums`. Local."""
        return np.asarray(np.linalg.solve(self.products, sums), dtype=np.float64)


def rigid_motions(q: Floats) -> Floats:
    """Translations, and rotations about the point, of a field q of positions. Local.

    Returns:
        Coefficients, shape ``(k, d + 1, d)``.
    """
    dim = q.shape[1]
    motions = np.zeros((dim + len(TURNS[dim]), *q.shape))
    motions[np.arange(dim), 0, np.arange(dim)] = 1.0
    motions[dim:, 1:] = np.einsum("kij,mj->kmi", TURNS[dim], q[1:])
    return motions


def turned(q: Floats, amounts: Floats) -> Floats:
    """Change of positions q by a displacement and a Cayley vector, ``(d + 1, d)``. Local."""
    dim = q.shape[1]
    spin = np.einsum("k,kij->ij", amounts[dim:], TURNS[dim])
    change: Floats = q @ np.linalg.solve(np.eye(dim) - spin / 2, spin).T
    change[0] = amounts[:dim]
    return change


def nearest(motions: Floats, weights: Floats, sums: Floats) -> Floats:
    """Amounts of motions nearest to a field with given `sums`, shape ``(k,)``. Local."""
    gram = products_of(motions, weights, motions)
    amounts: Floats = np.linalg.solve(gram, np.einsum("kmi,mi->k", motions, sums))
    return amounts


def products_of(left: Floats, weights: Floats, right: Floats) -> Floats:
    """Products of fields ``(k, d + 1, d)`` by those of the linear fields, ``(k, k)``. Local."""
    matrix: Floats = np.einsum("kmi,mn,lni->kl", left, weights, right)
    return matrix
