"""Contact points of surface-to-surface contact, and nodal sums over them."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_nts import _kernels, compat
from dolfinx_nts.model.kinematics import ContactKinematics
from dolfinx_nts.search.mortar.facet_candidates import FacetCandidates
from dolfinx_nts.search.mortar.facet_points import FacetPoints
from dolfinx_nts.search.mortar.mortar_points import MortarFacets, at_nodes
from dolfinx_nts.search.scatter import NodalScatter
from dolfinx_nts.search.segment_candidates import FoundSegments

pytestmark = pytest.mark.serial


def serial_scatter(num_nodes: int) -> NodalScatter:
    none = np.empty(0, dtype=np.int64)
    index_map = compat.index_map(MPI.COMM_SELF, num_nodes, none, none.astype(np.int32))
    return NodalScatter(index_map)


def sheet(n: int, k: int, size: float, rng: np.random.Generator, noise: float):
    """Vertices (v, 3) and facets (f, k), in Basix order, of a square in the plane z = 0."""
    grid = np.linspace(0, size, n + 1)
    x = np.array([[a, b, 0.0] for b in grid for a in grid])
    inner = np.all((x[:, :2] > 1e-9) & (x[:, :2] < size - 1e-9), axis=1)
    x[inner, :2] += noise * size / n * rng.uniform(-1, 1, size=(inner.sum(), 2))
    first = np.array([[i + (n + 1) * j for i in range(n)] for j in range(n)]).ravel()[:, None]
    quadrilaterals = first + np.array([0, 1, n + 1, n + 2])
    if k == 4:
        return x, quadrilaterals.astype(np.int32)
    triangles = np.concatenate([quadrilaterals[:, [0, 1, 2]], quadrilaterals[:, [1, 3, 2]]])
    return x, triangles.astype(np.int32)


def choose(k: int, rng: np.random.Generator, *, upper=3, lower=4, size=0.9, noise=0.2, height=0.1):
    """Points of a sheet above another one, which is larger unless ``size`` > 1."""
    above, facets = sheet(upper, k, size, rng, noise)
    below, segments = sheet(lower, k, 1.0, rng, noise)
    above += [0.05, 0.02, height]
    x = np.vstack([above, below])
    segments = (segments + len(above)).astype(np.int32)
    n = len(segments)
    scatter = serial_scatter(len(x))
    found = FoundSegments(
        scatter, segments, np.ones(n), np.arange(n), np.full(n, 0.4), np.full(n, 1.0)
    )
    nodes = np.arange(len(above), dtype=np.int32)
    area = np.full(len(above), size**2 / len(above))
    surface = MortarFacets(nodes, area, facets, -np.ones(len(facets)), x, False, facets, None)
    candidates = FacetCandidates(found, segments)
    return surface, candidates, x, FacetPoints.choose(surface, candidates, x, x, 1.0).points()


shapes = pytest.mark.parametrize("k", [3, 4])


@shapes
def test_points_far_from_their_segments_at_the_start_are_kept_in_statics(k):
    surface, candidates, x, points = choose(k, np.random.default_rng(3), noise=0.0)
    x_n = x.copy()
    x_n[: len(surface.nodes), 0] -= 0.75  # 3 segments
    kept, left = (
        FacetPoints.choose(surface, candidates, x_n, x, 1.0, slides_far=far).points()
        for far in (True, False)
    )
    np.testing.assert_array_equal(kept.segment, points.segment)
    assert len(left.segment) == 0


@shapes
def test_points_tile_the_overlap_and_are_on_their_segments(k, rng):
    _, _, x, points = choose(k, rng)
    assert points.shares.area.sum() == pytest.approx(0.81, rel=1e-12)
    pairs = np.concatenate([points.of(x)[:, None], x[points.reached[:, k:]]], axis=1)
    xi, gap, _, status = _kernels.project(pairs, np.ones(len(pairs)))
    assert not status.any()
    assert gap == pytest.approx(0.1, abs=1e-12)
    assert xi.min() >= -1e-9
    assert (xi.sum(axis=1) if k == 3 else xi).max() <= 1 + 1e-9


def test_far_vertices_of_segments_are_not_taken_for_points_of_a_curved_facet():
    """The map of a facet of degree 2 folds outside of it; its inverse is found inside."""
    at = 0.5 * np.array([[0, 0], [2, 0], [0, 2], [2, 2], [1, 0], [0, 1], [2, 1], [1, 2], [1, 1]])
    bent = at + 0.3 * np.column_stack([at[:, 0] * (at[:, 0] - 1), (at[:, 0] - 0.5) ** 2])
    below, segments = sheet(6, 4, 6.0, np.random.default_rng(0), 0.0)
    n, nodes = len(segments), np.arange(9, dtype=np.int32)
    scatter = serial_scatter(9 + len(below))
    segments = (segments + 9).astype(np.int32)
    sizes = np.full(n, 1.0), np.full(n, 1.0)
    found = FoundSegments(scatter, segments, np.ones(n), np.arange(n), *sizes)
    for travel in np.linspace(2.0, 3.0, 11):
        facet, flat = (
            np.vstack([np.insert(xy + np.array([travel, 2.2]), 2, 0.1, axis=1), below])
            for xy in (bent, at)
        )
        of_facet = nodes[None], -np.ones(1), flat, False, nodes[None], None
        surface = MortarFacets(nodes, np.full(9, 0.25), *of_facet)
        points = FacetPoints.choose(
            surface, FacetCandidates(found, segments), facet, facet, 1.0
        ).points()
        assert points.shares.area.sum() == pytest.approx(1.0, rel=1e-12)
        xi = points.of(np.vstack([np.insert(at, 2, 0.0, axis=1), 0 * below]))
        weight = np.bincount(points.shares.point, points.shares.value) / 4
        assert weight @ xi[:, :2] == pytest.approx([0.5, 0.5], rel=1e-12)


@pytest.mark.parametrize(
    ("k", "order"), [(3, [1, 2, 0]), (3, [1, 0, 2]), (4, [1, 3, 0, 2]), (4, [2, 3, 0, 1])]
)
def test_points_do_not_depend_on_how_vertices_are_numbered(k, order, rng):
    surface, candidates, x, points = choose(k, rng)
    turns = -1 if order in ([1, 0, 2], [2, 3, 0, 1]) else 1  # mirrored
    turned = surface.vertices[:, order].copy()
    other = replace(
        surface, vertices=turned, facet_nodes=turned, orientation=turns * surface.orientation
    )
    again = FacetPoints.choose(other, candidates, x, x, 1.0).points()
    np.testing.assert_allclose(again.shares.area, points.shares.area, rtol=1e-12)
    here, there = (p.of(x)[np.lexsort(np.round(p.of(x), 9).T)] for p in (points, again))
    np.testing.assert_allclose(here, there, atol=1e-9)


@shapes
def test_multipliers_are_dual_to_displacements_on_whole_facets(k, rng):
    surface, _, x, points = choose(k, rng)
    field = rng.normal(size=(len(x), 3))
    field[len(surface.nodes) :] = 0
    there = points.of(field)[:, 2]
    assert points.shares.mean(there) == pytest.approx(field[: len(surface.nodes), 2], abs=1e-11)


@shapes
def test_multipliers_of_partly_covered_facets_are_positive(k, rng):
    # In the reference cell of a distorted facet, edges of other facets are slightly curved.
    surface, _, x, points = choose(k, rng, size=1.4, noise=0.0)
    # 0.05 and 0.02 of the lower sheet are not below the upper one.
    assert points.shares.area.sum() == pytest.approx(0.95 * 0.98, rel=1e-9)
    height = points.of(x)[:, 2]
    assert np.nanmax(np.abs(points.shares.mean(height) - 0.1)) <= 1e-12
    outside = np.all(surface.X[: len(surface.nodes), :2] > 1.2, axis=1)
    assert outside.any()
    partial_facets = points.shares.area[: len(surface.nodes)]
    assert (partial_facets >= 0).all()
    assert np.isnan(points.shares.mean(height))[partial_facets == 0].all()


def slide_over_rim(k: int, travel: float, lift):
    """Means of heights, and areas, of a sheet of 2 by 2 facets, slid by ``travel`` over a rim.

    The first row of nodes lies at y = 0.1 + way, the rim of the other sheet at y = 1; heights
    are given by ``lift`` of the coordinates (v, 2) on the sheet and the distance from the rim.
    """
    none = np.random.default_rng(0)
    above, facets = sheet(2, k, 0.8, none, 0.0)
    below, segments = sheet(3, k, 1.0, none, 0.0)
    above[:, 2] = lift(above[:, :2], 0.9 - travel - above[:, 1])
    x = np.vstack([above + np.array([0.1, 0.1 + travel, 0.0]), below])
    n, segments = len(segments), (segments + len(above)).astype(np.int32)
    sizes = np.full(n, 0.4), np.full(n, 1.0)
    found = FoundSegments(serial_scatter(len(x)), segments, np.ones(n), np.arange(n), *sizes)
    nodes = np.arange(len(above), dtype=np.int32)
    of_facets = facets, -np.ones(len(facets)), x, False, facets, None
    surface = MortarFacets(nodes, np.full(9, 0.07), *of_facets)
    points = FacetPoints.choose(surface, FacetCandidates(found, segments), x, x, 1.0).points()
    return points.shares.mean(points.of(x)[:, 2]), points.shares.area


@shapes
def test_mean_gap_of_a_touching_node_stays_as_facets_slide_over_a_rim(k):
    """It is the gap of the node to the rim, and behind it changes no faster than the node."""
    step, middle = 0.002, 4
    travels, gaps = np.arange(0.0, 0.8, step), []
    for travel in travels:
        mean, area = slide_over_rim(k, travel, lambda at, _: 0.4 * ((at - 0.4) ** 2).sum(axis=1))
        assert area.min() >= 0
        gaps.append(mean[middle])
    assert np.abs(gaps)[travels <= 0.45].max() <= 1e-12
    assert np.abs(np.diff(gaps)).max() <= step


@shapes
def test_nodes_beyond_a_free_edge_get_no_excessive_forces(k):
    """A sheet that turns about the rim opens; nodes beyond it hardly count as deep."""
    slope, facet = 0.1, 0.4
    for travel in np.arange(0.0, 0.8, 0.01):
        mean, area = slide_over_rim(k, travel, lambda _, inside: slope * inside)
        assert np.nanmin(mean) >= -0.2 * slope * facet
        # The integral over the part above the other sheet, up to the tilt of projections.
        farthest, covered = 0.9 - travel, min(0.8, 0.9 - travel)
        integral = 0.8 * slope * (farthest * covered - covered**2 / 2)
        assert (area * np.nan_to_num(mean)).sum() == pytest.approx(integral, rel=2e-2)


def mean_and_least(found, x, part):
    """Mean gap of each node, and the least gap on the facets around it."""
    points, gap = found.points(part), found.candidates.gap
    mean = points.shares.mean(gap(points, x, points.segment))
    gaps, vertices = gap(found.places, x, found.places.segment), found.facets.vertices
    around = [(vertices[found.facet] == node).any(axis=1) for node in found.facets.nodes]
    return mean, np.array([gaps[each].min(initial=np.inf) for each in around])


@shapes
def test_linear_gaps_leave_the_dual_functions(k, rng):
    surface, candidates, x, _ = choose(k, rng)
    above = x[: len(surface.nodes)]
    above[:, 2] += above[:, :2] @ [0.02, -0.03]
    found = FacetPoints.choose(surface, candidates, x, x, 1.0)
    assert found.largest_dual_fractions((x,), 1e-12) == pytest.approx(1.0, abs=1e-9)
    mean, _ = mean_and_least(found, x, None)
    assert mean == pytest.approx(above[:, 2], abs=1e-12)


@shapes
def test_no_mean_gap_is_less_than_the_gaps_around_the_node(k, rng):
    """Whatever the parts are that the nodes of neighbouring facets allow, and in two states."""
    surface, candidates, x, _ = choose(k, rng, lower=7)
    n, falls = len(surface.nodes), 0
    for _ in range(10):
        states = [x.copy(), x.copy()]
        for y in states:
            y[n:, 2] -= 0.02 * rng.random(len(x) - n) ** 4
        found = FacetPoints.choose(surface, candidates, *states, 1.0)
        part = found.largest_dual_fractions(states, 1e-12)
        assert ((part >= 0) & (part <= 1)).all()
        for y in states:
            for chosen in (part, part * rng.random(n)):
                mean, least = mean_and_least(found, y, chosen)
                assert (mean >= least - 1e-12).all()
            mean, least = mean_and_least(found, y, None)
            falls += np.count_nonzero(mean < least - 1e-6)
    assert falls > 0


@pytest.mark.parametrize("kink", [0.02, 0.3, 0.5, 0.98])
def test_part_of_dual_functions_above_a_kink_agrees_with_the_integrals(kink):
    """An edge of length 1 above a flat chamfer: (1 - p) / (1 + 2 p), with the kink at p."""
    x = np.zeros((5, 3))
    x[:, 0], x[4, 1] = [0.0, 1.0, -1.0, kink, 3.0], -0.02 * (3 - kink)
    edge, below = np.array([[0, 1]], dtype=np.int32), np.array([[2, 3], [3, 4]], dtype=np.int32)
    sizes = np.ones(2), np.ones(2)
    found = FoundSegments(serial_scatter(5), below, -np.ones(2), np.arange(2), *sizes)
    of_edge = edge, np.ones(1), x, False, edge, None
    surface = MortarFacets(edge[0], np.full(2, 0.5), *of_edge)
    points = FacetPoints.choose(surface, FacetCandidates(found, below), x, x, 10.0)
    part = points.largest_dual_fractions((x,), 1e-12)
    assert part == pytest.approx([(1 - kink) / (1 + 2 * kink), 1.0], rel=1e-9)
    assert not points.kink.any()


@pytest.mark.parametrize("depth", [0.0, 0.01])
@pytest.mark.parametrize("kink", [0.3, 0.5])
def test_openings_above_a_steep_chamfer_neither_press_nor_lift_in_equilibrium(kink, depth):
    """Points on the sole count with linear functions, those above the chamfer by their gaps."""
    x = np.zeros((5, 3))
    x[:, 0], x[4, 1] = [0.0, 1.0, -1.0, kink, 3.0], -(3 - kink)
    x[:2, 1] = -depth
    edge, below = np.array([[0, 1]], dtype=np.int32), np.array([[2, 3], [3, 4]], dtype=np.int32)
    sizes = np.ones(2), np.ones(2)
    found = FoundSegments(serial_scatter(5), below, -np.ones(2), np.arange(2), *sizes)
    of_edge = edge, np.ones(1), x, False, edge, None
    surface = MortarFacets(edge[0], np.full(2, 0.5), *of_edge)
    chosen = FacetPoints.choose(surface, FacetCandidates(found, below), x, x, 10.0)
    assert (chosen.kink == 1).all()
    part = chosen.largest_dual_fractions((x,), 1e-12)
    points, in_equilibrium = chosen.points(part), chosen.points(part, x, 1e-12)
    gap = chosen.candidates.gap(points, x, points.segment)
    opening = np.fmax(gap, 0)
    linear, weighted = (some.shares.mean(opening) for some in (points, in_equilibrium))
    assert (linear > 0).all()
    assert (weighted[0] >= 0) and (weighted < linear).all()
    # Area of the first node: the part above the sole, and little of the rest.
    sole = kink - kink**2 / 2
    assert sole <= in_equilibrium.shares.area[0] <= sole + 0.1 * bool(depth) + 1e-9


def test_facets_that_face_away_have_no_points(rng):
    surface, candidates, x, _ = choose(4, rng)
    away = replace(surface, orientation=-surface.orientation)
    points = FacetPoints.choose(away, candidates, x, x, 1.0).points()
    assert len(points.segment) == 0
    assert (points.shares.first(points.segment) == -1).all()


def test_facets_out_of_reach_or_far_behind_have_no_points(rng):
    surface, candidates, x, _ = choose(4, rng)
    assert len(FacetPoints.choose(surface, candidates, x, x, 0.05).points().segment) == 0
    deep = x.copy()
    deep[: len(surface.nodes), 2] = -0.3
    assert len(FacetPoints.choose(surface, candidates, deep, deep, 1.0).points().segment) == 0
    # Points in front of the segments at the start of the step have passed through them.
    assert len(FacetPoints.choose(surface, candidates, x, deep, 1.0).points().segment) > 0


@shapes
def test_overlapping_segments_leave_each_point_with_the_nearest(k, rng):
    """A second sheet right below the first one is covered twice in projection."""
    above, facets = sheet(2, k, 0.8, rng, 0.0)
    below, segments = sheet(3, k, 1.0, rng, 0.0)
    above += [0.1, 0.1, 0.05]
    x = np.vstack([above, below, below - [0, 0, 0.05]])
    first = segments + len(above)
    both = np.vstack([first, first + len(below)]).astype(np.int32)
    n = len(both)
    scatter = serial_scatter(len(x))
    found = FoundSegments(scatter, both, np.ones(n), np.arange(n), np.full(n, 0.4), np.full(n, 1.0))
    nodes = np.arange(len(above), dtype=np.int32)
    of_facets = facets, -np.ones(len(facets)), x, False, facets, None
    surface = MortarFacets(nodes, np.full(len(above), 0.07), *of_facets)
    points = FacetPoints.choose(surface, FacetCandidates(found, both), x, x, 1.0).points()
    assert (points.segment < len(first)).all()
    assert points.shares.area.sum() == pytest.approx(0.64, rel=1e-12)


@shapes
def test_rows_are_sums_over_the_points_of_a_node(k, rng):
    surface, candidates, x, points = choose(k, rng)
    nodes = np.array([1, 4, 2], dtype=np.int32)
    some = points.take(nodes)
    values = rng.normal(size=(len(some.segment), 2, 3 * (1 + k)))
    shares = some.shares
    parts = rng.normal(size=(len(shares.point), 2, 2))
    rows = some.rows(values, parts)
    field = rng.normal(size=x.shape)
    # The work of a row is the sum of the works of its points.
    work = np.einsum("mcd,md->mc", rows, field[some.lists].reshape(len(nodes), -1))
    there = np.concatenate([some.of(field)[:, None], field[some.reached[:, k:]]], axis=1)
    of_points = np.einsum("pcd,pd->pc", values, there.reshape(len(there), -1))
    of_shares = np.einsum("iab,ib->ia", parts, of_points[shares.point])
    expected = shares.reduced(np.add, of_shares, 0.0)
    np.testing.assert_allclose(work, expected, rtol=1e-10, atol=1e-12)
    assert (some.lists[:, 0] == surface.nodes[nodes]).all()
    places = np.ones((len(shares.point), 2 * k), dtype=np.int32)
    with pytest.raises(ValueError, match="places in rows"):
        _kernels.sum_rows(some.phi, shares.start, shares.point, parts, places, 1, values)
    assert candidates.segments.shape[1] == k


@shapes
def test_kinematics_of_nodes_are_means_rows_and_the_least_turn_of_their_points(k, rng):
    points = choose(k, rng)[3].take(np.array([1, 4, 2], dtype=np.int32))
    p, shares = len(points.segment), points.shares
    gap_n, gap, turn = rng.normal(size=(3, p))
    force, gradient = rng.normal(size=(2, p, 3 * (1 + k)))
    turn[shares.point[shares.start[1]]] = np.nan  # marks a failure for all later rows
    pairs = ContactKinematics(gap_n, gap, force, gradient, np.empty(0), turn)
    mean_n, mean, of_force, of_gradient, least = at_nodes(points, pairs)
    parts = shares.value[:, None, None] * np.eye(2)
    rows = points.rows(np.stack([force, gradient], axis=1), parts)
    assert mean_n == pytest.approx(shares.mean(gap_n), rel=1e-12, abs=1e-14)
    assert mean == pytest.approx(shares.mean(gap), rel=1e-12, abs=1e-14)
    assert np.array_equal(np.stack([of_force, of_gradient], axis=1), rows)
    for node, start, end in zip(range(3), shares.start, shares.start[1:], strict=False):
        assert np.array_equal(least[node], turn[shares.point[start:end]].min(), equal_nan=True)
    assert np.isnan(least[1])


@shapes
def test_expanded_matrices_agree_with_facets_and_segments(k, rng):
    *_, x, points = choose(k, rng)
    p = len(points.segment)
    matrix, factor = rng.normal(size=(p, 3 + 3 * k, 3 + 3 * k)), rng.normal(size=p)
    blocks = points.blocks(factor, matrix)
    assert len(blocks) < p
    a, b = rng.normal(size=(2, *x.shape))
    there = [
        np.concatenate([points.of(f)[:, None], f[points.reached[:, k:]]], axis=1).reshape(p, -1)
        for f in (a, b)
    ]
    on_nodes = [f[points.patch_nodes].reshape(len(blocks), -1) for f in (a, b)]
    expected = factor * np.einsum("pi,pij,pj->p", there[0], matrix, there[1])
    expected = np.bincount(points.patch, expected)
    assert np.einsum("pi,pij,pj->p", on_nodes[0], blocks, on_nodes[1]) == pytest.approx(
        expected, rel=1e-10, abs=1e-12
    )
    with pytest.raises(ValueError, match="numbers of blocks"):
        _kernels.sum_blocks(points.phi, points.patch, 1, factor, matrix)
