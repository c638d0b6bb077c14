"""Active set of exact contact: which nodes have a normal multiplier."""

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_nts.contact import ContactPair
from dolfinx_nts.contact_rows import Rows
from dolfinx_nts.enforcement import LagrangeMultiplier
from dolfinx_nts.pivoting import Pivoting

__all__ = ["ActiveSet"]

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# Force of an active node, and gap times stiffness, that are none: of k h, as in
# the round-off of the residual.
_ROUNDING = 16 * np.finfo(np.float64).eps


class ActiveSet:
    """Decides node by node between contact and none.

    Args:
        pair: The contact pair.
        law: Its enforcement.
        stiffness: Stiffness of the nodes, shape ``(n,)`` [N/m].
        comm: Communicator of the mesh.
    """

    def __init__(
        self, pair: ContactPair, law: LagrangeMultiplier, stiffness: Floats, comm: MPI.Comm
    ) -> None:
        """Start with nothing known."""
        self._law, self._stiffness = law, stiffness
        self._ids, self._size = pair.nodes.node_ids, pair.segment_size
        self._pivoting = Pivoting(comm)

    def update(
        self, rows: Rows, before: Flags, lambda_N: Floats, iteration: int
    ) -> tuple[Flags, int]:
        """Decide. Collective.

        Args:
            rows: The pairs.
            before: Whether they were active, shape ``(m,)``.
            lambda_N: Their multipliers, shape ``(m,)`` [N].
            iteration: Number of the Newton iteration, from 0.

        Returns:
            Whether they are active now; and how many here do not fit.
        """
        excess = rows.excess[:, 0]
        if iteration == 0:
            wrong = (excess < 0) & ~before
        else:
            stiffness = self._stiffness[rows.node]
            wrong = self._law.active(lambda_N, excess, stiffness) != before
            if wrong.any():
                # Vertices of triangles of degree 2 carry nothing under a uniform
                # pressure: rounding must not decide again and again.
                force = np.maximum(np.abs(lambda_N), stiffness * np.abs(excess))
                wrong &= ~(force <= _ROUNDING * stiffness * self._size)
        changes, violators = self._pivoting.select(wrong, self._ids[rows.node], iteration)
        return before ^ changes if violators else before, violators
