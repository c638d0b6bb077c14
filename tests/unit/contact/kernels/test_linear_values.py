"""Values of springs by the linear system, pair by pair."""

from types import SimpleNamespace

import numpy as np
import pytest

from dolfinx_nts.contact.implicit.normal.linear_values import LinearValues
from dolfinx_nts.model.frames import Frame, MovingFrame, Placement, rotation_by


def pairs(node, segment):
    """Pairs of nodes of one point each."""
    node = np.array(node, dtype=np.int32)
    return SimpleNamespace(node=node, segment=np.array(segment, dtype=np.int32), dofs=node[:, None])


@pytest.mark.parametrize("shape", [(), (2,)])
def test_values_follow_gradients_on_the_same_segment(shape, rng):
    values, x = LinearValues(Frame(), 4, *shape), rng.normal(size=(4, 3))
    first, measured = pairs([0, 2, 3], [5, 6, 7]), rng.normal(size=(3, *shape))
    gradients = rng.normal(size=(3, *shape, 3))
    assert values.of(first, x, measured, gradients) is measured
    moved, later = x + rng.normal(size=x.shape), rng.normal(size=(3, *shape))
    found = values.of(pairs([0, 1, 3], [5, 6, 8]), moved, later, gradients)
    expected = measured[0] + gradients[0] @ (moved - x)[0]
    np.testing.assert_allclose(found[0], expected, rtol=1e-14)
    np.testing.assert_array_equal(found[1:], later[1:])  # a new pair, and another segment


@pytest.mark.parametrize("shape", [(), (2,)])
def test_a_rotated_obstacle_moves_between_two_iterates(shape, rng):
    """Gradients are those in space, for any rotation of the obstacle, whose own motion counts."""
    origin, centre, turn = rng.normal(size=(3, 3))
    places = [Placement(centre + part, rotation_by(part * turn)) for part in (1.0, 1.5, 2.0)]
    frame = MovingFrame(origin, *places)
    values, x = LinearValues(frame, 1, *shape), rng.normal(size=(1, 3))
    one, gradients = pairs([0], [0]), rng.normal(size=(1, *shape, 3))
    measured, dx = rng.normal(size=(1, *shape)), rng.normal(size=(1, 3))
    frame.advance_to(0.25)
    values.of(one, frame.at_end(x), measured, gradients)
    frame.advance_to(0.75)
    found = values.of(one, frame.at_end(x + dx), np.zeros((1, *shape)), gradients)
    travel = 0.5 + np.cross(0.5 * turn, x - (centre + 1.25))
    np.testing.assert_allclose(found[0], measured[0] + gradients[0] @ (dx - travel)[0], rtol=1e-12)


@pytest.mark.parametrize("shape", [(), (2,)])
def test_pairs_come_and_go(shape):
    values, x = LinearValues(Frame(), 2, *shape), np.zeros((2, 3))
    none, gradients = np.zeros((0, *shape)), np.zeros((0, *shape, 3))
    for _ in range(2):
        assert len(values.of(pairs([], []), x, none, gradients)) == 0
    one = np.ones((1, *shape))
    np.testing.assert_array_equal(values.of(pairs([1], [0]), x, one, np.zeros((1, *shape, 3))), one)
    values.forget()
    assert values.of(pairs([1], [0]), x, one, np.zeros((1, *shape, 3))) is one
