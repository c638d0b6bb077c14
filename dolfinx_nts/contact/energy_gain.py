"""Warning of spurious energy gains by contact."""

import logging
from collections.abc import Mapping

from mpi4py import MPI

from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.pair_state import PairState

__all__ = ["EnergyGain"]

_logger = logging.getLogger("dolfinx_nts")

# Gain relative to the kinetic energy after a step [-] that is reported.
_PART = 0.25
# Kinetic energy relative to the largest one so far [-] below which bodies count as at rest.
_REST = 1e-6


class EnergyGain:
    """Check of the work of constraints, as when penetrating nodes are pushed out. Local.

    A warning is repeated only if a step gains twice as much. Arguments are the same on all ranks.

    Args:
        comm: Communicator.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        self._comm, self._told, self._largest = comm, 0.0, 0.0

    def look(
        self,
        works: Mapping[PairState | JointState, ContactWork],
        kinetic: tuple[float, float],
        t: float,
        negligible: float,
    ) -> None:
        """Check an accepted step.

        Args:
            works: Energy that contact gave to the bodies in the step.
            kinetic: Kinetic energy of all bodies before and after the step [J].
            t: Time at its end [s].
            negligible: Work of constraints within the tolerance of gaps [J], for bodies at rest.
        """
        before, after = kinetic
        self._largest = max(self._largest, before)
        gains = {
            state: work.persistent + work.activation + work.facet_change
            for state, work in works.items()
        }
        state = max(gains, key=gains.__getitem__, default=None)
        least = max(before, _PART * after, _REST * self._largest, 2 * self._told, negligible)
        if state is None or gains[state] <= least:
            return
        self._told = gain = gains[state]
        if self._comm.rank == 0:
            _logger.warning(
                "at t = %g contact by %r has given the bodies %.3g J in one step, more than their "
                "kinetic energy of %.3g J before it: constraints have moved nodes out of a surface "
                "at once, and the motion from here on is wrong; EnergyMomentum with elastic or "
                "restitution impact gains nothing, and with shorter steps others gain less; where "
                "bodies begin inside each other, let a step of QuasiStatic part them, and go on "
                "from it by load_state",
                *(t, state.pair.enforcement, gain, before),
            )
