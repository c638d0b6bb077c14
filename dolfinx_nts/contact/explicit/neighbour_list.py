"""Neighbour list of explicit steps: nodes of a pair that may touch within the next steps.

As in molecular dynamics (Verlet), the list has a margin and is rebuilt when nodes and segments
may have approached each other by most of the margin.
"""

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Array, Flags, Floats, GlobalInts, Ints
from dolfinx_nts.contact.cell_stiffness import Layers
from dolfinx_nts.contact.enforcement import TOUCHES
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import Candidates, contact_normals
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.shared_segments import SharedSegments

__all__ = ["NeighbourList", "under_load"]

# Gap, relative to the size of a segment [-], up to which a node is paired with it.
_REACH = 0.5
# Approach of nodes and segments after which the list is rebuilt, relative to the size of a segment
# [-]. It must not be less than the reach, or deep nodes would be missing. Larger values give longer
# lists, smaller ones more searches.
_MARGIN = 0.5
# Stiffness of springs under loads above those of waves, relative to their stiffness below [-].
# Larger: nodes vibrate, as explicit steps resolve the vibration. With 1, 2.5, 3, 5 and 10 the peak
# force of a ball on a block of 6 cells is 12, 6, 5, 0 and -3 % too small; forces scatter by 0, 0.3,
# 0.4, 3 and 5 %.
_STIFFER = 2.5
# Fraction of the margin [-] after which the list is rebuilt. If it is close to 1, the motion of all
# nodes has to be measured in many steps.
_USED = 0.75


def under_load(stiffness: Floats | float, limit: Floats) -> Floats:
    """Stiffness of springs under loads above those of waves, as far as the step allows. Local.

    Args:
        stiffness: Stiffness below these loads, shape ``(n,)`` [N/m].
        limit: Largest stiffness that the step allows, shape ``(n,)`` [N/m].
    """
    loaded: Floats = np.fmax(stiffness, np.fmin(limit, _STIFFER * stiffness))
    return loaded


