"""Additional compliance of free bodies, for factors of a matrix with an artificial stiffness."""

from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions

__all__ = ["Mobility"]


class Mobility(NamedTuple):
    """Correction of the factors B of a matrix for an artificial stiffness in ``k`` free motions.

    Only the artificial stiffness D resists the free motions P, so that B D P = P. D is replaced by
    another stiffness D' in a subset Q of the motions, and all others are suppressed: B becomes B -
    P (P^T D P)^-1 P^T + Q (Q^T D' Q)^-1 Q^T.

    Attributes:
        motions: The free motions P at the owned nodes, shape ``(k, n, d)`` [-].
        compliance: Matrix between P and P^T in the correction, shape ``(k, k)`` [m/N].
    """

    motions: Floats
    compliance: Floats

    @classmethod
    def of(
        cls,
        comm: MPI.Comm,
        motions: Floats,
        suppressed: Floats,
        present: Floats | float,
        wanted: Floats,
    ) -> "Mobility":
        """Compute the correction. Collective.

        Args:
            comm: Communicator of the mesh.
            motions: The free motions at the owned nodes, shape ``(k, n, d)`` [-].
            suppressed: Suppressed combinations of the free motions, shape ``(k, h)``.
            present: Artificial stiffness D of the matrix, shape ``(n, 1)`` or of all nodes [N/m].
            wanted: Stiffness D' that replaces it, shape ``(n, 1)`` [N/m].
        """
        k = len(motions)
        rows = motions.reshape(k, motions[0].size if k else 0)
        weighted = [(stiffness * motions).reshape(rows.shape) for stiffness in (present, wanted)]
        before, after = reductions.total(comm, np.array([some @ rows.T for some in weighted]))
        free = np.linalg.svd(suppressed)[0][:, suppressed.shape[1] :]
        inverse = free @ np.linalg.solve(free.T @ after @ free, free.T)
        return cls(motions, inverse - np.linalg.inv(before))

    def by(self, comm: MPI.Comm, force: Floats) -> Floats:
        """Amplitudes of the motions for a force on owned dofs [N], ``(k,)`` [m]. Collective."""
        rows = self.motions.reshape(len(self.motions), force.size)
        amplitudes: Floats = self.compliance @ reductions.total(comm, rows @ force)
        return amplitudes
