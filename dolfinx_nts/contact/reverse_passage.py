"""Vertices of segments that go through the facets of the nodes: a pair seen in reverse.

Contact of a pair holds nodes only. Vertices may sink in between the nodes, but no vertex may
come out of the other body on another side.
"""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.passage import passing_message, through_to_another_side
from dolfinx_nts.model.surfaces import Surface, diameters
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.nodal_facets import NodalFacets

__all__ = ["ReversePassages"]

_ADVICE = (
    "contact holds nodes only: let the finer surface give the nodes, or both sides "
    "(two_half_passes)"
)

# Part of the shortest passage [-] from which vertices are looked at, as the motion of all nodes
# would have to be measured in each of the next steps.
_USED = 0.75


class ReversePassages:
    """Watches the vertices of the segments of pairs from look to look. Collective.

    Several steps may lie between two looks, as long as no vertex can get through a
    body within them.

    Args:
        pairs: The pairs of a stepper.
    """

    def __init__(self, pairs: Sequence[ContactPair]) -> None:
        """Choose the pairs of two surfaces of which no other pair is the reverse."""
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
        # Positions at the last look, and a bound on the relative motion since then [m].
        self._x: Floats | None = None
        self._travelled = 0.0
        # The same if the step that was checked is accepted.
        self._checked: tuple[Floats | None, float] = None, 0.0

    def is_due(self, moved: float) -> bool:
        """Whether vertices may pass in a step in which no node moves more than given [m]. Local."""
        return bool(self._sweeps) and (
            self._x is None or self._travelled + 2 * moved > self._shortest
        )

    def check(self, x_n: Floats, x: Floats, moved: float) -> str:
        """Say which vertices come out on another side in a step, or "".

        Args:
            x_n: Positions of the local nodes of the space at its start, ``(l, 3)`` [m].
            x: The same at its end.
            moved: Largest motion of any node in the step, the same on all ranks [m].
        """
        before = x_n.copy() if self._x is None else self._x
        self._checked = before, self._travelled + 2 * moved
        if self._checked[1] <= self._shortest:
            return ""
        # The sum of steps is a crude bound, as most nodes move the same way.
        ways = [sweep.approach(before, x) for sweep in self._sweeps]
        self._checked = before, max(ways, default=0.0)
        if self._checked[1] <= _USED * self._shortest:
            return ""
        self._checked = x.copy(), 0.0
        sweeps = zip(self._sweeps, ways, strict=True)
        return next(filter(None, (sweep.passing(before, x, way) for sweep, way in sweeps)), "")

    def accept(self) -> None:
        """Go on from the step that was checked. Local."""
        self._x, self._travelled = self._checked

    def travel(self, moved: float) -> None:
        """Go on from a step for which no look was due, see `is_due`. Local."""
        self._travelled += 2 * moved

    def serialize(self, archive: Archive) -> None:
        """Serialize the last look."""
        x = None if self._x is None else [self._x, np.array(self._travelled)]
        stored = archive.local("reverse_passages", x)
        if archive.giving:
            self.forget()
            if stored is not None:
                self._x, self._travelled = stored[0], float(stored[1])


class _Sweep:
    """Vertices of one surface against the facets of another. Collective."""

    def __init__(self, vertices: Surface, facets: Surface) -> None:
        self._vertices = vertices
        self._comm: MPI.Comm = vertices.V.mesh.comm
        self._search, self._facets = GlobalSearch(vertices, facets), NodalFacets(vertices)
        # A vertex is followed on its whole way between two looks. Where it is at a look, the
        # facet by which it came in is found while it is not much deeper than a cell.
        length = diameters(facets.V.tabulate_dof_coordinates()[facets.segments])
        shortest = min(length.min(initial=np.inf), facets.thickness.min(initial=np.inf))
        self.shortest = float(reductions.least(self._comm, float(shortest)))

    def approach(self, x_n: Floats, x: Floats) -> float:
        """Bound on how much any vertex has come nearer to a facet between two states [m]."""
        return self._search.approach(x, self._search.positions(x_n))

    def passing(self, x_n: Floats, x: Floats, reach: float) -> str:
        """Say which vertices pass between two states, or ""."""
        candidates, _ = self._search.update(x_n, reach)
        points, forward = self._facets.points(x_n), candidates.scatter.forward
        passing = through_to_another_side(candidates, points, (forward(x_n), forward(x)), reach)
        ids = self._vertices.node_ids[passing]
        return passing_message(self._comm, "vertices of segments", ids, _ADVICE)