class NeighbourList:
    """Nodes that may touch before the list is rebuilt. Collective, as are its methods.

    A node that is equally near to several segments has a row for each of them, with equal fractions
    of its stiffness, and the mean of their gaps. Otherwise round-off or the numbering would choose
    one of them. Other nodes have one row.

    Args:
        state: State of the contact pair; the stiffness of springs must be chosen before the first
            update.
        of_cells: Upper limit of the stiffness of springs by the cells at them, infinite where there
            is none, shape ``(n,)`` [N/m]; None if springs act at points, not on areas.
        layers: Layers of cells behind the springs, if they limit the stiffness.

    Attributes:
        candidates: Candidates within the search radius.
        stiffness_fraction: Fraction of the stiffness of each spring of the surface that acts,
            constant while the spring is loaded, shape ``(n,)`` [-]: by area, and by the segments
            faced.
        area_fraction: Fraction of the area of each node of the surface on which the segments may
            press, constant while its spring is loaded, shape ``(n,)`` [-]. At edges it is less
            than 1.
        soft_depth: Compression of each spring of the surface beyond which it is stiffer, constant
            while it is loaded, shape ``(n,)`` [m].
        stiffest: Largest stiffness of each spring of the surface beyond this compression, by the
            length of the steps, shape ``(n,)`` [N/m]; None if springs stay linear.
        number: Indices of listed nodes among the nodes of the surface, ascending, shape ``(c,)``.
        points: Their contact points, with the normals of the last search.
        stiffness: Stiffness of their springs up to ``soft_depth``, shape ``(c,)`` [N/m].
        further: Additional stiffness beyond it, shape ``(c,)`` [N/m].
        current: Their current segments or -1, shape ``(c,)``; see `keep`.
        start: Offsets of the rows of each node, shape ``(m + 1,)``; None if each node has one row.
        shared: Segments of the nodes with several segments.
        is_idle: Whether no node is listed on any rank.
    """

    candidates: Candidates
    stiffness_fraction: Floats
    area_fraction: Floats
    number: Ints
    points: NodalPoints
    stiffness: Floats
    further: Floats
    current: Ints
    start: Array | None
    is_idle = False

    def __init__(
        self, state: PairState, of_cells: Floats | None, layers: Layers | None = None
    ) -> None:
        self._state, self._of_cells, self._layers = state, of_cells, layers
        self.area_fraction = self.stiffness_fraction = np.ones(len(state.nodes.nodes))
        self.soft_depth: Floats = np.full(len(state.nodes.nodes), np.inf)
        self.stiffest: Floats | None = None
        # Nodes of the rows in the last state, and their gaps [m].
        self._last: tuple[Ints, Floats] = np.empty(0, dtype=np.int32), np.empty(0)
        # Values of the candidates, and relative heights where nodes are pressed, see `Layers`.
        self._of_segments: Floats | None = None
        self._heights: Floats | None = None
        self._comm: MPI.Comm = state.nodes.V.mesh.comm
        # Positions of nodes and vertices at the last search.
        self._positions: tuple[Floats, Floats]
        # Contact points of all nodes at the last search, and indices of the listed nodes, shape
        # ``(m,)``.
        self._of_all: NodalPoints
        self._listed: Ints
        # Segments of rows with contact force in the last state, otherwise -1, shape ``(c,)``.
        self._pressed: Ints
        self.shared = SharedSegments(len(state.nodes.nodes))
        self.forget()

    def forget(self) -> None:
        """Rebuild the list at the next update, after the state was set. Local."""
        self._travelled = np.inf

    @property
    def reach(self) -> float:
        """Largest gap of listed nodes [m]. Local."""
        return _REACH * self._state.pair.segment_size + self._state.search.initial_depth

    def update(self, x: Floats, step: float) -> None:
        """Rebuild the list if other nodes than the listed ones may touch.

        Args:
            x: Positions of the local nodes of the space, shape ``(l, 3)`` [m].
            step: Half the bound on the approach of nodes and segments since the last update [m].
        """
        self._travelled += 2 * step
        margin = _MARGIN * self._state.pair.segment_size
        if self._travelled <= margin:
            return
        # The sum of steps is a crude bound, since most nodes move in the same direction.
        if np.isfinite(self._travelled):
            search = self._state.search
            self._travelled = search.approach(search.frame.at_end(x), self._positions)
        if self._travelled > _USED * margin:
            self._rebuild(x)

    def secant(self, gap: Floats) -> Floats:
        """Secant stiffness of the springs of all rows at given gaps, ``(c,)`` [N/m]. Local."""
        if self.stiffest is None:
            return self.stiffness
        depth, beyond = self._beyond(gap)
        part = np.divide(beyond, depth + beyond, out=np.zeros_like(gap), where=beyond > 0)
        secant: Floats = self.stiffness + self.further * part
        return secant

    def missing_energy(self, gap: Floats) -> Floats:
        """Energy of linear springs of the secant stiffness minus spring energy, ``(c,)`` [J]."""
        if self.stiffest is None:
            return np.zeros_like(gap)
        depth, beyond = self._beyond(gap)
        product = np.multiply(depth, beyond, out=np.zeros_like(gap), where=beyond > 0)
        missing: Floats = 0.5 * self.further * product
        return missing

    def _beyond(self, gap: Floats) -> tuple[Floats, Floats]:
        """Soft depths of all rows, and compression beyond them, ``(c,)`` [m]. Local."""
        depth = self.soft_depth[self.number]
        return depth, np.fmax(-gap - depth, 0.0)

    def keep(self, segment: Ints, gap: Floats) -> None:
        """Store segments or -1 of all rows, and which have contact, both ``(c,)``. Local."""
        self.current = segment
        self._pressed = np.where(gap < 0, segment, -1)

    def remember(self, begin_at: Floats | float, gap: Floats) -> None:
        """Store gaps of an evaluated state, see `change`, for the speeds of the next one. Local."""
        self._last = self.number, gap + begin_at

    def change(
        self, x: Floats, segment: Ints, gap: Floats, begin_at: Floats | float, dt: float
    ) -> bool:
        """Update the segments of the listed nodes. Local.

        A node that begins to transmit force, or changes its segment, gets the nearest one of the
        adjacent segments, and all that are equally near. Each segment of a node is one row.

        Args:
            x: Positions with ghosts, shape ``(l, 3)`` [m].
            segment: Segments of the rows or -1, shape ``(c,)``.
            gap: Gaps to these segments minus ``begin_at``, shape ``(c,)`` [m].
            begin_at: Gaps at which springs begin, shape ``(c,)`` [m].
            dt: Length of the step [s].

        Returns:
            Whether rows have changed, so that forces have to be evaluated again.
        """
        before, (node, last) = self._pressed, self._last
        self.keep(segment, gap)
        if np.array_equal(self._pressed, before):
            return False
        known = np.full(len(self.soft_depth), np.nan)
        known[node] = last
        # Nodes that initially touch without compression have no known speed before one step.
        approach: Floats = known[self.number] - (gap + begin_at)
        touches = np.isnan(approach) & (gap > -TOUCHES * self._state.pair.segment_size)
        self._pressed[touches] = -1
        is_new = (self._pressed != before) & (self._pressed >= 0)
        has_changed = self._begin(before, segment, np.divide(approach, dt, dtype=np.float64))
        around = self.candidates.adjacent(x) if is_new.any() else None
        first = np.arange(len(segment)) if self.start is None else self.start[:-1]
        if around is None:
            if has_changed:
                self._set_rows(segment[first])
            return has_changed
        adjacent, vertices = around
        (place,) = np.logical_or.reduceat(is_new, first).nonzero()
        node, found = self._listed[place], segment[first[place]]
        points = self._of_all.take(node)
        none = np.full(len(node), -1, dtype=np.int32)
        nearest, _ = self.candidates.pair(points, x, none, self.reach)
        is_next = nearest >= 0
        is_next[is_next] = adjacent.have_common_vertices(found[is_next], nearest[is_next])
        own = np.where(is_next, nearest, found)
        row, facet = adjacent.as_near(points.of(x), vertices, own, self.candidates.size[own])
        is_same = not (len(row) or self.shared.many[node].any() or np.any(own != found))
        if is_same and not has_changed:
            return False
        self.shared.replace(node, row, facet)
        of_nodes = segment[first]
        of_nodes[place] = own
        self._set_rows(of_nodes)
        return True

    def _begin(self, before: Ints, segment: Ints, speed: Floats) -> bool:
        """Set the springs of nodes that begin to transmit force, by the segments faced. Local.

        Arguments as for `change`, with the segments that transmitted force ``before``, and the
        speeds of approach, shape ``(c,)`` [m/s], NaN if they are not known. Returns whether springs
        have changed.
        """
        layers = self._layers
        if layers is None:
            return False
        row = np.flatnonzero((before < 0) & (self._pressed >= 0))
        row = row[~np.isin(self.number[row], self.number[before >= 0])]
        if not len(row):
            return False
        node, first = np.unique(self.number[row], return_index=True)
        faced = None
        # Histories keep the former arrays.
        fraction, depth = self.stiffness_fraction.copy(), self.soft_depth.copy()
        if self._of_segments is not None and self._of_cells is not None:
            faced = np.full((len(fraction), self._of_segments.shape[1]), np.inf)
            np.minimum.at(faced, self.number[row], self._of_segments[segment[row]])
            of_layers = layers.stiffness_fraction(faced, self._heights, in_series=True)
            fraction[node] = (self.area_fraction * of_layers)[node]
        if self.stiffest is not None:
            # Springs that are loaded by a displacement set by the user had no impact: NaN.
            arriving = np.maximum(speed[row[first]], 0.0)
            force = (layers.soft_pressure(faced) * layers.area * self.area_fraction)[node]
            soft = self._stiffness(node, fraction)
            depth[node] = np.divide(
                force * arriving,
                soft,
                out=np.full_like(soft, np.inf),
                where=np.isfinite(force) & np.isfinite(arriving) & (soft > 0),
            )
        old = self.stiffness_fraction, self.soft_depth
        self.stiffness_fraction, self.soft_depth = fraction, depth
        pairs = zip(old, (fraction, depth), strict=True)
        return not all(np.array_equal(a[node], b[node]) for a, b in pairs)

    def _set_rows(self, segment: Ints) -> None:
        """Set the rows of listed nodes; ``segment``, ``(m,)``, applies to nodes with one row."""
        number, start = self._listed, None
        self.stiffness = self._stiffness(number, self.stiffness_fraction)
        self.further = np.zeros_like(self.stiffness)
        if self.stiffest is not None:
            self.further = under_load(self.stiffness, self.stiffest[number]) - self.stiffness
        if self.shared.many.any():
            row, segment, start = self.shared.entries(number, segment)
            counts = np.diff(start)
            self.stiffness = (self.stiffness / counts)[row]
            self.further = (self.further / counts)[row]
            number = number[row]
        self.number, self.current, self.start = number, segment, start
        self.points = self._of_all.take(number)

    def _stiffness(self, node: Ints, fraction: Floats) -> Floats:
        """Stiffness of the springs of some nodes up to their soft depth, ``(m,)`` [N/m]. Local.

        ``fraction`` is the active fraction of the stiffness of cells, at all nodes, ``(n,)`` [-].
        """
        eps_N = self._state.eps_N
        assert eps_N is not None
        if self._of_cells is None:
            return eps_N[node]
        return np.minimum(eps_N[node], fraction[node] * self._of_cells[node])

    def serialize(self, archive: Archive, name: str, x: Floats) -> None:
        """Serialize the list, by positions as of `update`. Collective."""
        keys = self._serialized_shared(archive, f"{name}/shared")
        ids = self._state.nodes.node_ids
        self.area_fraction = archive.nodal(f"{name}/area_fraction", ids, self.area_fraction)
        if archive.same(f"{name}/is_stiffer", self.stiffest is not None):
            stiffest = self.area_fraction if self.stiffest is None else self.stiffest
            self.stiffest = archive.nodal(f"{name}/stiffest", ids, stiffest)
        arrays: Sequence[Any] | None = None
        if not archive.restores and np.isfinite(self._travelled):
            numbers = np.array([self._travelled, self.is_idle])
            arrays = [self._listed, numbers, *self._positions]
        arrays = archive.local(name, arrays)
        if not archive.restores:
            return
        if arrays is None:
            self._rebuild(x, keys)
            return
        listed, (travelled, is_idle), nodes, vertices = arrays
        self._travelled, self.is_idle = float(travelled), bool(is_idle)
        self._positions = nodes, vertices
        candidates = self._state.search.candidates
        self._take_history()
        if self._layers is not None:
            self._of_segments = self._layers.of_candidates(candidates)
        points = self._state.facets.points(self._state.search.frame.at_end(x))
        current = candidates.find(self._state.history.key)
        self._choose(candidates, points, listed, current, keys)
        self._set_pressing(self._state.history.active)

    def _serialized_shared(self, archive: Archive, name: str) -> tuple[Ints, GlobalInts]:
        """Serialize nodes with several segments; return them and the keys of their segments."""
        ids, (node, key) = self._state.nodes.node_ids, self._shared_keys()
        counts = np.bincount(node, minlength=len(ids))
        width = int(counts.max(initial=0))
        width = archive.same(f"{name}_width", int(reductions.largest(self._comm, float(width))))
        if not width:
            return node, key
        keys: GlobalInts = np.full((len(ids), width), -1, dtype=np.int64)
        if not archive.restores:
            keys[node, np.arange(len(node)) - np.searchsorted(node, node)] = key
        keys = archive.nodal(name, ids, keys)
        number, column = np.nonzero(keys >= 0)
        return number.astype(np.int32), keys[number, column]

    def _shared_keys(self) -> tuple[Ints, GlobalInts]:
        """Nodes with several segments, and keys of these segments, both ``(i,)``."""
        shared = self.shared
        key = self.candidates.key[shared.segment] if len(shared.node) else np.empty(0, np.int64)
        return shared.node, key

    def _rebuild(self, x: Floats, keys: tuple[Ints, GlobalInts] | None = None) -> None:
        state, margin = self._state, _MARGIN * self._state.pair.segment_size
        if keys is None:
            keys = self._shared_keys()
        x_in_space, x = x, state.search.frame.at_end(x)
        candidates, _ = state.search.update(x, self.reach + margin)
        if np.isinf(self._travelled):
            current = candidates.find(state.history.key)
            pressed = state.history.active
            self._take_history()
        else:
            current = np.full(len(state.nodes.nodes), -1, dtype=np.int32)
            current[self.number] = self._current_in(candidates)
            pressed = np.zeros(len(current), dtype=bool)
            pressed[self.number[self._pressed >= 0]] = True
        self._travelled, self._positions = 0.0, state.search.positions(x)
        points, x = state.facets.points(x), candidates.scatter.forward(x)
        near = candidates.near(points, x, margin + state.search.initial_depth)
        if self._layers is not None:
            self._of_segments = self._layers.of_candidates(candidates)
        if self._of_cells is not None and state.facets.has_edges:
            none = np.full(len(near), -1, dtype=np.int32)
            segment, _ = candidates.pair(points.take(near), x, none, self.reach + margin)
            node, segment = near[segment >= 0], segment[segment >= 0]
            normal = np.zeros((len(current), 3))
            normal[node] = contact_normals(candidates, points.take(node), x, segment)
            arriving, self._heights = state.facets.pressed_layers(x_in_space, normal)
            self.area_fraction = np.where(pressed, self.area_fraction, arriving)
            if self._layers is not None:
                of_layers = self._layers.stiffness_fraction(None, self._heights, in_series=True)
                arriving = arriving * of_layers
            self.stiffness_fraction = np.where(pressed, self.stiffness_fraction, arriving)
        self._choose(candidates, points, near, current, keys)
        self._set_pressing(pressed)
        self.is_idle = not reductions.total(self._comm, len(near))

    def _take_history(self) -> None:
        """Take the springs and gaps of the accepted state. Local."""
        history = self._state.history
        self.stiffness_fraction, self.soft_depth = history.part, history.soft_depth
        self._last = np.arange(len(history.gap), dtype=np.int32), history.gap

    def _set_pressing(self, pressed: Flags) -> None:
        """Set flags of the nodes that transmitted force in the last state, ``(n,)``."""
        self._pressed = np.where(pressed[self.number], self.current, -1)

    def _current_in(self, candidates: Candidates) -> Ints:
        """Last segments of all rows as candidate numbers, or -1, shape ``(c,)``."""
        if candidates is self.candidates:
            return self.current
        found = self.current >= 0
        segment: Ints = np.full(len(found), -1, dtype=np.int32)
        segment[found] = candidates.find(self.candidates.key[self.current[found]])
        return segment

    def _choose(
        self,
        candidates: Candidates,
        points: NodalPoints,
        number: Ints,
        current: Ints,
        keys: tuple[Ints, GlobalInts],
    ) -> None:
        """List nodes of the surface by ``number``, with their last segments or -1."""
        self.candidates, self._of_all, self._listed = candidates, points, number
        node, key = keys
        if len(node) or len(self.shared.node):
            segment = candidates.find(key)
            kept = np.isin(node, number) & ~np.isin(node, node[segment < 0])
            self.shared = SharedSegments(len(self.shared.many))
            several = np.unique(node[kept])
            place = np.searchsorted(several, node[kept]).astype(np.int32)
            self.shared.replace(several, place, segment[kept])
        self._set_rows(current[number])
