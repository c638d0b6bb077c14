"""What a stepper watches over in contact, beside solving for it."""

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.energy_gain import EnergyGain
from dolfinx_nts.contact.overlap_watch import OverlapWatch
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.passage import shortest_passage_of
from dolfinx_nts.contact.reverse_passage import ReversePassages
from dolfinx_nts.contact.soft_springs import SoftSprings
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.parallel import reductions

__all__ = ["ContactWatch"]


class ContactWatch:
    """Watches over overlaps, vertices that pass, springs that yield, and energy. Collective.

    Args:
        bodies: The bodies of a stepper.
        contacts: Its contact pairs.

    Attributes:
        overlaps: Bodies that are inside each other, whatever the pairs are.
        vertices: Vertices of segments that go through the facets of the nodes.
        springs: Springs that are too soft.
        gains: Steps in which contact makes energy.
        velocity: About which the motions of nodes are measured, shape ``(d,)`` [m/s]. Any will
            do; bounds on the motion of nodes to each other are closest about the middle one.
    """

    def __init__(self, bodies: Sequence[Body], contacts: Sequence[PairState]) -> None:
        self.vertices = ReversePassages([contact.pair for contact in contacts])
        self.overlaps = OverlapWatch(bodies, contacts, self.vertices.clear)
        self.springs = SoftSprings(bodies, contacts)
        self._contacts = tuple(contacts)
        self._comm = bodies[0].V.mesh.comm
        self.gains = EnergyGain(self._comm)
        self.velocity: Floats = np.zeros(dimension(bodies[0].V))
        # By how much any two may come nearer until something has to be looked at, and what of it
        # was left when vertices and overlaps were told last [m].
        self._room = self._told = 0.0

    @cached_property
    def _passage(self) -> float:
        """Motion of two from which on a node may pass a surface, 0 where obstacles move [m]."""
        if any(contact.search.may_move for contact in self._contacts):
            return 0.0
        return min((shortest_passage_of(each.pair) for each in self._contacts), default=math.inf)

    def measure_about(self, velocities: Floats) -> None:
        """Choose the middle of the velocities of all nodes, ``(n, d)`` [m/s]. Collective."""
        extremes = [
            -velocities.min(axis=0, initial=np.inf),
            velocities.max(axis=0, initial=-np.inf),
        ]
        negative_least, greatest = reductions.largest(self._comm, np.array(extremes))
        self.velocity = (greatest - negative_least) / 2

    def free(self, moved: float) -> bool:
        """Count a step if no node moves so far that anything has to be looked at. Collective.

        What would tell vertices and overlaps of each step would take longer than all looks.

        Args:
            moved: Half of what any two nodes come nearer to each other in the step, or one to
                what is at rest, at most; the same on all ranks [m].

        Returns:
            Whether that is so; otherwise the step is not counted.
        """
        way = 2 * moved
        if way >= self._passage:
            return False
        left = self._room - way
        # The next step may be as long.
        if left < way:
            self.settle()
            room = min(self.vertices.room, self.overlaps.room)
            left = room - way
            if left < way:
                return False
            self._told = room
        self._room = left
        return True

    def settle(self) -> None:
        """Tell vertices and overlaps how far nodes have moved in steps that were free. Local."""
        way = self._told - self._room if math.isfinite(self._told) else 0.0
        if way > 0:
            self.vertices.travel(way)
            self.overlaps.travel(way)
        self._room = self._told = 0.0

    def look(self, x: Floats, t: float) -> None:
        """Check for overlaps now."""
        self.settle()
        self.overlaps.look(x, t)

    def forget(self) -> None:
        """Begin anew, as the state was set. Local."""
        self.settle()
        self.vertices.forget()

    def serialize(self, archive: Archive) -> None:
        """Serialize what is known of vertices, and the velocity."""
        self.settle()
        self.velocity = np.asarray(archive.same("velocity_of_watch", self.velocity))
        self.vertices.serialize(archive)
