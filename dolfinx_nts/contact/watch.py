"""What a stepper watches over in contact, beside solving for it."""

from collections.abc import Sequence

from dolfinx_nts.contact.overlap_watch import OverlapWatch
from dolfinx_nts.contact.pair_state import PairState
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
