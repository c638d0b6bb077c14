"""Linear fields over the nodes of all rigid bodies together.

Arrays of values per body, such as the coefficients of linear fields ``(d + 1, d)``, have the ``b``
bodies as the first axis. With many bodies, a Python loop over them would take most of the time.
"""

from collections.abc import Sequence
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats, Ints
from dolfinx_nts.fem.components import possible_motions
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.rigid.linear_fields import LinearFields, nearest

__all__ = ["Freedom", "RigidFields"]


class Freedom(NamedTuple):
    """Free motions of guided bodies. Local.

    Attributes:
        free: Free motions of each body as combinations of all motions, in rows; rows of zeros fill
            up the shape ``(b, k, k)``.
        no_motion: Ones on the diagonal in place of the zero rows, ``(b, k, k)``, so that their
            amplitudes are zero.
    """

    free: Floats
    no_motion: Floats

    @classmethod
    def of(cls, bodies: Sequence[LinearFields]) -> "Freedom":
        """Free motions of some bodies."""
        k = bodies[0].free.shape[1]
        free, no_motion = np.zeros((2, len(bodies), k, k))
        for i, body in enumerate(bodies):
            free[i, : len(body.free)] = body.free
            no_motion[i] = np.diag(np.arange(k) >= len(body.free))
        return cls(free, no_motion)

    def at(self, some: Array) -> "Freedom":
        """Free motions of a subset of the bodies."""
        return Freedom(self.free[some], self.no_motion[some])

    def project(self, amplitudes: Floats) -> Floats:
        """Project the amplitudes of all motions on the free motions, both ``(b, k)``."""
        return self._back((self.free @ amplitudes[..., None])[..., 0])

    def solved(self, matrices: Array, right: Floats) -> Floats:
        """Amplitudes of the free motions, by matrices ``(b, k, k)`` of all motions, ``(b, k)``."""
        own = self.free @ matrices @ self.free.transpose(0, 2, 1) + self.no_motion
        return self._back(np.linalg.solve(own, self.free @ right[..., None])[..., 0])

    def _back(self, free: Array) -> Floats:
        """Amplitudes of all motions from amplitudes of the free motions."""
        amplitudes: Floats = (self.free.transpose(0, 2, 1) @ free[..., None])[..., 0]
        return amplitudes


class RigidFields:
    """Linear fields over the nodes of all rigid bodies. Collective.

    Vectors are nodal, over the owned nodes of the space, shape ``(n, d)``.

    Args:
        comm: Communicator.
        bodies: Linear fields of each body, at least one.

    Attributes:
        freedom: Free motions of the bodies.
        products: Products of the fields, summed over all nodes, shape ``(b, d + 1, d + 1)``.
        reference: Coefficients of the reference positions, shape ``(b, d + 1, d)``.
    """

    def __init__(self, comm: MPI.Comm, bodies: Sequence[LinearFields]) -> None:
        self._comm, self.freedom = comm, Freedom.of(bodies)
        self.products: Floats = np.array([body.products for body in bodies])
        self.reference: Floats = np.array([body.reference for body in bodies])
        self._possible = possible_motions(bodies[0].body.V)
        self._nodes: Ints = np.concatenate([body.nodes for body in bodies])
        self._values: Floats = np.concatenate([body.values for body in bodies])
        self._counts = np.array([len(body.nodes) for body in bodies])

    def sums(self, *vectors: Floats) -> Floats:
        """Products of the fields and ``f`` vectors over all ranks, ``(f, b, d + 1, d)``."""
        at_nodes = np.array([vector[self._nodes] for vector in vectors])
        products = self._values[:, :, None] * at_nodes[:, :, None]
        sums = np.zeros((len(vectors), len(self._counts), *products.shape[2:]))
        has_nodes = self._counts > 0  # on this rank
        if has_nodes.any():
            first = (np.cumsum(self._counts) - self._counts)[has_nodes]
            sums[:, has_nodes] = np.add.reduceat(products, first, axis=1)
        total: Floats = reductions.total(self._comm, sums)
        return total

    def nearest(self, motions: Floats, sums: Floats) -> Floats:
        """Amplitudes of possible motions in the best approximation of fields, ``(b, k)``. Local.

        Args:
            motions: Coefficients of all motions, shape ``(b, k, d + 1, d)``.
            sums: Products with the approximated fields, shape ``(b, d + 1, d)``.
        """
        amplitudes: Floats = np.zeros(motions.shape[:2])
        possible = self._possible
        amplitudes[:, possible] = nearest(motions[:, possible], self.products, sums)
        return amplitudes

    def fit(self, sums: Floats) -> Floats:
        """Coefficients of the fields with given total sums, ``(b, d + 1, d)``. Local."""
        return np.asarray(np.linalg.solve(self.products, sums), dtype=np.float64)

    def positions(self, sums: Floats) -> Floats:
        """Coefficients of the positions from sums of displacements, ``(b, d + 1, d)``. Local."""
        positions: Floats = self.reference + self.fit(sums)
        return positions

    def put(self, fields: Floats, values: Floats) -> Floats:
        """Set nodal values of the bodies to fields, ``(b, d + 1, d)``. Local."""
        of_nodes = np.repeat(fields, self._counts, axis=0)
        values[self._nodes] = (self._values[:, None] @ of_nodes)[:, 0]
        return values
