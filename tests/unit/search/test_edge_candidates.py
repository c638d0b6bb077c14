"""Pairs of crossing edges: detection, gap, and momenta conserved by their forces."""

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_nts import compat
from dolfinx_nts.common.vectors import cross
from dolfinx_nts.search.edges import crossings
from dolfinx_nts.search.edges.current_edges import Edges
from dolfinx_nts.search.edges.edge_candidates import EdgeCandidates
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.scatter import NodalScatter
from reference.bulk import rotation

pytestmark = pytest.mark.serial

CARRIER = NodalPoints(np.array([0], dtype=np.int32))
NONE = np.array([-1], dtype=np.int32)


def wedge(turn=0.0, up=True, half=np.pi / 4):
    """Ends of an edge along x from -0.5 to 0.5, and a vertex of each facet at it (4, 3) [m]."""
    side, height = np.sin(half), np.cos(half) * (-1 if up else 1)
    x = np.array([[-0.5, 0, 0], [0.5, 0, 0], [0, side, height], [0, -side, height]])
    return x @ rotation([0, 0, 1], turn).T


def outward(first):
    """Facets at an edge of a wedge, in outward sense, if it points up (2, 3)."""
    a, b, left, right = first + np.arange(4)
    return np.array([[[a, b, left], [b, a, right]]], dtype=np.int32)


def candidates(x, reach=1.0, turned=(True, False)):
    """The pair of two edges with the vertices of their facets, rows of x (8, 3)."""
    none = np.empty(0, dtype=np.int64)
    index_map = compat.index_map(MPI.COMM_SELF, len(x), none, none.astype(np.int32))
    edges = []
    for first, is_turned in zip((0, 4), turned, strict=True):
        facets = outward(first)[..., ::-1] if is_turned else outward(first)
        ends = np.array([[first, first + 1]], dtype=np.int32)
        edges.append(Edges(ends, np.ascontiguousarray(facets), np.zeros(1, int), np.ones(1)))
    scatter = NodalScatter(index_map)
    return EdgeCandidates.paired(scatter, *edges, 1, x, reach)


def crossed(gap=0.1, shift=(0.0, 0.0), turn=np.pi / 2):
    """A wedge that points down above one that points up."""
    return np.vstack([wedge(turn, up=False) + np.array([*shift, gap]), wedge()])


@pytest.mark.parametrize("gap", [0.1, -0.05])
def test_edges_that_face_each_other_have_the_distance_of_their_lines(gap, rng):
    Q, c = rotation(rng.normal(size=3), 2.0), rng.normal(size=3)
    x = crossed(gap, (0.2, -0.1)) @ Q.T + c
    segment, found = candidates(x).pair(CARRIER, x, NONE, 1.0)
    assert segment[0] >= 0
    assert found[0] == pytest.approx(gap, abs=1e-14)


