"""A rigid motion of the whole scene moves the result, nothing else."""

import numpy as np
import pytest

import dolfinx_nts as nts
from helpers import scenes
from helpers.scene import Motion

pytestmark = pytest.mark.serial

# Relative to lengths of about one: rounding and Newton's tolerance,
# amplified by the impacts.
TOLERANCE = 1e-9

schemes = pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.Midpoint])
cells_ = pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])


@schemes
@cells_
@pytest.mark.parametrize("impact", ["elastic", "plastic"])
def test_moved_blocks_have_moved_results(comm, scheme, cell, impact, rng):
    motion = Motion.random(rng)
    fixed, moved = (
        scenes.blocks(comm, scheme, nts.LagrangeMultiplier(impact), cell=cell, motion=m)
        for m in (None, motion)
    )
    before, after = fixed.run(10), moved.run(10)
    difference = np.abs(moved.positions() - motion(fixed.positions())).max()
    assert difference <= TOLERANCE
    assert before.num_active == after.num_active
    assert max(before.num_active) >= 5
    np.testing.assert_allclose(after.energy, before.energy, rtol=TOLERANCE)


def test_moved_ball_and_plate_have_moved_results(comm, rng):
    motion = Motion.random(rng)
    fixed, moved = (scenes.ball_plate(comm, shift=scenes.NO_TIES, motion=m) for m in (None, motion))
    before, after = fixed.run(15), moved.run(15)
    difference = np.abs(moved.positions() - motion(fixed.positions())).max()
    assert difference <= TOLERANCE
    assert before.num_active == after.num_active
    assert max(before.num_active) >= 3


@schemes
def test_blocks_in_a_moving_frame_have_the_same_result(comm, scheme):
    # A uniform velocity of all bodies (Galilei) changes nothing.
    fixed, moved = (scenes.blocks(comm, scheme) for _ in range(2))
    velocity = np.array([2.0, -1.0, 3.0])
    moved.stepper.v.x.array.reshape(-1, 3)[:] += velocity
    fixed.run(10)
    moved.run(10)
    shifted = fixed.positions() + 10 * scenes.BLOCK_STEP * velocity
    assert np.abs(moved.positions() - shifted).max() <= TOLERANCE
