"""Checks of contact in a stepper."""

import logging
import math
from collections.abc import Mapping, Sequence
from functools import cached_property

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.checks.overlap_watch import OverlapWatch
from dolfinx_nts.contact.checks.passage import shortest_passage_of
from dolfinx_nts.contact.checks.reverse_passage import ReversePassages
from dolfinx_nts.contact.checks.short_contacts import ShortContacts
from dolfinx_nts.contact.checks.soft_springs import SoftSprings
from dolfinx_nts.contact.checks.turned_nodes import TurnedNodes
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.parallel import reductions

__all__ = ["ContactWatch", "EnergyGain"]

_logger = logging.getLogger("dolfinx_nts")

# Spurious energy gain relative to the kinetic energy after a step [-] above which it is reported.
_PART = 0.25
# Kinetic energy relative to the largest one so far [-] below which bodies count as at rest.
_REST = 1e-6


class EnergyGain:
    """Check for spurious work of constraints, as when they push out penetrating nodes. Local.

    Springs are not constraints: what their forces gain in a step depends on the scheme. A warning
    is repeated only if a step gains twice as much. Arguments are the same on all ranks.

    Args:
        comm: Communicator.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        self._comm, self._reported, self._largest = comm, 0.0, 0.0

    def check(
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
            negligible: Work of constraints within the tolerance of gaps [J], which is not reported.
        """
        before, after = kinetic
        self._largest = max(self._largest, before)
        gains = {
            state: work.persistent + work.activation + work.facet_change
            for state, work in works.items()
            if not isinstance(state.pair.enforcement, Penalty)
        }
        state = max(gains, key=gains.__getitem__, default=None)
        least = max(before, _PART * after, _REST * self._largest, 2 * self._reported, negligible)
        if state is None or gains[state] <= least:
            return
        self._reported = gain = gains[state]
        if self._comm.rank == 0:
            _logger.warning(
                "at t = %g contact between %s by %r has given the bodies %.3g J in one step, more "
                "than their kinetic energy of %.3g J before it: constraints have moved nodes out "
                "of a surface within the step, and the motion from here on is wrong; "
                "EnergyMomentum with elastic or restitution impact gains no energy, others gain "
                "less with shorter steps; bodies that begin inside each other are separated by a "
                "step of QuasiStatic, after which load_state continues",
                *(t, state.pair.between, state.pair.enforcement, gain, before),
            )


class ContactWatch:
    """Checks of overlaps, passing vertices, soft springs, and energy gains. Collective.

    Args:
        bodies: The bodies of a stepper.
        contacts: Its contact pairs.

    Attributes:
        overlaps: Overlap check of bodies.
        vertices: Pass-through check of the vertices of segments.
        springs: Check of soft springs.
        turned: Check of nodes that touch along another normal than that of their facets.
        gains: Check of spurious energy gains.
        impacts: Check of impacts that last a few steps; None in statics and explicit steps.
        velocity: Reference velocity of relative motions, shape ``(d,)`` [m/s]. Any value is valid;
            the midrange of the velocities gives the sharpest bounds.
    """

    def __init__(self, bodies: Sequence[Body], contacts: Sequence[PairState]) -> None:
        self.vertices = ReversePassages([contact.pair for contact in contacts])
        self.overlaps = OverlapWatch(bodies, contacts, self.vertices.clear)
        self.springs = SoftSprings(bodies, contacts)
        self.turned = TurnedNodes(contacts)
        self._contacts = tuple(contacts)
        self._comm = bodies[0].V.mesh.comm
        self.gains = EnergyGain(self._comm)
        self.impacts: ShortContacts | None = None
        self.velocity: Floats = np.zeros(dimension(bodies[0].V))
        # Allowed approach of any two nodes until the next check, and its value at the last update
        # of vertices and overlaps [m].
        self._clearance = self._clearance_at_update = 0.0

    @cached_property
    def _passage(self) -> float:
        """Least approach at which a node may pass through a surface, 0 if obstacles move [m]."""
        if any(contact.search.may_move for contact in self._contacts):
            return 0.0
        return min((shortest_passage_of(each.pair) for each in self._contacts), default=math.inf)

    def measure_about(self, velocities: Floats) -> None:
        """Set the reference velocity to the midrange of nodal velocities, ``(n, d)`` [m/s]."""
        extremes = [
            -velocities.min(axis=0, initial=np.inf),
            velocities.max(axis=0, initial=-np.inf),
        ]
        negative_least, greatest = reductions.largest(self._comm, np.array(extremes))
        self.velocity = (greatest - negative_least) / 2

    def skips_check(self, moved: float) -> bool:
        """Register a step if no check is due. Collective.

        Vertices and overlaps are updated later by `update`, as updates in each step would take
        longer than the checks.

        Args:
            moved: Half the bound on the approach of any two nodes, or of a node and a fixed point,
                in the step; the same on all ranks [m].

        Returns:
            Whether no check is due; otherwise the step is not registered.
        """
        approach = 2 * moved
        if approach >= self._passage:
            return False
        left = self._clearance - approach
        # A check is due if a next step of the same length could need it.
        if left < approach:
            self.update()
            clearance = min(self.vertices.clearance, self.overlaps.clearance)
            left = clearance - approach
            if left < approach:
                return False
            self._clearance_at_update = clearance
        self._clearance = left
        return True

    def update(self) -> None:
        """Update vertices and overlaps by the motion of all steps since the last update. Local."""
        before = self._clearance_at_update
        approach = before - self._clearance if math.isfinite(before) else 0.0
        if approach > 0:
            self.vertices.travel(approach)
            self.overlaps.travel(approach)
        self._clearance = self._clearance_at_update = 0.0

    def check_overlaps(self, x: Floats, t: float) -> None:
        """Check for overlaps and for turned nodes, whether or not a check is due."""
        self.update()
        self.overlaps.check(x, t)
        self.turned.check(x, t)

    def forget(self) -> None:
        """Discard earlier motion, after the state was set. Local."""
        self.update()
        self.vertices.forget()

    def serialize(self, archive: Archive) -> None:
        """Serialize the check of vertices, and the reference velocity."""
        self.update()
        self.velocity = np.asarray(archive.same("velocity_of_watch", self.velocity))
        self.vertices.serialize(archive)
