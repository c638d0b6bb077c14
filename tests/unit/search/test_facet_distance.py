"""Whether facets of two surfaces may be near each other, against distances of sampled points."""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from helpers.scene import Motion

pytestmark = pytest.mark.serial

# Weights of sampled points on facets, by their number of vertices.
_S = np.linspace(0, 1, 9)
SAMPLES = {
    2: np.array([[1 - s, s] for s in _S]),
    3: np.array([[1 - s - t, s, t] for s in _S for t in _S if s + t <= 1]),
    4: np.array([[(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t] for s in _S for t in _S]),
}


def within(facets, others, reach):
    """Whether facets with these vertices, ``(n, k, 3)`` and ``(m, k, 3)``, may be within reach."""
    k = facets.shape[1]
    x = np.concatenate([facets.reshape(-1, 3), others.reshape(-1, 3)])
    rows = np.arange(len(x), dtype=np.int32).reshape(-1, k)
    return _kernels.facets_may_be_within(x, rows[: len(facets)], rows[len(facets) :], reach)


def distance(facets, others):
    """Least distance of sampled points."""
    weights = SAMPLES[facets.shape[1]]
    a, b = ((weights @ each).reshape(-1, 3) for each in (facets, others))
    return np.sqrt(((a[:, None] - b) ** 2).sum(axis=2).min())


@pytest.mark.parametrize("k", [2, 3, 4])
def test_no_near_facet_is_missed(k, rng):
    found = np.zeros(2, dtype=int)
    for _ in range(300):
        centres = rng.uniform(-1, 1, (2, 4, 1, 3))
        centres[1] += [0.8, 0.3, 0.4]
        sides = centres + rng.uniform(-0.3, 0.3, (2, 4, k, 3))
        if k == 2:
            sides[..., 2] = 0
        reach = rng.uniform(0.05, 0.6)
        may_be, is_near = within(*sides, reach), distance(*sides) <= reach
        assert may_be or not is_near
        found += may_be, is_near
    # Few facets count as near although they are not.
    assert 30 < found[1] <= found[0] < 1.2 * found[1]


@pytest.mark.parametrize("k", [2, 3, 4])
def test_distance_of_parallel_facets_is_exact_in_any_frame(k, rng):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])[:k] - [0.2, 0.3, 0]
    facets = np.stack([corners, corners + np.array([1, 0, 0])])
    up = np.array([0, 0.1, 0] if k == 2 else [0, 0, 0.1])
    for angle in (None, *range(5)):
        both = np.stack([facets, facets + up + [0.4, 0, 0]])
        if angle is not None and k > 2:
            both = Motion.random(rng)(both.reshape(-1, 3)).reshape(both.shape)
        assert within(*both, 0.1001)
        assert not within(*both, 0.0999)


def test_groups_without_facets_are_not_near():
    none, one = np.empty((0, 4, 3)), np.zeros((1, 4, 3))
    assert not within(none, one, np.inf)
    assert not within(one, none, 1.0)


def test_wrong_rows_are_refused():
    facets, x = np.array([[0, 1, 2]], dtype=np.int32), np.zeros((3, 3))
    with pytest.raises(ValueError, match="others"):
        _kernels.facets_may_be_within(x, facets, facets[:, :2].copy(), 0.1)
    with pytest.raises(ValueError, match="facets: expected row numbers of x"):
        _kernels.facets_may_be_within(x, facets + 1, facets, 0.1)
