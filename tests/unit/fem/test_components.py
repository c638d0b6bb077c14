"""Components of nodal vectors, and their sums over nodes in one pass, against NumPy."""

import numpy as np
import pytest

from dolfinx_nts.fem.components import bounds, in_space, motion_sums, of_space

pytestmark = pytest.mark.serial


@pytest.mark.parametrize("shape", [(7, 2), (4, 5, 2), (0, 2), (2,)])
def test_vectors_of_the_plane_have_no_third_component(rng, shape):
    vectors = rng.normal(size=shape)
    padded = in_space(vectors)
    np.testing.assert_array_equal(padded[..., :2], vectors)
    assert padded.shape == (*shape[:-1], 3) and not padded[..., 2].any()
    assert in_space(padded) is padded
    rows = padded.reshape(-1, 3)
    np.testing.assert_array_equal(of_space(rows, 2), vectors.reshape(-1, 2))
    assert of_space(rows, 3) is rows


@pytest.mark.parametrize("dim", [2, 3])
def test_motion_is_summed_up(rng, dim):
    x, p, v = rng.normal(size=(9, 3)), rng.normal(size=(7, dim)), rng.normal(size=(7, dim))
    turning = np.cross(x[:7], in_space(p)).sum(axis=0)
    expected = [np.vdot(p, v) / 2, *in_space(p).sum(axis=0), *turning]
    np.testing.assert_allclose(motion_sums(x, p, v), expected, rtol=0, atol=1e-13)


def test_bounds_cover_selected_nodes_only(rng):
    x, nodes = rng.normal(size=(9, 3)), np.array([4, 0, 8], np.int32)
    np.testing.assert_array_equal(bounds(x, nodes), [x[nodes].min(axis=0), x[nodes].max(axis=0)])
    np.testing.assert_array_equal(bounds(x, nodes[:0]), [[np.inf] * 3, [-np.inf] * 3])


def test_rows_that_are_not_there_are_refused(rng):
    x, one, far = rng.normal(size=(3, 3)), np.ones((1, 3)), np.array([3], np.int32)
    with pytest.raises(ValueError, match="rows: expected row numbers of x"):
        bounds(x, far)
    with pytest.raises(ValueError, match="a row for each row of p"):
        motion_sums(x[:0], one, one)
    with pytest.raises(ValueError, match="v: expected shape"):
        motion_sums(x, one, one[:0])
