"""Rims of surfaces, on two facets whose edges are counted by hand."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.model.obstacles.rims import is_nearest_a_rim

pytestmark = pytest.mark.at_most_two_ranks

X = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]])
FACETS = {
    "quadrilateral": [[0, 1, 3, 4], [1, 2, 4, 5]],
    "triangle": [[0, 1, 3], [4, 1, 3], [1, 2, 4], [5, 2, 4]],
}
facets_ = pytest.mark.parametrize("cell", FACETS)


@facets_
def test_only_edges_of_a_single_facet_are_rims(cell, rng):
    facets = np.array(FACETS[cell], dtype=np.int32)
    # Near the left rim, near the middle edge x = 1, and below the lower rim.
    points = np.array([[-0.2, 0.45, -0.3], [0.95, 0.45, 0.1], [0.4, -0.1, 0.0]])
    own = np.array([0, 0 if cell == "quadrilateral" else 1, 0], dtype=np.int32)
    np.testing.assert_array_equal(is_nearest_a_rim(points, X, facets, own), [True, False, True])


@facets_
def test_rigid_surface_knows_its_rim(cell):
    surface = nts.RigidSurface(X, FACETS[cell], (1.0, 0.5, 9.0))
    points = np.array([[-0.2, 0.45, -0.3], [0.95, 0.45, 0.1]])
    own = np.array([0, 0 if cell == "quadrilateral" else 1], dtype=np.int32)
    np.testing.assert_array_equal(surface.is_at_rim(points, own), [True, False])
    assert not nts.RigidPlane((0, 0, 0), (0, 0, 1)).is_at_rim(points, own).any()
