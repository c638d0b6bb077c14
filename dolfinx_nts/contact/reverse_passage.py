"""Vertices of segments that go through the facets of the nodes: a pair seen in reverse.

Contact of a pair holds nodes only. Vertices may sink in between the nodes, but no vertex may
come out of the other body on another side.
"""

from collections.abc import Sequence
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.passage import passing_message, through_to_another_side
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.closed_boundaries import outward_triangles, triangles_at
from dolfinx_nts.model.segments import diameters
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.nodal_facets import NodalFacets
from dolfinx_nts.search.thickness import least_thickness

__all__ = ["ReversePassages"]

_ADVICE = (
    "contact holds nodes only: let the finer surface give the nodes, or both sides "
    "(two_half_passes, or one surface of both bodies that touches itself)"
)

# Part of the shortest passage [-] from which vertices are looked at, as the motion of all nodes
# would have to be measured in each of the next steps. It is more than that of `OverlapWatch`,
# which may come first.
_USED = 0.95
# Part of the thickness of a body [-] to which the motion between two looks is limited, so that
# ways between them are nearly straight, and how many such parts the ways may have that are
# followed to the end.
_STRAIGHT, _WHOLE = 0.5, 2.0


class _Look(NamedTuple):
    """Positions ``(l, 3)`` at a look, the way since then, and how long it may be [m]."""

    x: Floats | None
    way: float
    room: float


class ReversePassages:
    """Watches the vertices of the segments of pairs from look to look. Collective.

    Several steps may lie between two looks, as long as no vertex can get through a
    body within them: whoever sees that bodies do not overlap may `clear` what was before.

    Args:
        pairs: The pairs of a stepper.
    """

    def __init__(self, pairs: Sequence[ContactPair]) -> None:
        pairs = [pair for pair in pairs if pair.method != EDGES]  # of nodes and vertices
        both = {(pair.nodes, pair.segments) for pair in pairs}
        self._sweeps = [
            _Sweep(pair.segments, pair.nodes)
            for pair in pairs
            if isinstance(pair.segments, Surface) and (pair.segments, pair.nodes) not in both
        ]
        self._shortest = min((sweep.shortest for sweep in self._sweeps), default=np.inf)
        self.forget()

    def forget(self) -> None:
        """Begin anew, as the state was set. Local."""
        # Positions at the last look, a bound on the relative motion since then, and up to which
        # no vertex can have passed [m]; and the same if the step that was checked is accepted.
        self._last = self._checked = _Look(None, 0.0, self._shortest)

    def clear(self, x: Floats, room: float) -> None:
        """Go on from positions in which bodies do not overlap. Local.

        Args:
            x: The positions, shape ``(l, 3)`` [m].
            room: How far those of any pair have to come nearer from there to pass through each
                other [m].
        """
        self._last = _Look(x, 0.0, max(room, self._shortest))

    def check(self, x_n: Floats, x: Floats, moved: float) -> str:
        """Say which vertices come out on another side in a step, or "".

        Args:
            x_n: Positions of the local nodes of the space at its start, ``(l, 3)`` [m].
            x: The same at its end.
            moved: Largest motion of any node in the step, the same on all ranks [m].
        """
        before, way, room = self._last
        before = x_n.copy() if before is None else before
        self._checked = _Look(before, way + 2 * moved, room)
        if self._checked.way <= room:
            return ""
        # The sum of steps is a crude bound, as most nodes move the same way.
        ways = [sweep.approach(before, x) for sweep in self._sweeps]
        farthest = max(ways, default=0.0)
        self._checked = _Look(before, farthest, room)
        if farthest <= _USED * room:
            return ""
        found = [sweep.passing(before, x, w) for sweep, w in zip(self._sweeps, ways, strict=True)]
        # What is deep inside is followed on its whole way, but not beyond the other side.
        stays = any(is_deep for _, is_deep in found) and farthest <= _WHOLE * self._shortest
        self._checked = _Look(before if stays else x.copy(), 0.0, self._shortest)
        return next(filter(None, (text for text, _ in found)), "")

    def accept(self) -> None:
        """Go on from the step that was checked. Local."""
        self._last = self._checked

    @property
    def room(self) -> float:
        """By how much vertices and facets may come nearer until a step has to be checked [m]."""
        x, way, room = self._last
        if not self._sweeps:
            return np.inf
        return 0.0 if x is None else room - way

    def travel(self, way: float) -> None:
        """Count by how much vertices and facets may have come nearer, which the room has. Local."""
        self._last = self._last._replace(way=self._last.way + way)

    def serialize(self, archive: Archive) -> None:
        """Serialize the last look."""
        x, *bounds = self._last
        stored = archive.local("reverse_passages", None if x is None else [x, np.array(bounds)])
        if archive.giving:
            self.forget()
            if stored is not None:
                self._last = _Look(stored[0], *map(float, stored[1]))


class _Sweep:
    """Vertices of one surface against the facets of another. Collective."""

    def __init__(self, vertices: Surface, facets: Surface) -> None:
        self._vertices = vertices
        self._comm: MPI.Comm = vertices.V.mesh.comm
        self._search, self._facets = GlobalSearch(vertices, facets), NodalFacets(vertices)
        # A vertex is followed on its whole way between two looks, and has to go through the body.
        X = reference_positions(facets.V)
        length = diameters(X[facets.segments])
        shortest = min(length.min(initial=np.inf), facets.thickness.min(initial=np.inf))
        triangles = outward_triangles(facets.segments, facets.orientation)
        wall = least_thickness(self._comm, triangles_at(self._comm, X, triangles))
        cell = float(reductions.least(self._comm, float(shortest)))
        self.shortest = max(cell, _STRAIGHT * wall)

    def approach(self, x_n: Floats, x: Floats) -> float:
        """Bound on how much any vertex has come nearer to a facet between two states [m]."""
        return self._search.approach(x, self._search.positions(x_n))

    def passing(self, x_n: Floats, x: Floats, reach: float) -> tuple[str, bool]:
        """Say which vertices pass between two states, or "", and whether others are deep inside."""
        candidates, _ = self._search.update(x_n, reach)
        points, forward = self._facets.points(x_n), candidates.scatter.forward
        ends = forward(x_n), forward(x)
        passing, is_deep = through_to_another_side(candidates, points, ends, reach)
        ids = self._vertices.node_ids[passing]
        text = passing_message(self._comm, "vertices of segments", ids, _ADVICE)
        return text, reductions.anywhere(self._comm, is_deep)
