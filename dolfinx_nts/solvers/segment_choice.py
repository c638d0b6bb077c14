"""Update of the candidate segments within the iterations of a step."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.parallel import reductions

__all__ = ["SegmentChoice"]

# Largest number of updates of the contact points before equilibrium [-], and required reduction of
# the residual between two updates [-].
_MOST_EARLY, _FELL = 3, 0.1


class SegmentChoice:
    """Updates the segments in equilibrium and, in statics, also near equilibrium.

    In statics nodes slide far, and their final segments are known early. Updates of the contact
    points of mortar facets converge linearly, so intermediate equilibria need not be accurate.

    Args:
        comm: Communicator.
        steps: Contact attempts.
        is_static: Whether there is no inertia.
    """

    def __init__(self, comm: MPI.Comm, steps: Sequence[ContactStep], is_static: bool) -> None:
        self._comm, self._steps = comm, steps
        self._nodes_wait = is_static
        self._num_early = _MOST_EARLY if is_static else 0
        self._laid, self._is_new = np.inf, False

    def renew(self, norm: float, *, is_near: bool, converged: bool) -> int:
        """Update segments if due; return the number of changes on all ranks. Collective.

        After any change, equilibrium has to be solved for again.

        Args:
            norm: Norm of the residual [N].
            is_near: Whether the residual is small, and no state violates its condition.
            converged: Whether the iterate is in equilibrium.
        """
        if self._is_new:
            self._laid, self._is_new = norm, False
        nodes, points = converged, converged
        if is_near:
            nodes, self._nodes_wait = nodes or self._nodes_wait, False
            if not converged and self._num_early and norm <= _FELL * self._laid:
                points = True
                self._num_early -= 1
        moved = 0
        if nodes or points:
            chosen = [s for s in self._steps if (nodes if s.search.pairing.follows else points)]
            moved = reductions.total(self._comm, sum(step.reproject(converged) for step in chosen))
        self._is_new = points and moved > 0
        return moved
