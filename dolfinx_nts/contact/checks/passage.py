"""Pass-through check of contact points within a step.

A point may penetrate a surface within a step; the next step then detects it. It must not leave the
body on another side, nor penetrate so deep that it is not found again.
"""

from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints, indices
from dolfinx_nts.contact.joint_state import JointNodes
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.fem.node_numbering import listed, reference_positions
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.obstacles.trajectories import Trajectories, passages
from dolfinx_nts.model.segments import diameters
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.search.candidates import Candidates, too_deep
from dolfinx_nts.search.points import ContactPoints

__all__ = [
    "Passage",
    "passing_message",
    "passing_nodes_message",
    "shortest_passage_of",
    "through_to_another_side",
]

# Lengths of paths relative to a segment [-]: length above which a point that ends deep below a
# surface without a segment is lost, and above which a point that ends outside is lost.
_DEEP, _PAST = 0.1, 0.25


class Passage(NamedTuple):
    """Points that pass through a surface on straight paths. Local.

    Attributes:
        points: Their indices, shape ``(m,)``.
        step_fraction: Largest fraction of the step in which the search still detects all passing
            points [-].
    """

    points: Ints
    step_fraction: float

    @classmethod
    def none(cls) -> "Passage":
        """Result without any point."""
        return cls(np.empty(0, dtype=np.int32), 1.0)

    @classmethod
    def through(
        cls,
        candidates: Candidates,
        points: ContactPoints,
        ends: tuple[Floats, Floats],
        start: tuple[Ints, Floats],
        reach: float,
        free: Flags | None = None,
    ) -> "Passage":
        """Find the points that pass through, or end too deep for the search of the next step.

        Args:
            candidates: Candidates of the points.
            points: The ``p`` points.
            ends: Positions at both ends of the step, see `Candidates`.
            start: Candidate of each point at t_n, -1 for none, and gap to it, ``(p,)`` [m].
            reach: Search radius [m].
            free: Flags of inactive points, shape ``(p,)``; None if all are inactive.
        """
        shortest = candidates.passage.min(initial=np.inf)
        # No displacement relative to the mean vertex exceeds twice the largest displacement.
        if 4 * _kernels.farthest(*ends) <= shortest:
            return cls.none()
        distance, longest = _relative_displacements(candidates, points, *ends)
        if distance.max(initial=0.0) + longest <= shortest:
            return cls.none()
        segment_n, gap_n = start
        near = ~(gap_n > distance + longest) & (distance + longest > 0)
        number = indices(near if free is None else near & free)
        points, distance = points.take(number), distance[number] + longest
        inside = np.where(gap_n[number] < 0, segment_n[number], -1).astype(np.int32)
        paths = candidates.follow(points, *ends, inside)
        passes = paths.passes(candidates.size)
        stays = indices((paths.entered >= 0) & ~paths.leaves & ~passes)
        passes[stays] = _is_lost(candidates, points.take(stays), ends[1], paths.take(stays), reach)
        return cls(number[passes], _detectable_fraction(candidates, paths, distance, passes))


def through_to_another_side(
    candidates: Candidates, points: ContactPoints, ends: tuple[Floats, Floats], reach: float
) -> tuple[Ints, bool]:
    """Find the points that pass through a body and leave on another side. Local.

    Args:
        candidates: Candidates of the points.
        points: The points.
        ends: Positions at both ends of straight paths, see `Candidates`.
        reach: Bound on the approach of any point and candidate [m].

    Returns:
        Their indices, shape ``(m,)``, and whether any other point ends too deep for a search
        without its path.
    """
    number = candidates.near(points, ends[0], reach)
    if not len(number):
        return number, False
    points = points.take(number)
    nearby = float(candidates.size.max())
    segment, gap = candidates.pair(points, ends[0], np.full_like(number, -1), nearby)
    inside = np.where(gap < 0, segment, -1).astype(np.int32)
    paths = candidates.follow(points, *ends, inside)
    stays = (paths.entered >= 0) & ~paths.leaves
    is_deep = bool((-paths.gap[stays] > candidates.passage.min(initial=np.inf)).any())
    return number[paths.leaves & (paths.cosine < -_kernels.WALL)], is_deep


def shortest_passage_of(pair: ContactPair) -> float:
    """Relative displacement below which no node of a pair can pass through [m]. Collective."""
    segments = pair.segments
    if pair.method == EDGES:  # edge contact has no pass-through check
        return np.inf
    if isinstance(segments, Obstacle):
        return segments.shortest_passage
    size = diameters(reference_positions(segments.V)[segments.segments])
    shortest = float(passages(size, segments.thickness).min(initial=np.inf))
    return reductions.least(segments.V.mesh.comm, shortest)


def passing_message(comm: MPI.Comm, what: str, ids: GlobalInts, advice: str) -> str:
    """Message naming points of all ranks that pass through a surface, with advice. Collective.

    Args:
        comm: Communicator.
        what: Kind of the points in the plural, such as "nodes".
        ids: Their numbers on this rank, shape ``(m,)``.
        advice: Remedy.

    Returns:
        The message, "" if no point passes.
    """
    if not reductions.anywhere(comm, len(ids) > 0):
        return ""
    everywhere = np.unique(joined(comm, ids))
    where = f"{len(everywhere)} {what} pass through a surface that they face: {listed(everywhere)}"
    return f"{where}; {advice}"


def passing_nodes_message(nodes: Surface | JointNodes, passage: Passage, dt: float) -> str:
    """Message naming nodes of all ranks that pass through, and a shorter step. Collective.

    Args:
        nodes: Their surface.
        passage: Result for this rank.
        dt: Length of the step [s].

    Returns:
        The message, "" if no node passes.
    """
    comm = nodes.V.mesh.comm
    if not reductions.anywhere(comm, len(passage.points) > 0):
        return ""
    possible = float(reductions.least(comm, passage.step_fraction * dt))
    advice = f"a dt of {possible:.2g} would let contact catch them"
    return passing_message(comm, "nodes", nodes.node_ids[passage.points], advice)


def _relative_displacements(
    candidates: Candidates, points: ContactPoints, x_n: Floats, x: Floats
) -> tuple[Floats, float]:
    """Displacements of points, ``(p,)``, and largest one of the vertices of segments [m].

    Both are relative to the mean displacement of these vertices.
    """
    moved = x - x_n
    vertices = moved[candidates.segments.ravel()]
    mean = vertices.mean(axis=0) if len(vertices) else np.zeros(3)
    longest = float(np.linalg.norm(vertices - mean, axis=1).max(initial=0.0))
    return np.linalg.norm(points.of(moved) - mean, axis=1), longest


def _is_lost(
    candidates: Candidates, points: ContactPoints, x: Floats, paths: Trajectories, reach: float
) -> Flags:
    """Flags of points that end below a surface where the next search would not find them."""
    entered, size = paths.entered, candidates.size[paths.entered]
    after, gap = candidates.pair(points, x, paths.entered, reach)
    came = paths.begin >= 0
    deep = came | (-candidates.gap(points, x, entered) > too_deep(candidates, entered))
    lost = (after < 0) & deep & (paths.length > _DEEP * size)
    flags: Flags = lost | (came & (gap > 0) & (paths.length > _PAST * size))
    return flags


def _detectable_fraction(
    candidates: Candidates, paths: Trajectories, distance: Floats, passes: Flags
) -> float:
    """Fraction of the step up to which passing points would be detected."""
    shortest = candidates.passage.min(initial=np.inf)
    fractions = np.fmax(paths.begin, 0.0)[passes] + shortest / distance[passes]
    return float(fractions.min(initial=1.0))