REFUSED = {
    "too far": crossed(0.6),
    "beyond an end of the own one": crossed(shift=(0.0, 0.51)),
    "beyond an end of the other one": crossed(shift=(0.66, 0.0)),
    "nearly parallel": crossed(turn=0.009),
    "inside, but beyond a corner": crossed(-0.06, shift=(0.55, 0.0)),
    "deeper than half an edge": crossed(-0.51),
    "back to back": np.vstack([wedge(np.pi / 2) + np.array([0, 0, 0.1]), wedge()]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_edges_that_do_not_face_each_other_are_no_pairs(case):
    x = REFUSED[case]
    pairs = candidates(x, turned=(case != "back to back", False))
    assert pairs.pair(CARRIER, x, NONE, 0.5)[0][0] == -1


def test_an_edge_crossing_at_a_common_vertex_crosses_one_edge():
    # Two consecutive edges: the second one starts where the first one ends.
    found = []
    for shift in (0.5, -0.5):
        x = crossed(shift=(0.0, shift))
        found.append(candidates(x).pair(CARRIER, x, NONE, 1.0)[0][0] >= 0)
    assert sorted(found) == [False, True]


def test_only_edges_within_reach_are_crossed(monkeypatch, rng):
    crossed_pairs = []
    monkeypatch.setattr(
        crossings, "cross", lambda a, b: crossed_pairs.append(len(a)) or cross(a, b)
    )
    x = crossed(gap=5.0)
    pairs = candidates(x, reach=10.0)
    assert pairs.pair(CARRIER, x, NONE, 4.0)[0][0] < 0
    assert not any(crossed_pairs)
    assert pairs.pair(CARRIER, x, NONE, 6.0)[0][0] >= 0
    assert any(crossed_pairs)
    # Also beyond an end of the other edge, with either direction of the edges.
    for shift in rng.uniform(-0.7, 0.7, (50, 2)):
        x = crossed(0.3, shift, turn=rng.uniform(0.5, 2.5)) @ rotation(rng.normal(size=3), 2.0).T
        pairs = candidates(x, reach=10.0)
        (anywhere, gap), (near, _) = (pairs.pair(CARRIER, x, NONE, r) for r in (np.inf, 0.31))
        assert near[0] == anywhere[0]
        assert gap[0] == pytest.approx(0.3) or anywhere[0] < 0


def test_a_pair_stays_until_it_is_well_beyond_an_end_and_in_its_sense_when_it_turns():
    x = crossed()
    pairs = candidates(x)
    segment, _ = pairs.pair(CARRIER, x, NONE, 1.0)
    for shift, slack, stays in ((0.505, 0.01, True), (0.52, 0.01, False), (0.8, np.inf, True)):
        moved = crossed(shift=(0.0, -shift if found_below(x) else shift))
        assert (pairs.pair(CARRIER, moved, segment, 1.0, slack)[0][0] >= 0) == stays


def found_below(x):
    """Whether the second end of the carrier's edge is at smaller y."""
    return x[1, 1] > x[0, 1]


def states(rng):
    """Edges at both ends of a step with a large motion, and candidates."""
    x_n = crossed(0.1, (0.1, 0.05))
    Q = rotation(rng.normal(size=3), 0.6)
    x = (x_n + 0.1 * rng.normal(size=x_n.shape)) @ Q.T + rng.normal(size=3)
    pairs = candidates(x_n)
    return pairs, pairs.pair(CARRIER, x_n, NONE, 1.0)[0], x_n, x


def nodes_of(pairs, segment, x):
    """Positions of the nodes of the pair, shape (4, 3)."""
    return x[CARRIER.dofs(pairs.segments[segment])[0]]


def test_the_force_gives_the_change_of_the_gap_and_no_momenta(rng):
    for _ in range(20):
        pairs, segment, x_n, x = states(rng)
        contact = pairs.contact("conserving", CARRIER, x_n, x, segment)
        at_n, at = (nodes_of(pairs, segment, y) for y in (x_n, x))
        force = contact.force.reshape(4, 3)
        change = contact.gap[0] - contact.gap_n[0]
        assert np.vdot(force, at - at_n) == pytest.approx(change, abs=1e-13)
        assert np.abs(force.sum(axis=0)).max() < 1e-13
        assert np.abs(np.cross((at + at_n) / 2, force).sum(axis=0)).max() < 1e-13
        # The distance of two lines.
        a_1, a_2, b_1, b_2 = at
        n = np.cross(a_2 - a_1, b_2 - b_1)
        assert abs(contact.gap[0]) == pytest.approx(abs((a_1 - b_1) @ n) / np.linalg.norm(n))


@pytest.mark.parametrize("scheme", ["conserving", "midpoint", "static"])
def test_gradient_and_tangent_are_derivatives(scheme, rng):
    pairs, segment, x_n, x = states(rng)
    rows = CARRIER.dofs(pairs.segments[segment])[0]
    contact = pairs.contact(scheme, CARRIER, x_n, x, segment)
    direction, h = np.zeros_like(x), 1e-5
    direction[rows] = rng.normal(size=(4, 3))
    ends = [pairs.contact(scheme, CARRIER, x_n, x + s * h * direction, segment) for s in (1, -1)]
    travel = direction[rows].ravel()
    slope = (ends[0].gap - ends[1].gap) / (2 * h)
    assert slope == pytest.approx(contact.gradient @ travel, rel=1e-7)
    change = (ends[0].force - ends[1].force)[0] / (2 * h)
    assert np.abs(change - contact.tangent[0] @ travel).max() < 1e-7


def test_slip_agrees_with_the_nearest_points_and_has_its_derivatives(rng):
    pairs, segment, x_n, x = states(rng)
    at_n, at = (nodes_of(pairs, segment, y) for y in (x_n, x))
    slip = pairs.slip("objective", CARRIER, x_n, x, segment)
    force = slip.force.reshape(2, 4, 3)
    for i in range(2):
        assert np.vdot(force[i], at - at_n) == pytest.approx(slip.value[0, i], abs=1e-13)
        assert np.abs(force[i].sum(axis=0)).max() < 1e-13
        assert np.abs(np.cross((at + at_n) / 2, force[i]).sum(axis=0)).max() < 1e-13
    rows = CARRIER.dofs(pairs.segments[segment])[0]
    direction, h, t = np.zeros_like(x), 1e-5, rng.normal(size=(1, 2))
    direction[rows] = rng.normal(size=(4, 3))
    ends = [pairs.slip("objective", CARRIER, x_n, x + s * h * direction, segment) for s in (1, -1)]
    change = np.einsum("mi,mid->d", t, ends[0].force - ends[1].force) / (2 * h)
    travel = direction[rows].ravel()
    assert np.abs(change - slip.tangent(t)[0] @ travel).max() < 1e-7
    # The nearest points of two lines, by a linear system of their own.
    a_1, a_2, b_1, b_2 = at_n
    d = np.column_stack([a_2 - a_1, b_1 - b_2])
    s, t = np.linalg.lstsq(d, b_1 - a_1, rcond=None)[0]
    between = [a + s * (e - a) - b - t * (f - b) for a, e, b, f in (at_n, at)]
    # Along the orthonormal tangents at t_n, convected with the edges.
    edges_n, edges = (np.array([a2 - a1, b2 - b1]) for a1, a2, b1, b2 in (at_n, at))
    tangents = slip.frame_n[0] @ np.linalg.pinv(edges_n) @ edges
    assert tangents @ between[1] == pytest.approx(slip.value[0], abs=1e-12)
