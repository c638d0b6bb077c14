"""The segments that the nodes of a rank can reach, and values at their vertices."""

import numpy as np
from dolfinx import common, la

from dolfinx_nts import _kernels, compat
from dolfinx_nts.common.arrays import Array, Floats, GlobalInts, Ints

__all__ = ["SegmentCandidates"]


class SegmentCandidates:
    """Segments within reach of this rank's nodes.

    Args:
        index_map: Owned nodes of the space, then the ghosts that the
            segments need.
        segments: Vertices, shape ``(s, k)``, local indices of the map.
        orientation: Shape ``(s,)``.
        key: Partition-independent number, ascending, shape ``(s,)``.
        size: Current diameters, shape ``(s,)`` [m].
        thickness: Of the cells under them, shape ``(s,)`` [m, reference].

    Attributes:
        vector: Carries values of nodes between ranks.
        shared: Owned nodes that are ghosts of other ranks.
        is_serial: Whether there are no other ranks' nodes.
    """

    def __init__(
        self,
        index_map: common.IndexMap,
        segments: Ints,
        orientation: Floats,
        key: GlobalInts,
        size: Floats,
        thickness: Floats,
    ) -> None:
        """Allocate the vector that carries values between ranks."""
        self.index_map, self.segments = index_map, segments
        self.orientation, self.key, self.size = orientation, key, size
        self.thickness = thickness
        self._kernel = _kernels.Segments(segments, orientation, key)
        self.is_serial = index_map.size_global == index_map.size_local
        self.vector = la.vector(index_map, 3)
        self.shared = compat.shared(index_map)

    def find(self, key: GlobalInts) -> Ints:
        """Local segment of each key, -1 where it is not here."""
        return self._kernel.find(key)

    @property
    def num_local(self) -> int:
        """Owned nodes and ghosts."""
        return int(self.index_map.size_local + self.index_map.num_ghosts)

    def dofs(self, nodes: Ints, segment: Ints) -> Ints:
        """Nodes of pairs in the index map, shape ``(m, 1+k)``. Local."""
        dofs = np.empty((len(nodes), 1 + self.segments.shape[1]), dtype=np.int32)
        dofs[:, 0], dofs[:, 1:] = nodes, self.segments.take(segment, axis=0)
        return dofs

    def pair(
        self,
        x: Floats,
        nodes: Ints,
        current: Ints,
        reach: float,
        slack: float = _kernels.HYSTERESIS,
    ) -> tuple[Ints, Floats]:
        """Pair nodes with segments, see `cpp/nts/search/local_search.h`. Local.

        Args:
            x: Positions with ghosts, shape ``(l, 3)`` [m].
            nodes: Nodes to be paired, shape ``(n,)``.
            current: Their last segments or -1, shape ``(n,)``.
            reach: Largest distance of interest [m].
            slack: By how much a node may be beside the last segment and
                keeps it; of half a quadrilateral, or of a triangle.

        Returns:
            Segment or -1, shape ``(n,)``, and gap [m], NaN without.
        """
        found = self._found(x, nodes, current, slack, reach)
        return found[0], found[2]

    def penalty_forces(
        self,
        x: Floats,
        numbers: Ints,
        nodes: Ints,
        current: Ints,
        reach: float,
        stiffness: Floats,
    ) -> tuple[Ints, Floats, _kernels.Springs]:
        """Springs of nodes that `pair` finds inside, see `cpp/nts/contact/springs.h`. Local.

        Args:
            x: As of `pair`, and so are ``nodes``, ``current`` and ``reach``.
            numbers: By which the springs call the nodes, shape ``(c,)``.
            nodes: Shape ``(c,)``.
            current: Shape ``(c,)``.
            reach: [m].
            stiffness: Of each spring, shape ``(c,)`` [N/m].

        Returns:
            Segments and gaps, shape ``(c,)``; springs of those with gap < 0.
        """
        segment, xi, gap, normal = self._found(x, nodes, current, _kernels.HYSTERESIS, reach)
        springs = _kernels.penalty_forces(
            numbers, nodes, segment, xi, gap, normal, self.segments, self.key, stiffness
        )
        return segment, gap, springs

    def _found(
        self, x: Floats, nodes: Ints, current: Ints, slack: float, reach: float
    ) -> tuple[Ints, Floats, Floats, Floats]:
        return self._kernel.pair(x.take(nodes, axis=0), current, slack, reach, x)

    def near(self, x: Floats, nodes: Ints, reach: float) -> Ints:
        """Nodes in the boxes around the segments. Local.

        Args:
            x: Positions with ghosts, shape ``(l, 3)`` [m].
            nodes: Nodes to choose from, shape ``(n,)``.
            reach: By how much the boxes are wider than the segments [m].

        Returns:
            Positions in ``nodes``.
        """
        return self._kernel.near(x.take(nodes, axis=0), reach, x)

    def gap(self, x: Floats, nodes: Ints, segment: Ints) -> Floats:
        """Gap of nodes to given segments, shape ``(m,)`` [m]. Local."""
        x = x.take(self.dofs(nodes, segment), axis=0)
        return _kernels.project(x, self.orientation.take(segment))[1]

    def gap_gradient(self, x: Floats, nodes: Ints, segment: Ints) -> Floats:
        """Gradient of the gap of pairs, shape ``(m, d)``. Local."""
        return _kernels.gap_gradient(x[self.dofs(nodes, segment)], self.orientation[segment])

    def contact(
        self, scheme: str, x_n: Floats, x: Floats, dofs: Ints, segment: Ints
    ) -> tuple[Array, ...]:
        """Contact of pairs between two states. Local.

        Args:
            scheme: ``"conserving"``, ``"midpoint"`` or ``"static"``.
            x_n: Positions with ghosts at t_n, shape ``(l, 3)`` [m].
            x: The same at t_{n+1}.
            dofs: Nodes of the pairs, as `dofs` returns them.
            segment: Segments of the pairs, shape ``(m,)``.

        Returns:
            gap_n and gap ``(m,)``, force and gradient ``(m, d)``, tangent
            ``(m, d, d)``, turn and status ``(m,)``; d = 3(1+k).
        """
        kernel = getattr(_kernels, f"contact_{scheme}")
        values: tuple[Array, ...] = kernel(*self._of_pairs(x_n, x, dofs, segment))
        return values

    def slip(self, x_n: Floats, x: Floats, dofs: Ints, segment: Ints) -> tuple[Array, ...]:
        """Slip of pairs between two states, see `cpp/nts/contact/slip.h`. Local."""
        pairs = self._of_pairs(x_n, x, dofs, segment)
        return *_kernels.slip(*pairs), pairs[2]

    def convective_slip(
        self, x_n: Floats, x: Floats, dofs: Ints, segment: Ints
    ) -> tuple[Array, ...]:
        """The same by coordinates, see `cpp/nts/contact/convective_slip.h`. Local."""
        pairs = self._of_pairs(x_n, x, dofs, segment)
        return *_kernels.convective_slip(*pairs), pairs[2]

    def _of_pairs(
        self, x_n: Floats, x: Floats, dofs: Ints, segment: Ints
    ) -> tuple[Floats, Floats, Floats]:
        orientation = self.orientation.take(segment)
        return x_n.take(dofs, axis=0), x.take(dofs, axis=0), orientation

    def with_ghosts(self, owned: Floats) -> Floats:
        """Owned values, then those of the ghosts. Collective.

        Args:
            owned: Values at owned nodes, shape ``(n, 3)``.

        Returns:
            Values at all nodes of the map, shape ``(n + ghosts, 3)``; the
            same array if there are no ghosts.
        """
        if self.is_serial:
            return owned
        self.vector.array[: owned.size] = owned.ravel()
        self.vector.scatter_forward()
        values: Floats = self.vector.array.reshape(-1, 3).copy()
        return values

    def add_to_owners(self, total: Floats, dofs: Ints, values: Floats) -> None:
        """Add values of some nodes to those of the owned nodes. Collective.

        Args:
            total: Values at the owned nodes, shape ``(n, 3)``.
            dofs: Nodes of the map, any shape.
            values: What is added at each, shape ``(*dofs.shape, 3)``.
        """
        if self.is_serial:
            _kernels.add_rows(total, dofs, values)
            return
        forces = self.vector.array.reshape(-1, 3)
        forces[:] = 0
        _kernels.add_rows(forces, dofs, values)
        self.vector.scatter_reverse(la.InsertMode.add)
        total += forces[: len(total)]

    def to_owners(self, values: Floats) -> Floats:
        """Add what other ranks hold for owned nodes. Collective.

        Args:
            values: Values at all nodes of the map, shape
                ``(n + ghosts, 3)``.

        Returns:
            Sums at the owned nodes, shape ``(n, 3)``.
        """
        if self.is_serial:
            return values
        self.vector.array[:] = values.ravel()
        self.vector.scatter_reverse(la.InsertMode.add)
        sums: Floats = self.vector.array.reshape(-1, 3)[: self.index_map.size_local].copy()
        return sums
