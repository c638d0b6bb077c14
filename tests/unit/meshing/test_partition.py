"""Owners of cells."""

import numpy as np
import pytest

from dolfinx_nts.meshing.partition import ranks_of_cells

pytestmark = pytest.mark.serial


def grid(*sizes):
    """Nodes and cells of a grid of unit cubes."""
    shape = np.add(sizes, 1)
    X = np.argwhere(np.ones(shape)).astype(float)
    lower = np.ravel_multi_index(np.argwhere(np.ones(sizes)).T, shape)
    steps = [shape[1] * shape[2], shape[2], 1]
    return X, lower[:, None] + [np.dot(corner, steps) for corner in np.argwhere(np.ones((2, 2, 2)))]


@pytest.mark.parametrize("num_ranks", [1, 2, 3, 7])
def test_each_rank_owns_as_many_cells(num_ranks, rng):
    X, cells = grid(4, 5, 6)
    ranks = ranks_of_cells(rng.normal(size=X.shape), cells, num_ranks)
    counts = np.bincount(ranks, minlength=num_ranks)
    assert len(counts) == num_ranks
    assert np.ptp(counts) <= 2


def test_cut_is_the_smallest_one_and_round_off_does_not_matter(rng):
    X, cells = grid(4, 3, 10)
    for noise in (0.0, 1e-9):
        ranks = ranks_of_cells(X + noise * rng.normal(size=X.shape), cells, 2)
        upper = X[cells].mean(axis=1)[:, 2] > 5
        np.testing.assert_array_equal(ranks, upper)


def test_a_layer_is_cut_in_rows(rng):
    X, cells = grid(2, 2, 5)
    ranks = ranks_of_cells(X + 1e-9 * rng.normal(size=X.shape), cells, 2)
    middle = X[cells].mean(axis=1)
    layer = np.isclose(middle[:, 2], 2.5)
    np.testing.assert_array_equal(ranks[layer], middle[layer, 0] > 1)


def test_bodies_that_a_plane_parts_are_not_cut():
    X, cells = grid(8, 2, 2)
    above = X + np.array([0.0, 0.0, 2.01])
    both = np.concatenate([X, above]), np.concatenate([cells, cells + len(X)])
    ranks = ranks_of_cells(*both, 2)
    np.testing.assert_array_equal(ranks, np.repeat([0, 1], len(cells)))


def test_ranks_without_cells_have_none_to_divide():
    ranks = ranks_of_cells(np.empty((0, 3)), np.empty((0, 8), dtype=np.int64), 3)
    assert len(ranks) == 0
