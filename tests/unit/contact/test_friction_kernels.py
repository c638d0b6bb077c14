"""Small sums of friction over pairs, against NumPy."""

import numpy as np
import pytest

from dolfinx_nts import _kernels

pytestmark = pytest.mark.serial

M, N, D = 5, 9, 12


def test_known_tractions_turn_with_the_slip_and_leave_out_what_sticks(rng):
    node, sticks = rng.permutation(N)[:M].astype(np.int32), rng.random(M) < 0.5
    explicit, slip, modelled = rng.normal(size=(3, N, 2))
    stiffness = rng.normal(size=(N, 2, 2))
    known = _kernels.known_tractions(node, sticks, explicit, stiffness, slip, modelled)
    expected = explicit + np.einsum("nij,nj->ni", stiffness, slip - modelled)
    expected = np.where(sticks[:, None], 0.0, expected[node])
    np.testing.assert_allclose(known, expected, rtol=0, atol=1e-14)
    with pytest.raises(ValueError, match="expected rows of the other arrays"):
        _kernels.known_tractions(node + N, sticks, explicit, stiffness, slip, modelled)


def test_tractions_act_along_both_tangents(rng):
    t, rows, force = rng.normal(size=(M, 2)), rng.normal(size=(M, 3, D)), rng.normal(size=(M, D))
    expected = force + np.einsum("mi,mid->md", t, rows[:, 1:])
    _kernels.add_tractions(t, rows, force)
    np.testing.assert_allclose(force, expected, rtol=0, atol=1e-14)
    mixed = _kernels.with_friction(rows, t)
    np.testing.assert_array_equal(mixed[:, 1:], rows[:, 1:])
    expected = rows[:, 0] - np.einsum("mi,mid->md", t, rows[:, 1:])
    np.testing.assert_allclose(mixed[:, 0], expected, rtol=0, atol=1e-14)


def test_points_stand_before_the_vertices_of_their_segments(rng):
    points, x = rng.normal(size=(M, 3)), rng.normal(size=(N, 3))
    vertices = rng.integers(N, size=(4, 3)).astype(np.int32)
    segment = rng.integers(4, size=M).astype(np.int32)
    pairs = _kernels.with_vertices(points, x, vertices, segment)
    np.testing.assert_array_equal(pairs[:, 0], points)
    np.testing.assert_array_equal(pairs[:, 1:], x[vertices[segment]])
    with pytest.raises(ValueError, match="expected rows of vertices"):
        _kernels.with_vertices(points, x, vertices, segment - 4)
    with pytest.raises(ValueError, match="expected rows of x"):
        _kernels.with_vertices(points, x, vertices + N, segment)


def test_unit_vectors_have_unit_length_or_none(rng):
    rows = rng.normal(size=(M, D))
    rows[2] = 0
    unit = _kernels.unit_vectors(rows)
    length = np.linalg.norm(rows[:, :3], axis=1)
    np.testing.assert_array_equal(unit[2], 0)
    np.testing.assert_allclose(unit * length[:, None], rows[:, :3], rtol=0, atol=1e-14)


def test_vectors_stay_in_cones_up_to_the_first_way_out(rng):
    v, way = rng.normal(size=(2, M, 3))
    v[:, 0] = 0.1 + np.linalg.norm(v[:, 1:], axis=1)
    longest = _kernels.longest_in_cones(v, way)

    def distance(part):
        x = v + part * way
        return (x[:, 0] - np.linalg.norm(x[:, 1:], axis=1)).min()

    assert abs(distance(longest)) < 1e-13
    assert distance(longest / 2) > 0
    assert np.isinf(_kernels.longest_in_cones(v, v))
