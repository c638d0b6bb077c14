"""Rigid obstacle of facets: contact, orientation, and what it refuses."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts import _kernels
from dolfinx_nts.model.facing import Facing

pytestmark = pytest.mark.at_most_two_ranks

ROUNDING = 1e3 * np.finfo(float).eps

schemes = pytest.mark.parametrize("scheme", ["conserving", "midpoint", "static"])


@pytest.mark.parametrize("k", [3, 4])
@schemes
def test_rigid_facets_are_segments_that_do_not_move(k, scheme, rng):
    corners = np.array([[0.0, 0, 0], [1, 0, 0.1], [0, 1, 0], [1, 1, 0.2]])[:k]
    surface = nts.RigidSurface(corners, [range(k)], [0.3, 0.3, 5.0])
    x_n = rng.uniform(0.1, 0.4, (9, 3))
    x = x_n + 0.1 * rng.normal(size=x_n.shape)
    values = surface.contact(scheme, x_n, x, np.zeros(9, dtype=np.int32))
    pairs = [np.concatenate([y[:, None], np.tile(corners, (9, 1, 1))], axis=1) for y in (x_n, x)]
    whole = getattr(_kernels, f"contact_{scheme}")(*pairs, np.ones(9))
    for part, full in zip(values, whole, strict=True):
        np.testing.assert_array_equal(part, full[tuple(slice(n) for n in part.shape)])
    if scheme == "conserving":
        work = np.einsum("mi,mi->m", values[2], x - x_n)
        np.testing.assert_allclose(work, values[1] - values[0], atol=ROUNDING)


def test_facets_turn_to_the_outside_whatever_their_sense(rng):
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    for facet in ([0, 1, 2], [0, 2, 1]):
        for side in (1.0, -1.0):
            surface = nts.RigidSurface(points, [facet], [0, 0, side])
            x = np.array([[0.2, 0.2, 0.1]])
            facet_found, gap = surface.find(
                x, np.array([-1], dtype=np.int32), 0.01, np.inf, Facing.everywhere(len(x))
            )
            gradient = surface.contact("static", x, x, facet_found)[3]
            np.testing.assert_allclose(gradient[0], [0, 0, side])
            np.testing.assert_allclose(gap[0], 0.1 * side)


def test_facets_that_make_no_surface_are_refused():
    with pytest.raises(ValueError, match=r"shape \(s, 3\) or \(s, 4\)"):
        nts.RigidSurface([[0, 0, 0]], [[0, 0]], (0, 0, 1))
    with pytest.raises(ValueError, match="numbers of points, from 0 to 0, given 0 to 2"):
        nts.RigidSurface([[0, 0, 0]], [[0, 1, 2]], (0, 0, 1))
    with pytest.raises(ValueError, match="without area, or in one plane with it"):
        nts.RigidSurface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], (5, 5, 0))
