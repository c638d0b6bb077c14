"""Properties of the contact kernels for every geometry, or a reported failure.

Hypothesis looks for a counterexample; the examples are the same in every run.
"""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from dolfinx_nts import _kernels
from reference.bulk import rotation

pytestmark = pytest.mark.serial

kernels = settings(derandomize=True, database=None, deadline=None, max_examples=200)
SIDE = {3: [[0, 0, 0], [1, 0, 0], [0, 1, 0]], 4: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]}
# Round-off of numbers of order one; gradients of nearly flat segments are larger.
ROUND_OFF = 1e-11


def vectors(rows, size):
    """Rows of three numbers up to a size."""
    number = st.floats(-size, size, allow_subnormal=False)
    return arrays.arrays(np.float64, (rows, 3), elements=number)


@st.composite
def steps(draw):
    """Two states of a node and its distorted segment, and the sign of the normal."""
    k = draw(st.sampled_from([3, 4]))
    x_n = np.vstack([[0.3, 0.3, 0.1], SIDE[k]]) + draw(vectors(1 + k, 0.15))
    x = x_n + draw(vectors(1 + k, 0.1))
    sign = draw(st.sampled_from([-1.0, 1.0]))
    return x_n[None], x[None], np.array([sign])


@st.composite
def motions(draw):
    """A rotation and a translation."""
    axis = draw(vectors(1, 1.0))[0] + [0, 0, 1.5]
    return rotation(axis, draw(st.floats(-3, 3))), draw(vectors(1, 1.0))[0]


def conserving(x_n, x, sign):
    """Gaps, force and tangent; None if the kernel reports a failure."""
    gap_n, gap, force, _, tangent, turn = _kernels.contact_conserving(x_n, x, sign)
    if np.isnan(turn[0]):
        return None
    assert np.isfinite(force).all() and np.isfinite(tangent).all()
    return gap_n[0], gap[0], force[0].reshape(-1, 3), tangent[0]


@kernels
@given(steps())
def test_contact_does_the_work_of_the_gap_and_gives_no_momentum(step):
    assume((result := conserving(*step)) is not None)
    gap_n, gap, force, _ = result
    x_n, x, _ = step
    tolerance = ROUND_OFF * np.abs(force).max()
    assert abs(np.sum(force * (x - x_n)[0]) - (gap - gap_n)) <= tolerance
    assert np.abs(force.sum(axis=0)).max() <= tolerance
    assert np.abs(np.cross((x_n + x)[0] / 2, force).sum(axis=0)).max() <= tolerance


@kernels
@given(steps(), motions())
def test_force_and_gap_turn_with_the_scene(step, motion):
    (x_n, x, sign), (Q, c) = step, motion
    first, turned = conserving(*step), conserving(x_n @ Q.T + c, x @ Q.T + c, sign)
    assume(first is not None and turned is not None)
    tolerance = ROUND_OFF * np.abs(first[2]).max()
    assert abs(first[1] - turned[1]) <= tolerance
    assert np.abs(first[2] @ Q.T - turned[2]).max() <= tolerance


@kernels
@given(steps(), arrays.arrays(np.float64, 15, elements=st.floats(-1, 1)))
def test_tangent_is_the_derivative_of_the_force(step, direction):
    x_n, x, sign = step
    assume((middle := conserving(*step)) is not None)
    d = direction[: x[0].size]
    size = 1e-3
    errors = []
    for h in (size, size / 2):
        sides = [conserving(x_n, x + s * h * d.reshape(x.shape), sign) for s in (1, -1)]
        assume(all(side is not None for side in sides))
        quotient = (sides[0][2] - sides[1][2]).ravel() / (2 * h)
        errors.append(np.abs(quotient - middle[3] @ d).max())
    # A central difference errs by h^2: a quarter with half the step.
    scale = np.abs(middle[3]).max() + 1
    assert errors[1] <= 0.3 * errors[0] + 1e-8 * scale


@pytest.mark.parametrize("k", [3, 4])
@kernels
@given(st.data())
def test_segments_of_any_shape_give_numbers_or_no_turn(k, data):
    # Points, lines, crossed and huge segments, too.
    number = st.floats(-1e6, 1e6) | st.sampled_from([0.0, 1.0, -1.0])
    x_n, x = (data.draw(arrays.arrays(np.float64, (1, 1 + k, 3), elements=number)) for _ in "ab")
    for scheme in ("conserving", "midpoint", "static"):
        *values, turn = getattr(_kernels, f"contact_{scheme}")(x_n, x, np.ones(1))
        if not np.isnan(turn[0]):
            assert all(np.isfinite(value).all() for value in values)


def test_a_segment_that_becomes_a_line_gives_no_number_at_all():
    # det m of its metric is round-off above zero, and its normal 0/0.
    line = [[1.0, -1.0, 1.0], [-1.0, -1.0, 1.0], [523080.7519677214, -1.0, 1.0]]
    line.append([654248.5928225648, -1.0, 1.0])
    x_n = np.array([[[-322852.58790032566, -1.0, 0.0], *line]])
    x = np.array([[[-577776.6, 0.0, -447435.2], [0.0, 765343.4, 1.0], [-441241.4, -1.0, -12756.0]]])
    x = np.concatenate([x, [[[1.0, 146478.1, 574289.3], [999639.3, -841963.0, 494726.6]]]], axis=1)
    for scheme in ("conserving", "midpoint", "static"):
        for value in getattr(_kernels, f"contact_{scheme}")(x_n, x, np.ones(1)):
            assert np.isnan(value).all()
