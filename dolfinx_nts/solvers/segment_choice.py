"""When nodes and contact points choose their segments anew in the iterations of one step."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.parallel import reductions

__all__ = ["SegmentChoice"]

# How often contact points are laid anew near an equilibrium and not in it, and the reduction of
# the residual since they were laid last [-] from which on this pays: before, most of it is that of
# Newton's method, not that of the points.
_MOST_EARLY, _FELL = 3, 0.1


class SegmentChoice:
    """Chooses segments anew in equilibrium, and near to it where there is no inertia.

    Without inertia nodes slide far, and their segments are known before the end. Points of whole
    facets come nearer to where they belong by a factor each time they are laid anew, so that
    equilibrium on those that will not stay need not be found to the last digit.

    Args:
        comm: Communicator.
        steps: Contact attempts.
        is_static: Whether there is no inertia.
    """

    def __init__(self, comm: MPI.Comm, steps: Sequence[ContactStep], is_static: bool) -> None:
        """Begin where no equilibrium is near."""
        self._comm, self._steps = comm, steps
        self._nodes_wait = is_static
        self._num_early = _MOST_EARLY if is_static else 0
        self._laid, self._is_new = np.inf, False

    def renew(self, norm: float, *, is_near: bool, converged: bool) -> int:
        """Choose where it is time to; return how many changed on all ranks. Collective.

        With any change, equilibrium has to be found again.

        Args:
            norm: Residual [N].
            is_near: Whether it is small, and no state contradicts its condition.
            converged: Whether it is that of an equilibrium.
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
            moved = reductions.total(self._comm, sum(step.reproject() for step in chosen))
        self._is_new = points and moved > 0
        return moved
