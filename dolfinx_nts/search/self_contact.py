"""Contact of a surface with itself: search that leaves out neighbours.

What a node may touch is decided by normals, by the thickness of the cells
and by the positions at rest, see `cpp/nts/search/self_contact.h`.

Multipliers on a surface that touches itself: which nodes may have one.

Where both sides touch with their nodes there would be twice as many
constraints as there is room for, and a node that gives up its displacement
would be asked for it by another. So no node that may have a multiplier is a
vertex of the segment of another one. All others are held by these: a segment
on which they are, or their own, has a vertex with a multiplier.
"""

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.model.surfaces import Surface, area_vectors
from dolfinx_nts.search.candidates import SegmentCandidates
from dolfinx_nts.search.global_search import GlobalSearch

__all__ = ["SelfContactCandidates", "SelfContactSearch", "independent_nodes"]


class SelfContactCandidates(SegmentCandidates):
    """Segments of a surface within reach of its own nodes. Collective.

    Args:
        candidates: The segments; among them all those around this rank's nodes.
        X: Positions at rest of the owned nodes, shape ``(n, 3)`` [m].
    """

    def __init__(self, candidates: SegmentCandidates, X: Floats) -> None:
        """Fetch the positions at rest."""
        super().__init__(
            candidates.index_map,
            candidates.segments,
            candidates.orientation,
            candidates.key,
            candidates.size,
            candidates.thickness,
        )
        self._X = self.with_ghosts(X)
        self._N = self._normals(self._X)

    def _found(
        self, x: Floats, nodes: Ints, current: Ints, slack: float, reach: float
    ) -> tuple[Ints, Floats, Floats, Floats]:
        return self._kernel.pair_own(
            x[nodes],
            current,
            slack,
            reach,
            x,
            self._normals(x)[nodes],
            self._X[nodes],
            self._N[nodes],
            self._X,
            self.thickness,
        )

    def _normals(self, x: Floats) -> Floats:
        """Normals of the surface, of any length; right at owned nodes."""
        normals = np.zeros_like(x)
        areas = area_vectors(x[self.segments], self.orientation)
        for vertex in self.segments.T:
            np.add.at(normals, vertex, areas)
        return normals


class SelfContactSearch(GlobalSearch):
    """Keeps the neighbourhood of a surface with itself up to date."""

    def _exchange(self, x: Floats, reach: float) -> SelfContactCandidates:
        X = self._nodes.V.tabulate_dof_coordinates()
        num_owned = self._nodes.V.dofmap.index_map.size_local
        return SelfContactCandidates(super()._exchange(x, reach), X[:num_owned])


def independent_nodes(
    candidates: SegmentCandidates,
    surface: Surface,
    segment: Ints,
    eligible: Flags,
    urgency: GlobalInts,
) -> Flags:
    """Nodes of which none is a vertex of the segment of another. Collective.

    Each in turn is taken unless one of those before forbids it: the most
    urgent first, of these the lowest number in the mesh, so that the choice
    does not depend on the partition.

    Args:
        candidates: Segments in reach.
        surface: The surface.
        segment: Segment of each node or -1, shape ``(n,)``.
        eligible: Nodes that have a segment and may be taken, ``(n,)``.
        urgency: What comes first, shape ``(n,)``.

    Returns:
        Flags, shape ``(n,)``.
    """
    node = np.flatnonzero(eligible)
    dofs = candidates.dofs(surface.nodes[node], segment[node])
    ids = candidates.index_map.local_to_global(dofs.ravel()).reshape(dofs.shape)
    order = np.column_stack([-urgency[node], surface.node_ids[node], ids])
    everywhere = np.concatenate(surface.V.mesh.comm.allgather(order))
    everywhere = everywhere[np.lexsort((everywhere[:, 1], everywhere[:, 0]))]
    taken: set[int] = set()
    covered: set[int] = set()  # vertices of the segments of taken nodes
    for first, *vertices in everywhere[:, 2:].tolist():
        if first not in covered and taken.isdisjoint(vertices):
            taken.add(first)
            covered.update(vertices)
    flags: Flags = np.zeros_like(eligible)
    flags[node] = [first in taken for first in ids[:, 0].tolist()]
    return flags
