"""Nodes that go through a surface within a step, or too deep into it to be found again.

A node may enter a surface within a step, as it is caught there in the next one. It must not
leave on another side.
"""

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.fem.node_numbering import listed
from dolfinx_nts.model.trajectories import Trajectories
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.search.points import ContactPoints

__all__ = ["passing_nodes"]

# Ways relative to a segment [-]: below the surface to a place from which a node must be found
# again, and past a place where another segment is found for it.
_DEEP, _PAST = 0.1, 0.25
# Part of the depth at which nodes are still found [-] to which a step is to lead them.
_AIM = 0.5


def passing_nodes(step: ContactStep, dt: float) -> str:
    """Say which nodes went through a surface in a step, or "". Collective.

    Args:
        step: The solved step.
        dt: Its length [s].
    """
    surface = step.state.nodes
    node, part = _passing(step.candidates, step.search, step.x, step.normal.active)
    return message(surface.V.mesh.comm, "nodes", surface.node_ids[node], part * dt)


def _passing(
    candidates: Candidates, search: LocalSearch, x: Floats, active: Flags
) -> tuple[Ints, float]:
    """Nodes that pass, and the part of the step that could be made. Local."""
    points, x_n = search.points, search.x_n
    way, longest = relative_ways(candidates, points, x_n, x)
    if way.max(initial=0.0) + longest <= candidates.shortest_passage:
        return np.empty(0, dtype=np.int32), 1.0
    near = ~(search.gap_n > way + longest) & ~active & (way + longest > 0)
    node = numbers(near)
    points, way = points.take(node), way[node] + longest
    inside = np.where(search.gap_n[node] < 0, search.segment_n[node], -1).astype(np.int32)
    ways = candidates.follow(points, x_n, x, inside)
    passes = ways.passes(candidates.size)
    stays = numbers((ways.entered >= 0) & ~ways.leaves & ~passes)
    passes[stays] = _is_lost(candidates, points.take(stays), x, ways.take(stays), search.reach)
    through = numbers(passes)
    return node[through], possible_part(candidates, ways.take(through), way[through])


def _is_lost(
    candidates: Candidates, points: ContactPoints, x: Floats, ways: Trajectories, reach: float
) -> Flags:
    """Whether points that stay below a surface would not be found there. Local."""
    size = candidates.size[ways.entered]
    after, gap = candidates.pair(points, x, ways.entered, reach)
    came = ways.begin >= 0
    deep = came | (-candidates.gap(points, x, ways.entered) > _kernels.DEEPEST * size)
    lost = (after < 0) & deep & (ways.way > _DEEP * size)
    flags: Flags = lost | (came & (gap > 0) & (ways.way > _PAST * size))
    return flags


def numbers(flags: Flags) -> Ints:
    """Where flags are true."""
    return flags.nonzero()[0].astype(np.int32)


def relative_ways(
    candidates: Candidates, points: ContactPoints, x_n: Floats, x: Floats
) -> tuple[Floats, float]:
    """Ways of points, ``(p,)``, and the longest of a vertex, relative to the mean vertex [m]."""
    moved = x - x_n
    vertices = moved[candidates.segments.ravel()]
    mean = vertices.mean(axis=0) if len(vertices) else np.zeros(3)
    longest = float(np.linalg.norm(vertices - mean, axis=1).max(initial=0.0))
    return np.linalg.norm(points.of(moved) - mean, axis=1), longest


def possible_part(candidates: Candidates, ways: Trajectories, way: Floats) -> float:
    """Part of a step of relative ways, ``(m,)`` [m], after which points are still caught."""
    depth = np.minimum(_kernels.DEEPEST * candidates.size, candidates.thickness)[ways.entered]
    parts = np.fmax(ways.begin, 0.0) + _AIM * depth / way
    return float(parts.min(initial=1.0))


def message(comm: MPI.Comm, what: str, ids: GlobalInts, dt: float) -> str:
    """Name nodes that pass on any rank and a step with which they would not, or "". Collective."""
    if not reductions.anywhere(comm, len(ids) > 0):
        return ""
    everywhere = np.unique(np.concatenate(comm.allgather(ids)))
    dt = float(reductions.least(comm, dt))
    return (
        f"{len(everywhere)} {what} go through a surface that they face: {listed(everywhere)}; "
        f"a dt of {dt:.2g} would let contact catch them"
    )
