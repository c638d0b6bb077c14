"""Overlap checks of a run, independent of its contact pairs."""

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cached_property
from itertools import permutations

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.checks.overlap_causes import OverlapCauses, Role
from dolfinx_nts.contact.checks.start import check_rigid_facets, deepen_search
from dolfinx_nts.contact.history import unloaded
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.overlap.overlaps import Overlap, OverlapSearch
from dolfinx_nts.search.smooth.smooth_search import depth_beneath_facets

__all__ = ["OverlapWatch"]

_logger = logging.getLogger("dolfinx_nts")

# Reporting thresholds for the overlap depth, relative to the longest facet [-]: initially (meshes
# of curved surfaces overlap by less), and for its increase in a run.
_AT_START, _IN_RUN = 0.02, 0.1
# Allowed approach of two touching bodies between checks, relative to the sum of the sizes of one
# cell of each [-], and fraction of this approach after which a check is due [-]. Closer to 1: the
# motion of all nodes is measured in more steps.
_UNSEEN, _USED = 0.7, 0.85


class OverlapWatch:
    """Overlap checks after motion, with one warning for the deepest overlap of each cause.

    A cause is reported when it is new, and again when it is deeper by a tenth of a facet or reaches
    the centres of cells; further overlaps are counted. An overlap that has been reported is
    reported again only when its depth has doubled or it reaches the centres of cells. Collective,
    as are all its methods.

    Args:
        bodies: The bodies.
        contacts: The contact pairs.
        clear: Called after a check without overlaps, with two arguments: positions, shape ``(l,
            3)`` [m], and the least approach from there by which bodies of a pair pass through each
            other [m].

    Attributes:
        is_static: Whether there is no inertia, for the remedies.
        deepest: The deepest overlap so far of each pair of bodies, by their names.
        deepest_at: Times of the deepest overlaps, by the same names [s].
    """

    is_static = False

    def __init__(
        self,
        bodies: Sequence[Body],
        contacts: Sequence[PairState],
        clear: Callable[[Floats, float], None],
    ) -> None:
        self._bodies, self._contacts, self._clear = tuple(bodies), tuple(contacts), clear
        self.deepest: dict[frozenset[str], Overlap] = {}
        self.deepest_at: dict[frozenset[str], float] = {}
        # Depth (doubled once reported) and number of cell centres of known overlaps, by names of
        # bodies.
        self._known: dict[frozenset[str], tuple[float, float]] = {}
        # The deepest reported overlap of each cause, and overlaps that are not reported yet.
        self._reported: dict[str, Overlap] = {}
        self._waiting: dict[str, list[Overlap]] = {}
        # Positions and time of the last check, whether anything has moved since, and the allowed
        # approach of any two bodies until the next check, see `OverlapSearch.approach`.
        self._seen: tuple[Floats, float] | None = None
        self._moved = False
        self._allowed: Floats = np.zeros((1, 1))
        # Remaining allowed approach of any two bodies, and bound on it in the last step.
        self._clearance, self._step = 0.0, 0.0

    @cached_property
    def search(self) -> OverlapSearch:
        """Overlap search, created at its first use."""
        segments = dict.fromkeys(contact.segments for contact in self._contacts)
        return OverlapSearch(self._bodies, [s for s in segments if isinstance(s, Obstacle)])

    @cached_property
    def _roles(self) -> list[Role]:
        """Contact pairs, with the names of the bodies of nodes and of segments."""
        names = self.search.names_of
        return [(each, names(each.nodes), names(each.segments)) for each in self._contacts]

    @cached_property
    def _causes(self) -> OverlapCauses:
        return OverlapCauses(
            self._bodies, self._roles, self.search.obstacles, is_static=self.is_static
        )

    @cached_property
    def _passing_approach(self) -> Floats:
        """Approach at which two boundaries could pass through each other, shape ``(g, g)`` [m].

        It is infinite for boundaries without a common pair.
        """
        names, thickness = self.search.names, self.search.thickness
        of: dict[str, list[int]] = {}
        for number, name in enumerate(names):
            of.setdefault(name, []).append(number)
        approach = np.full((len(names), len(names)), np.inf)
        for _, *sides in self._roles:
            i, j = ([n for name in side for n in of.get(name, [])] for side in sides)
            approach[np.ix_(i, j)] = thickness[i][:, None] + thickness[j]
        np.fill_diagonal(approach, np.inf)
        return approach

    @cached_property
    def _touches_itself_by_parts(self) -> bool:
        """Whether two surfaces of one body form a pair: overlaps are then self-overlaps."""
        return any(a & b for pair, a, b in self._roles if pair.nodes != pair.segments)

    @cached_property
    def _with_self_contact(self) -> frozenset[str]:
        """Boundaries with self-contact, by name."""
        return frozenset().union(*(a & b for _, a, b in self._roles))

    @cached_property
    def _allowed_approach(self) -> Floats:
        """Allowed approach of two touching boundaries until a check, ``(g, g)`` [m]."""
        # It is too short for bodies to pass through each other, even for bodies of one cell.
        cells = self.search.cells
        unseen = _UNSEEN * (cells[:, None] + cells)
        # The diagonal applies to self-overlaps and to obstacles, which may be thinner than a cell.
        np.fill_diagonal(unseen, np.fmin(unseen.diagonal(), self.search.extent / 2))
        return unseen

    def start(self, x: Floats, t: float) -> None:
        """Check a state that was set, and report overlaps.

        Args:
            x: Positions of the local nodes, shape ``(l, 3)`` [m].
            t: Time [s].

        Raises:
            ValueError: Bodies penetrate each other, or a `RigidSurface`, so deep that no contact
                force would act.
        """
        found = self.search.find(x, 0.0, t)
        new = self._new(x, t, _AT_START, found)
        for contact, nodes, segments in self._roles:
            check_rigid_facets(contact, self.search, nodes, t, x)
            both = (frozenset(overlap.names) for overlap in found[0])
            if not any(two & nodes and two & segments for two in both):
                contact.accept(unloaded(contact.history))
        self._moved = False
        self._known |= {names: (overlap.depth, overlap.cells) for overlap, names in new}
        self._set_initial_depths(new, x)
        # Overlaps of loaded contact that was read from a checkpoint are not reported.
        new = [each for each in new if not self._causes.is_loaded(each[0])]
        kinds = _by_kind({overlap: self._causes.at_start(overlap, x) for overlap, _ in new})
        for kind, overlaps in kinds.items():
            self._warn("", "starts", kind, overlaps)

    def _set_initial_depths(self, new: list[tuple[Overlap, frozenset[str]]], x: Floats) -> None:
        """Set the initial penetration depths of pairs."""
        starts = set().union(*(names for _, names in new)) - self.search.obstacles
        for contact in self._contacts:
            contact.set_initial_depth(0.0)
        for _, both in new:
            if len(both) < 2 or not both <= starts:
                continue
            for contact, nodes, segments in self._roles:
                for inner, outer in permutations(both):
                    if contact.may_penetrate_initially and inner in nodes and outer in segments:
                        deepen_search(contact, self.search, outer, x)

    @property
    def clearance(self) -> float:
        """Remaining approach of two bodies until a check is due [m]."""
        return self._clearance

    def travel(self, displacement: float) -> None:
        """Reduce the allowed approach by a bound on the motion [m]. Local."""
        self._clearance -= displacement
        self._moved = self._moved or displacement > 0

    def moved_far(self, displacement: float) -> bool:
        """Register an accepted step; returns whether a check is due. Local.

        Args:
            displacement: Bound on the displacement of any node or obstacle in the step, the same on
                all ranks [m].
        """
        self._step = 2 * displacement
        self.travel(self._step)
        return self._clearance < self._step

    def overlap_on_path(
        self, ends: tuple[Floats, Floats], times: tuple[float, float], displacement: float
    ) -> Overlap | None:
        """Find bodies of a pair that overlap on the straight paths of a step. Collective.

        Steps no longer than the last check allows are not checked. Others are checked at their end,
        and at intermediate positions so close that no body passes through a cell of another one.

        Args:
            ends: Positions of the local nodes at both ends of the step, ``(l, 3)`` [m].
            times: Times at both ends [s].
            displacement: Bound on the displacement of any node or obstacle in the step, the same on
                all ranks [m].

        Returns:
            Deepest new overlap that reaches the centre of a cell, at the first checked position
            that has one; None if none has.
        """
        if self._seen is None or 2 * displacement <= self._clearance:
            return None
        (x_n, x), (t_n, t) = ends, times
        nearer = self.search.approach(x, t, *self._seen)
        np.fill_diagonal(nearer, 0.0)
        if not np.any(nearer > self._allowed):
            return None
        number = int(np.ceil((nearer / self._allowed_approach).max()))
        for part in (1.0, *(np.arange(1, number) / number)):
            at = x if part == 1 else x_n + part * (x - x_n)
            overlaps, _ = self.search.find(at, 0.0, t_n + part * (t - t_n), ())
            new = [each for each in overlaps if self._is_new_between_bodies(each)]
            if new:
                return max(new, key=_relative_depth)
        return None

    def _is_new_between_bodies(self, overlap: Overlap) -> bool:
        """Whether an overlap of a pair includes centres of cells for the first time. Local."""
        known = self.deepest.get(frozenset(overlap.names))
        is_new = overlap.cells > 0 and (known is None or known.cells == 0)
        return (
            is_new
            and self._causes.between_bodies(overlap)
            and not self._causes.without_pair(overlap)
        )

    def is_pressed(self, overlap: Overlap, pressing: Collection[PairState]) -> bool:
        """Whether one of the ``pressing`` pairs, with force, is between the two bodies. Local."""
        both = set(overlap.names)
        return any(c in pressing and both <= nodes | segments for c, nodes, segments in self._roles)

    def follow(self, x: Floats, t: float) -> None:
        """Check for overlaps if bodies have moved far since the last check."""
        # The sum of steps is a crude bound, since most nodes move in the same direction. A resumed
        # run has no earlier check.
        nearer = self._allowed if self._seen is None else self.search.approach(x, t, *self._seen)
        if np.any(nearer + self._step > _USED * self._allowed):
            # During a run, self-overlaps are checked only for bodies with self contact.
            self.check(x, t, self._with_self_contact)
        else:
            self._clearance = float((self._allowed - nearer).min())

    def check(self, x: Floats, t: float, selves: Collection[str] | None = None) -> None:
        """Check the state if anything has moved, and report new overlaps.

        Args:
            x: Positions of the local nodes, shape ``(l, 3)`` [m].
            t: Time [s].
            selves: Names of the boundaries to be checked for self-overlap; None for all.
        """
        if self._moved:
            least = _IN_RUN * self.search.smallest_cell
            new = self._new(x, t, _IN_RUN, self.search.find(x, least, t, selves))
            self._moved = selves is not None
            self._known |= {names: (2 * overlap.depth, overlap.cells) for overlap, names in new}
            kinds = _by_kind({overlap: self._causes.in_run(overlap) for overlap, _ in new})
            for kind, overlaps in kinds.items():
                self._report(kind, overlaps, t)
        if selves is None:
            for kind, overlaps in self._waiting.items():
                grown = [self._deepest_so_far(overlap) for overlap in overlaps]
                self._warn(f"until t = {t:g} s, ", "was", kind, grown)
            self._waiting.clear()

    def _report(self, kind: str, overlaps: list[Overlap], t: float) -> None:
        """Report new overlaps of one cause, or postpone the report."""
        deepest, last = max(overlaps, key=_relative_depth), self._reported.get(kind)
        self._waiting.setdefault(kind, []).extend(overlaps)
        reaches_cells = any(overlap.cells for overlap in overlaps)
        if (
            last is None
            or _relative_depth(deepest) > _relative_depth(last) + _IN_RUN
            or (reaches_cells and not last.cells)
        ):
            self._reported[kind] = deepest
            self._warn(f"at t = {t:g} s, ", "is", kind, self._waiting.pop(kind))

    def _deepest_so_far(self, overlap: Overlap) -> Overlap:
        """Deepest overlap so far of the same two bodies in the same order, including this one."""
        deepest = self.deepest[frozenset(overlap.names)]
        return deepest if deepest.names == overlap.names else overlap

    def _new(
        self, x: Floats, t: float, part: float, found: tuple[list[Overlap], Floats]
    ) -> list[tuple[Overlap, frozenset[str]]]:
        """Overlaps that are deeper by a fraction of the facets, or newly reach centres of cells.

        ``found`` is the result of `OverlapSearch.find` for this fraction of the smallest cell.
        """
        new, (overlaps, apart) = [], found
        least = part * self.search.smallest_cell
        overlaps = [each for each in overlaps if each.depth > least]
        self._allowed = apart + self._allowed_approach
        self._seen, self._clearance = (x, t), float(self._allowed.min())
        if not self._touches_itself_by_parts and not any(
            self._causes.between_bodies(each) for each in overlaps
        ):
            self._clear(x, float((apart + self._passing_approach).min()))
        for overlap in overlaps:
            names = frozenset(overlap.names)
            if names not in self.deepest or overlap.depth > self.deepest[names].depth:
                self.deepest[names], self.deepest_at[names] = overlap, t
            depth, cells = self._known.get(names, (0.0, 0))
            more = overlap.depth - depth - part * overlap.size
            if (more > 0 and more > self._patch_depth(overlap, x)) or overlap.cells > 0 == cells:
                new.append((overlap, names))
        return new

    def _patch_depth(self, overlap: Overlap, x: Floats) -> float:
        """Largest depth of smooth segments below their facets, which is no overlap [m]."""
        inner, outer = overlap.names
        depths = [
            depth_beneath_facets(each.nodes, each.segments, x, overlap.depth)
            for contact, nodes, segments in self._roles
            if (inner in nodes and outer in segments) or (outer in nodes and inner in segments)
            for each in (contact, *contact.vertices)
            if isinstance(each.segments, Surface) and each.segments.smooth is True
        ]
        return max(depths, default=0.0)

    def _warn(self, when: str, verb: str, kind: str, overlaps: Sequence[Overlap]) -> None:
        """Warn of the deepest of some overlaps, and give the number of the others.

        ``kind`` is the text of their cause, which may contain the names ``{inner}`` and
        ``{outer}``. ``when`` and ``verb`` are parts of the message.
        """
        if self._bodies[0].V.mesh.comm.rank:
            return
        inner, outer = (deepest := max(overlaps, key=_relative_depth)).names
        number = len({frozenset(overlap.names) for overlap in overlaps}) - 1
        others = f", and {number} more by less" * (number > 0)
        text = f"{inner} {verb} {_described(deepest)}{others}"
        _logger.warning("%s%s: %s", when, text, kind.format(inner=inner, outer=outer))


def _by_kind(verdicts: Mapping[Overlap, str]) -> dict[str, list[Overlap]]:
    """Group overlaps by their cause."""
    kinds: dict[str, list[Overlap]] = {}
    for overlap, kind in verdicts.items():
        kinds.setdefault(kind, []).append(overlap)
    return kinds


def _relative_depth(overlap: Overlap) -> float:
    """Depth relative to the longest facet, rounded so that it is partition-independent [-]."""
    return round(overlap.depth / overlap.size, 6)


def _described(overlap: Overlap) -> str:
    """Text with the depth of an overlap and the outer body."""
    inner, outer = overlap.names
    outer = "itself" if outer == inner else outer
    return (
        f"up to {overlap.depth:.3g} m inside {outer} "
        f"({overlap.depth / overlap.size:.2g} of the longest facet; nodes inside: {overlap.nodes}, "
        f"cell centres inside: {overlap.cells})"
    )
