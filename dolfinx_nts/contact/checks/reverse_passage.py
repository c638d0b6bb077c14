"""Pass-through check of the vertices of segments.

Contact of a pair constrains only its nodes. Vertices may penetrate between the nodes, but must not
leave the other body on another side.
"""

from collections.abc import Sequence
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.checks.passage import passing_message, through_to_another_side
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.closed_boundaries import outward_triangles, triangles_at
from dolfinx_nts.model.segments import diameters
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.model.thickness import least_thickness
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.nodal_facets import NodalFacets

__all__ = ["ReversePassages"]

_ADVICE = (
    "contact holds nodes only: let the finer surface give the nodes, or both sides "
    "(two_half_passes, or one surface of both bodies that touches itself)"
)

# Fraction of the allowed motion [-] after which vertices are checked. Closer to 1: the motion of
# all nodes is measured in more steps. It exceeds the fraction of `OverlapWatch`, whose check may
# make this one unnecessary.
_USED = 0.95
# Largest motion between two checks relative to the thickness of a body [-], for nearly straight
# paths; largest length of a path that is followed, relative to the shortest passage [-].
_STRAIGHT, _WHOLE = 0.5, 2.0


class _SinceCheck(NamedTuple):
    """Positions ``(l, 3)`` at a check, motion since then, and its limit [m]."""

    x: Floats | None
    approach: float
    limit: float


class ReversePassages:
    """Pass-through checks of the vertices of the segments of pairs. Collective.

    Several steps may lie between two checks, as long as no vertex can pass through a body within
    them. After an overlap check without findings, `clear` discards the earlier motion.

    Args:
        pairs: The pairs of a stepper.
    """

    def __init__(self, pairs: Sequence[ContactPair]) -> None:
        pairs = [pair for pair in pairs if pair.method != EDGES]  # edges have no vertices
        both = {(pair.nodes, pair.segments) for pair in pairs}
        self._sweeps = [
            _Sweep(pair.segments, pair.nodes)
            for pair in pairs
            if isinstance(pair.segments, Surface) and (pair.segments, pair.nodes) not in both
        ]
        self._shortest = min((sweep.shortest for sweep in self._sweeps), default=np.inf)
        self.forget()

    def forget(self) -> None:
        """Discard earlier motion, after the state was set. Local."""
        # Data of the last check, and data that replace them once the checked step is accepted.
        self._last = self._checked = _SinceCheck(None, 0.0, self._shortest)

    def clear(self, x: Floats, limit: float) -> None:
        """Restart from positions without overlaps. Local.

        Args:
            x: The positions, shape ``(l, 3)`` [m].
            limit: Least approach from there by which bodies of a pair pass through each other [m].
        """
        self._last = _SinceCheck(x, 0.0, max(limit, self._shortest))

    def check(self, x_n: Floats, x: Floats, moved: float) -> str:
        """Message naming vertices that pass through a body in a step, or "".

        Args:
            x_n: Positions of the local nodes of the space at its start, ``(l, 3)`` [m].
            x: Positions at its end, shape ``(l, 3)`` [m].
            moved: Largest displacement increment of any node, the same on all ranks [m].
        """
        before, approach, limit = self._last
        before = x_n.copy() if before is None else before
        self._checked = _SinceCheck(before, approach + 2 * moved, limit)
        if self._checked.approach <= limit:
            return ""
        # The sum of steps is a crude bound, since most nodes move in the same direction.
        approaches = [sweep.approach(before, x) for sweep in self._sweeps]
        farthest = max(approaches, default=0.0)
        self._checked = _SinceCheck(before, farthest, limit)
        if farthest <= _USED * limit:
            return ""
        found = [
            sweep.passing(before, x, each)
            for sweep, each in zip(self._sweeps, approaches, strict=True)
        ]
        # The paths of deep vertices are continued, until they are outside again.
        stays = any(is_deep for _, is_deep in found) and farthest <= _WHOLE * self._shortest
        self._checked = _SinceCheck(before if stays else x.copy(), 0.0, self._shortest)
        return next(filter(None, (text for text, _ in found)), "")

    def accept(self) -> None:
        """Accept the checked step. Local."""
        self._last = self._checked

    @property
    def clearance(self) -> float:
        """Allowed approach of vertices and facets until the next check [m]."""
        x, approach, limit = self._last
        if not self._sweeps:
            return np.inf
        return 0.0 if x is None else limit - approach

    def travel(self, approach: float) -> None:
        """Add a bound on the approach of vertices and facets within `clearance` [m]. Local."""
        self._last = self._last._replace(approach=self._last.approach + approach)

    def serialize(self, archive: Archive) -> None:
        """Serialize the last check."""
        x, *bounds = self._last
        stored = archive.local("reverse_passages", None if x is None else [x, np.array(bounds)])
        if archive.restores:
            self.forget()
            if stored is not None:
                self._last = _SinceCheck(stored[0], *map(float, stored[1]))


class _Sweep:
    """Vertices of one surface against the facets of another. Collective."""

    def __init__(self, vertices: Surface, facets: Surface) -> None:
        self._vertices = vertices
        self._comm: MPI.Comm = vertices.V.mesh.comm
        self._search, self._facets = GlobalSearch(vertices, facets), NodalFacets.of(vertices)
        # The path between two checks is followed: only a path through the whole body could be
        # missed.
        X = reference_positions(facets.V)
        length = diameters(X[facets.segments])
        shortest = min(length.min(initial=np.inf), facets.thickness.min(initial=np.inf))
        triangles = outward_triangles(facets.segments, facets.orientation)
        wall = least_thickness(self._comm, triangles_at(self._comm, X, triangles))
        cell = float(reductions.least(self._comm, float(shortest)))
        self.shortest = max(cell, _STRAIGHT * wall)

    def approach(self, x_n: Floats, x: Floats) -> float:
        """Bound on the approach of any vertex and facet between two states [m]."""
        return self._search.approach(x, self._search.positions(x_n))

    def passing(self, x_n: Floats, x: Floats, reach: float) -> tuple[str, bool]:
        """Message naming vertices that pass through, or ""; whether other vertices are deep."""
        candidates, _ = self._search.update(x_n, reach)
        points, forward = self._facets.points(x_n), candidates.scatter.forward
        ends = forward(x_n), forward(x)
        passing, is_deep = through_to_another_side(candidates, points, ends, reach)
        ids = self._vertices.node_ids[passing]
        text = passing_message(self._comm, "vertices of segments", ids, _ADVICE)
        return text, reductions.anywhere(self._comm, is_deep)
