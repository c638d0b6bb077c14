"""Contact of one pair of surfaces: laws, stiffness of springs, gaps.

The work within a step is done by `ContactStep`; only an accepted step
replaces a pair's history.
"""

import logging
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arguments import as_call
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.enforcement import LagrangeMultiplier, Penalty
from dolfinx_nts.contact.friction import Coulomb
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.fem.node_numbering import listed
from dolfinx_nts.model.obstacles import Obstacle
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.obstacle_candidates import ObstacleCandidates
from dolfinx_nts.search.self_contact import SelfContactSearch

__all__ = ["ContactPair"]


_logger = logging.getLogger("dolfinx_nts")

# Of the size of a segment: meshes of curved surfaces overlap by less.
_OVERLAP = 0.02
# Sine of the angle at a corner from which there is a normal, but for rounding.
_SHARP = 1e-8


class ContactPair:
    """Nodes of one surface against segments of another, or an obstacle.

    A surface may be both: then it touches itself. A node touches segments
    that face it, but no neighbours on the mesh, nor the other side of its own
    wall (`cpp/nts/search/self_contact.h`); it must not move by more than a cell of the
    wall in a step. Springs act from both sides; multipliers go to nodes of
    which none is a vertex of the segment of another (`independent_nodes`).

    Collective. ``str`` tells the laws and, after the first step, the least
    and the greatest stiffness of springs, given or derived.

    Args:
        nodes: Surface whose nodes may touch.
        segments: Surface whose segments are touched, or a rigid obstacle.
        enforcement: How contact is enforced; by default multipliers
            with elastic impact.
        friction: Law of friction; None: none.

    Attributes:
        eps_N: Stiffness of the penalty springs, shape ``(n,)`` [N/m], from
            the first step on; None without.
        eps_T: The same of the tangential springs.
        touches_itself: Whether both are the same surface.

    Raises:
        TypeError: An argument has the wrong type.
        ValueError: The surfaces belong to different spaces, or share
            some of their nodes; convective friction without what it needs.
    """

    def __init__(
        self,
        nodes: Surface,
        segments: Surface | Obstacle,
        enforcement: LagrangeMultiplier | Penalty | None = None,
        friction: Coulomb | None = None,
    ) -> None:
        """Check the surfaces and start without contact."""
        if not isinstance(nodes, Surface):
            raise TypeError(f"expected a Surface as nodes, given {type(nodes).__name__}")
        if not isinstance(segments, Surface | Obstacle):
            raise TypeError(
                f"expected a Surface or an obstacle as segments, given {type(segments).__name__}"
            )
        enforcement = LagrangeMultiplier() if enforcement is None else enforcement
        if not isinstance(enforcement, LagrangeMultiplier | Penalty):
            raise TypeError(
                "expected LagrangeMultiplier or Penalty as enforcement, "
                f"given {type(enforcement).__name__}"
            )
        if not (friction is None or isinstance(friction, Coulomb)):
            raise TypeError(f"expected Coulomb as friction, given {type(friction).__name__}")
        convective = friction is not None and friction.law == "convective"
        if convective and not (isinstance(enforcement, Penalty) and isinstance(segments, Surface)):
            raise ValueError(
                "expected Penalty and a Surface as segments with convective friction, given "
                f"{type(enforcement).__name__} and {type(segments).__name__}"
            )
        self.touches_itself = isinstance(segments, Surface) and _check_surfaces(nodes, segments)
        self.nodes, self.segments = nodes, segments
        self.enforcement = enforcement
        # Without friction there is no slip to follow.
        self.friction = friction if friction is not None and friction.mu > 0 else None
        self.search, self._everywhere = self._new_search(), self._new_search()
        self._history: ContactHistory | Callable[[], ContactHistory]
        self._history = ContactHistory.none(len(nodes.nodes))
        self.eps_N: Floats | None = None
        self.eps_T: Floats | None = None
        self._springs: dict[str, tuple[float, float]] | None = None

    def _new_search(self) -> GlobalSearch | ObstacleCandidates:
        if isinstance(self.segments, Obstacle):
            return ObstacleCandidates(self.segments, self.nodes)
        search = SelfContactSearch if self.touches_itself else GlobalSearch
        return search(self.nodes, self.segments)

    @property
    def history(self) -> ContactHistory:
        """Accepted contact; may be set to a function that makes it when asked. Local."""
        if not isinstance(self._history, ContactHistory):
            self._history = self._history()
        return self._history

    @history.setter
    def history(self, history: ContactHistory | Callable[[], ContactHistory]) -> None:
        self._history = history

    @property
    def segment_size(self) -> float:
        """Longest segment [m]; for an obstacle, of the nodes' surface."""
        return (self.segments if isinstance(self.segments, Surface) else self.nodes).size

    @property
    def has_slip_spring(self) -> bool:
        """Whether friction stores elastic slip."""
        return self.friction is not None and (
            self.friction.eps_T is not None or isinstance(self.enforcement, Penalty)
        )

    @property
    def is_convective(self) -> bool:
        """Whether slip is measured by convective coordinates."""
        return self.friction is not None and self.friction.law == "convective"

    def derive_stiffness(self, stiffness: Floats) -> None:
        """Settle the stiffness of the springs, once. Collective.

        By that of the softer side: a stiff node cannot press harder than
        soft segments, and stiffer springs only spoil Newton's method.

        Args:
            stiffness: Stiffness of all owned nodes of the space, ``(n,)``
                [N/m].
        """
        if self._springs is not None:
            return
        softer = stiffness[self.nodes.nodes]
        if isinstance(self.segments, Surface):
            there = stiffness[self.segments.nodes].max(initial=0.0)
            comm = self.nodes.V.mesh.comm
            softer = np.minimum(softer, reductions.largest(comm, float(there)))
        self.fix_stiffness(softer)

    def fix_stiffness(self, stiffness: Floats) -> None:
        """Settle the stiffness of the springs, once; log it. Collective.

        Args:
            stiffness: What is taken for that of the contact nodes, ``(n,)``
                [N/m].
        """
        if self._springs is not None:
            return
        self._springs, share = {}, 1.0
        if isinstance(self.enforcement, Penalty):
            given, share = self.enforcement.eps_N, self.enforcement.share
            self.eps_N = share * (
                10 * stiffness if given is None else np.full_like(stiffness, given)
            )
            self._springs["eps_N"] = self._range(self.eps_N)
        if self.friction is not None and self.has_slip_spring:
            given = self.friction.eps_T
            self.eps_T = share * (stiffness if given is None else np.full_like(stiffness, given))
            self._springs["eps_T"] = self._range(self.eps_T)
        if self.nodes.V.mesh.comm.rank == 0:
            _logger.info("%s", self)

    def _range(self, stiffness: Floats) -> tuple[float, float]:
        """Least and greatest value on all ranks."""
        comm = self.nodes.V.mesh.comm
        least = reductions.least(comm, float(stiffness.min(initial=np.inf)))
        return least, reductions.largest(comm, float(stiffness.max(initial=0.0)))

    def __repr__(self) -> str:
        """Arguments, one line. Local."""
        return as_call(
            self,
            nodes=self.nodes,
            segments=self.segments,
            enforcement=self.enforcement,
            friction=self.friction,
        )

    def __str__(self) -> str:
        """Laws and the stiffness of springs, as used from the first step on. Local."""
        text = f"contact by {type(self.enforcement).__name__}"
        if self.friction is not None:
            text += f", Coulomb friction with mu = {self.friction.mu:g}"
        for name, (least, greatest) in (self._springs or {}).items():
            values = f"{least:.3g}" + (f" to {greatest:.3g}" if greatest > least else "")
            text += f", {name} = {values} N/m"
        return text

    def check_start(self, x: Floats) -> None:
        """Raise on all ranks if nodes lie inside a rigid obstacle.

        Inside another body they may start, which is only logged: elastic
        impact keeps their depth, plastic impact and springs push them
        out. Collective.

        Args:
            x: Positions of the local nodes of the space, shape ``(l, 3)``
                [m].

        Raises:
            ValueError: Nodes are deeper than a millionth of the size of
                the surface's facets.
        """
        rigid = isinstance(self.segments, Obstacle)
        depth = -self.gap(x)
        comm = self.nodes.V.mesh.comm
        allowed = (1e-6 if rigid else _OVERLAP) * self.segment_size
        nodes = np.sort(np.concatenate(comm.allgather(self.nodes.node_ids[depth > allowed])))
        if not len(nodes):
            return
        deepest = max(comm.allgather(float(np.nanmax(depth, initial=0.0))))
        where = listed(nodes)
        if rigid:
            raise ValueError(
                f"expected bodies outside a {type(self.segments).__name__}, given {len(nodes)} "
                f"nodes up to {deepest:.3g} inside: {where}"
            )
        if comm.rank == 0:
            _logger.warning("%d nodes start up to %.3g inside: %s", len(nodes), deepest, where)

    @property
    def pressure(self) -> Floats:
        """Contact pressure of the last step at the nodes, ``(n,)`` [Pa].

        Collective, see `Surface.per_area`.
        """
        return self.nodes.per_area(-self.history.lambda_N)

    def gap(self, x: Floats, reach: float = np.inf) -> Floats:
        """Gap of every node, NaN where it faces no segment. Collective.

        Args:
            x: Positions of the local nodes of the space, owned and
                ghost, shape ``(l, 3)`` [m].
            reach: Distance to segments up to which they are looked for
                [m].

        Returns:
            Gap, shape ``(n,)`` [m], > 0 open.
        """
        everywhere, _ = self._everywhere.update(x, np.inf)
        return everywhere.pair(
            everywhere.with_ghosts(x[: everywhere.index_map.size_local]),
            self.nodes.nodes,
            everywhere.find(self.history.key),
            reach,
        )[1]

    def loose(self, x: Floats, gap_tol: float) -> Flags:
        """Nodes at a distance at which elastic impact holds them. Collective.

        Args:
            x: Positions of the local nodes of the space, owned and
                ghost, shape ``(l, 3)`` [m].
            gap_tol: Distance that counts [m].

        Returns:
            Nodes further than that, held or inside; shape ``(n,)``.
        """
        law = self.enforcement
        if not (isinstance(law, LagrangeMultiplier) and law.impact == "elastic"):
            return np.zeros(len(self.nodes.nodes), dtype=bool)
        gap = self.gap(x)
        # A node deeper than that belongs to another side.
        inside = (gap < 0) & (gap > -_kernels.DEEPEST * self.segment_size)
        flags: Flags = (np.abs(gap) > gap_tol) & (inside | self.history.active)
        return flags

    def serialize(self, archive: Archive, name: str) -> None:
        """Serialize the accepted contact. Collective.

        Args:
            archive: Takes it or gives it.
            name: First part of the names of the values.
        """
        ids = self.nodes.node_ids
        kept: dict[str, Any] = {
            f.name: archive.nodal(f"{name}/{f.name}", ids, getattr(self.history, f.name))
            for f in fields(ContactHistory)
        }
        self.history = ContactHistory(**kept)
        for spring in ("eps_N", "eps_T"):
            value = getattr(self, spring)
            if archive.same(f"{name}/has_{spring}", value is not None):
                value = np.zeros(len(ids)) if value is None else value
                setattr(self, spring, archive.nodal(f"{name}/{spring}", ids, value))
            else:
                setattr(self, spring, None)
        settled = archive.same(f"{name}/settled", self._springs is not None)
        if archive.giving:
            springs = (("eps_N", self.eps_N), ("eps_T", self.eps_T))
            ranges = {name: self._range(values) for name, values in springs if values is not None}
            self._springs = ranges if settled else None
        self.search.serialize(archive, f"{name}/search")


def _check_surfaces(nodes: Surface, segments: Surface) -> bool:
    """Whether they are the same; raises unless they can make a pair. Collective.

    Segments that are bad but usable are logged.
    """
    if nodes.V != segments.V:
        raise ValueError("expected nodes and segments in one function space, given two")
    comm = nodes.V.mesh.comm
    shared = reductions.total(comm, len(np.intersect1d(nodes.nodes, segments.nodes)))
    same = np.array_equal(nodes.segments, segments.segments)
    same = reductions.everywhere(comm, same)
    if shared and not same:
        raise ValueError(
            "expected surfaces without common nodes in a contact pair, or the same surface "
            f"twice, given {shared} nodes on both sides"
        )
    sine = segments.sharpest_corner()
    if sine < _SHARP and comm.rank == 0:
        _logger.warning(
            "segments have a corner of sine %.2g: they have no normal where it is below %g",
            sine,
            _SHARP,
        )
    return same
