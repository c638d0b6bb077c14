"""How forces move free bodies as a whole, where factors of a matrix hold them too much."""

from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions

__all__ = ["Mobility"]


class Mobility(NamedTuple):
    """What is to be added to responses of factors B of a matrix with ``k`` free motions.

    The bodies alone do not resist free motions P, so that B moves them as what the matrix has in
    addition does, D: B D P = P. Another stiffness D' in some of them, Q, and a hold in all others
    make B - P (P^T D P)^-1 P^T + Q (Q^T D' Q)^-1 Q^T of B.

    Attributes:
        motions: The free motions P at the owned nodes, shape ``(k, n, d)`` [-].
        compliance: What is added between P and P^T, shape ``(k, k)`` [m/N].
    """

    motions: Floats
    compliance: Floats

    @classmethod
    def of(
        cls, comm: MPI.Comm, motions: Floats, held: Floats, present: Floats | float, wanted: Floats
    ) -> "Mobility":
        """Find what is to be added. Collective.

        Args:
            comm: Communicator of the mesh.
            motions: The free motions at the owned nodes, shape ``(k, n, d)`` [-].
            held: Sums of them that are not made, shape ``(k, h)``.
            present: Stiffness that the matrix has in addition, shape ``(n, 1)`` or of all
                nodes [N/m].
            wanted: The one in its place, shape ``(n, 1)`` [N/m].
        """
        k = len(motions)
        rows = motions.reshape(k, motions[0].size if k else 0)
        weighted = [(stiffness * motions).reshape(rows.shape) for stiffness in (present, wanted)]
        before, after = reductions.total(comm, np.array([some @ rows.T for some in weighted]))
        free = np.linalg.svd(held)[0][:, held.shape[1] :]
        inverse = free @ np.linalg.solve(free.T @ after @ free, free.T)
        return cls(motions, inverse - np.linalg.inv(before))

    def by(self, comm: MPI.Comm, force: Floats) -> Floats:
        """Amounts of the motions by a force on the owned dofs [N], shape ``(k,)``. Collective."""
        rows = self.motions.reshape(len(self.motions), force.size)
        amounts: Floats = self.compliance @ reductions.total(comm, rows @ force)
        return amounts
