"""What a stepper watches over in contact, beside solving for it."""

import math
from collections.abc import Sequence
from functools import cached_property

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.overlap_watch import OverlapWatch
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.passage import shortest_passage_of
from dolfinx_nts.contact.reverse_passage import ReversePassages
from dolfinx_nts.contact.soft_springs import SoftSprings
from dolfinx_nts.model.bodies import Body

__all__ = ["ContactWatch"]


class ContactWatch:
    """Watches over bodies that overlap, vertices that pass, and springs that yield. Collective.

    Args:
        bodies: The bodies of a stepper.
        contacts: Its contact pairs.

    Attributes:
        overlaps: Bodies that are inside each other, whatever the pairs are.
        vertices: Vertices of segments that go through the facets of the nodes.
        springs: Springs that are too soft.
    """

    def __init__(self, bodies: Sequence[Body], contacts: Sequence[PairState]) -> None:
        """Begin with nothing seen."""
        self.vertices = ReversePassages([contact.pair for contact in contacts])
        self.overlaps = OverlapWatch(bodies, contacts, self.vertices.clear)
        self.springs = SoftSprings(contacts)
        self._contacts = tuple(contacts)
        # Motion of steps of which the others were not told yet, and how much more there may be [m].
        self._way = self._room = 0.0

    @cached_property
    def _passage(self) -> float:
        """Motion of two from which on a node may pass a surface, 0 where obstacles move [m]."""
        if any(contact.search.may_move for contact in self._contacts):
            return 0.0
        return min((shortest_passage_of(each.pair) for each in self._contacts), default=math.inf)

    def free(self, moved: float) -> bool:
        """Count a step if no node moves so far that anything has to be looked at. Local.

        What would tell vertices and overlaps of each step would take longer than all looks.

        Args:
            moved: Largest motion of any node in the step, the same on all ranks [m].

        Returns:
            Whether that is so; otherwise the step is not counted.
        """
        way = 2 * moved
        if way >= self._passage:
            return False
        # The next step may be as long.
        if self._room < 2 * way:
            self.settle()
            self._room = min(self.vertices.room, self.overlaps.room)
            if self._room < 2 * way:
                return False
        self._room -= way
        self._way += way
        return True

    def settle(self) -> None:
        """Tell vertices and overlaps how far nodes have moved in steps that were free. Local."""
        if self._way:
            self.vertices.travel(self._way)
            self.overlaps.travel(self._way)
        self._way = self._room = 0.0

    def look(self, x: Floats, t: float) -> None:
        """Look for overlaps now, see `OverlapWatch.look`."""
        self.settle()
        self.overlaps.look(x, t)

    def forget(self) -> None:
        """Begin anew, as the state was set. Local."""
        self.settle()
        self.vertices.forget()

    def serialize(self, archive: Archive) -> None:
        """Serialize what is known of vertices."""
        self.settle()
        self.vertices.serialize(archive)
