"""Contact springs of all pairs in explicit steps."""

from collections.abc import Callable, Sequence

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.explicit.compliance import NodalProperties
from dolfinx_nts.contact.explicit.penalty import ContactSprings, SpringForces
from dolfinx_nts.contact.explicit.vertex_springs import VertexSprings
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.vertices import VertexState
from dolfinx_nts.parallel import reductions

__all__ = ["AllSprings"]

# Numbers of lost nodes, deep nodes, segments and active nodes, and the terms of a `ContactWork`.
_NUM_COUNTED = 10


class AllSprings:
    """Springs of all contact pairs, and their forces at the current state. Collective.

    Args:
        contacts: State of each contact pair.
        vertices: States of vertices on edges and corners of the pairs.
        at: Properties of the owned nodes.

    Attributes:
        pairs: Springs of each pair, and then of the vertices.
        has_friction: Whether any pair has friction.
    """

    def __init__(
        self,
        contacts: Sequence[PairState],
        vertices: Sequence[VertexState],
        at: NodalProperties,
    ) -> None:
        self._contacts = (*contacts, *vertices)
        of_pairs = {contact: ContactSprings(contact, at) for contact in contacts}
        self.pairs = [*of_pairs.values()]
        self.pairs += [VertexSprings(v, at, of_pairs[v.parent]) for v in vertices]
        self.has_friction = any(contact.pair.friction is not None for contact in contacts)
        self._forces: tuple[SpringForces, ...] = ()
        self._before: tuple[SpringForces, ...] = ()

    @property
    def obstacles_move(self) -> bool:
        """Whether obstacles move in the current step. Local."""
        return any(contact.search.frame.moves for contact in self._contacts)

    @property
    def stored(self) -> float:
        """Energy of all springs on this rank [J]. Local."""
        return sum(force.stored for force in self._forces)

    def forget(self) -> None:
        """Discard the neighbour lists after the state was set. Local."""
        for springs in self.pairs:
            springs.forget()

    def serialize(self, archive: Archive, x: Floats) -> None:
        """Serialize the last evaluation, at the positions x ``(l, 3)`` [m]."""
        forces = self._forces or (None,) * len(self.pairs)
        self._forces = tuple(
            springs.serialize(archive, f"springs_{number}", force, x)
            for number, (springs, force) in enumerate(zip(self.pairs, forces, strict=True), start=1)
        )

    def bounds(self, x: Floats, moved: float) -> list[float]:
        """Half the bound on the approach of both sides, for each pair [m]. Local.

        Args:
            x: Positions of the local nodes, shape ``(l, 3)`` [m].
            moved: Largest displacement increment of any node [m].
        """
        return [contact.search.displacement_bound(x, moved) for contact in self._contacts]

    def fast(self, bounds: Sequence[float]) -> list[tuple[ContactSprings, float]]:
        """Pairs whose nodes may pass through a surface in a step, by their `bounds`. Local."""
        both = zip(self.pairs, bounds, strict=True)
        return [
            (springs, bound)
            for springs, bound in both
            if 2 * bound > springs.shortest_passage and not isinstance(springs, VertexSprings)
        ]

    def evaluate(
        self, x_n: Floats, x: Floats, bounds: Sequence[float], total: Floats, dt: float
    ) -> None:
        """Add the contact forces at x to the forces on the owned nodes.

        Args:
            x_n: See `ContactSprings.evaluate`.
            x: See `ContactSprings.evaluate`.
            bounds: Bounds since the last evaluation, see `bounds` [m].
            total: Sum of forces, shape ``(n, d)`` [N], changed in place.
            dt: Length of the step [s].
        """
        self._before = self._forces
        self._forces = tuple(
            springs.evaluate(x_n, x, bound, dt)
            for springs, bound in zip(self.pairs, bounds, strict=True)
        )
        for force in self._forces:
            force.add_to(total)

    def counted(self, x: Floats, du: Floats, watches: Callable[[PairState], bool]) -> list[float]:
        """Counts and work terms between the last two evaluations, to be summed over ranks.

        Args:
            x: See `ContactSprings.work`.
            du: See `ContactSprings.work`.
            watches: Returns whether deep nodes of a pair are counted.

        Returns:
            Numbers of lost nodes, deep nodes, segments and active nodes, and the terms of a
            `ContactWork` on this rank.
        """
        sums = [0.0] * _NUM_COUNTED
        each = zip(self._contacts, self.pairs, self._before, self._forces, strict=True)
        for contact, springs, old, new in each:
            deep = springs.num_deep if springs.num_deep and watches(contact) else 0
            counts = springs.num_lost, deep, springs.num_segments, new.springs.num_nodes
            each_sum = zip(sums, (*counts, *springs.work(old, new, x, du)), strict=True)
            sums = [a + b for a, b in each_sum]
        return sums

    def lost(self) -> str:
        """Message naming pairs with nodes that the last evaluation lost, or ""."""
        comm = self._contacts[0].nodes.V.mesh.comm
        lost = np.array([springs.num_lost for springs in self.pairs], dtype=float)
        both = zip(self._contacts, reductions.total(comm, lost), strict=True)
        parts = [f"{n:g} between {each.pair.between} ({each})" for each, n in both if n]
        return f"nodes sank too deep into a surface, stiffer springs help: {'; '.join(parts)}"

    def accept(self) -> None:
        """Accept the contact of the last evaluation. Local."""
        for contact, force in zip(self._contacts, self._forces, strict=True):
            contact.accept(force.history)
