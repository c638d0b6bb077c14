"""Stick and slip of two nodes of a roller, in a dense problem, with all states tried."""

from itertools import product

import numpy as np
import pytest

from dolfinx_nts import _kernels
from dolfinx_nts.contact.implicit.friction.lagged_limit import LaggedLimit
from dolfinx_nts.contact.implicit.normal.active_set import BlockPivoting

MU = 0.2
# Two nodes of the inner ring of a roller bearing under one roller, the other nodes eliminated:
# pressing forces and tractions [N], and their derivatives by the slips of both [N/um].
P, T = np.array([2876.0, 895.9]), np.array([647.7, -394.4])
P_BY_SLIP = np.array([[-53.5, -23.1], [232.6, -181.5]])
T_BY_SLIP = -np.array([[980.0, -967.0], [-967.0, 960.0]])
NODE = np.arange(2, dtype=np.int32)
WEIGHT = np.full(2, 100.0)  # of slip in the test for stick [N/um]


def solve(direction, lagged, limit):
    """Slips [um], pressing forces and tractions [N] of nodes that stick (0) or slide (+-1).

    Tractions of sliding nodes are mu times ``limit`` where ``lagged``, or times their own force.
    """
    free, s = np.flatnonzero(direction), MU * direction
    follows = np.where(lagged, 0.0, s)
    A = T_BY_SLIP - follows[:, None] * P_BY_SLIP
    b = np.where(lagged, s * limit, s * P) - T
    slip = np.zeros(2)
    slip[free] = np.linalg.solve(A[np.ix_(free, free)], b[free])
    return slip, P + P_BY_SLIP @ slip, T + T_BY_SLIP @ slip


def test_friction_problem_has_a_single_solution():
    found = []
    for direction in product((-1, 0, 1), repeat=2):
        slip, p, t = solve(np.array(direction), np.zeros(2, dtype=bool), P)
        fits = np.where(direction, slip * direction > 0, np.abs(t) <= MU * p)
        if fits.all() and (p > 0).all():
            found.append(direction)
    assert found == [(0, -1)]


def iterate(comm, has_lag, start, count=200):
    """Iterate the states as `StickSlip` does; return the last ones, and their consistency."""
    pivoting = BlockPivoting(comm, NODE.astype(np.int64), np.array([0, 2]), waits=np.inf)
    lagged = LaggedLimit(2)
    direction = np.array(start)
    none = np.zeros(2, dtype=bool)
    lags, limit = none, P
    for iteration in range(1, count):
        slip, p, t = solve(direction, lags, limit)
        singly = pivoting.changes_singly(NODE)
        lags = singly if has_lag and singly is not None else none
        limit = lagged.normal_forces(NODE, p, lags)
        sliding = direction != 0
        value, traction = (np.stack([v, np.zeros(2)], axis=1) for v in (slip, t))
        heading = np.where(sliding, direction, t)
        trial = traction + WEIGHT[:, None] * value
        after = _kernels.slides(MU * limit, trial, value, heading[:, None] * [1, 0], sliding)
        changes, violators = pivoting.select(after != sliding, NODE, iteration)
        arrives = changes & ~sliding
        direction = np.where(changes, np.where(arrives, np.sign(t), 0), direction).astype(int)
        if not violators and not lags.any():
            return tuple(direction), True
    return tuple(direction), False


@pytest.mark.serial
@pytest.mark.parametrize("start", list(product((-1, 0, 1), repeat=2)))
def test_lagged_limits_converge_to_the_solution(comm, start):
    assert iterate(comm, True, start) == ((0, -1), True)


@pytest.mark.serial
def test_without_lag_nodes_cycle(comm):
    """From where the first node slides on, which nothing contradicts."""
    assert not iterate(comm, False, (1, 0))[1]


def test_limits_stay_while_they_lag():
    limit = LaggedLimit(3)
    node, none = np.arange(3, dtype=np.int32), np.zeros(3, dtype=bool)
    first, second = np.array([1.0, -2.0, 3.0]), np.array([4.0, 5.0, 6.0])
    assert np.array_equal(limit.normal_forces(node, first, none), first)
    lags = np.array([True, True, False])
    assert np.array_equal(limit.normal_forces(node, second, lags), [1.0, 5.0, 6.0])
    assert np.array_equal(limit.normal_forces(node, first, lags), [1.0, 5.0, 3.0])
    assert np.array_equal(limit.normal_forces(node, first, none), first)
    assert np.array_equal(limit.normal_forces(node, second, None), second)
    assert np.array_equal(limit.normal_forces(node, first, lags), [4.0, 5.0, 3.0])
