"""A rigid motion of the whole scene moves the result, nothing else."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.contact.implicit.mortar.mortar_pairing import MortarPairing
from dolfinx_nts.contact.implicit.pairing import NodePairing
from dolfinx_nts.model.kinematics import Slip
from helpers import scenes
from helpers.scene import Motion

pytestmark = pytest.mark.serial

# Tolerance relative to lengths of about one: rounding and Newton's tolerance, amplified by the
# impacts.
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


class TurnedSlip(Slip):
    """Slip whose components are those along other tangents, turned by ``Q``, ``(2, 2)``."""

    def __init__(self, slip, Q):
        """Rotate vectors and tensors."""
        turned = (np.einsum("ab,mb...->ma...", Q, part) for part in (slip.value, slip.force))
        gradient, *frames = (
            np.einsum("ab,mbi->mai", Q, part) for part in (slip.gradient, slip.frame_n, slip.frame)
        )
        kept = {"frame_n": frames[0], "frame": frames[1], "orientation": slip.orientation}
        super().__init__(*turned, gradient, *slip.second, **kept)
        self._of, self._turn = slip, Q

    def hessian(self, t):
        """See `Slip.hessian`."""
        return self._of.hessian(t @ self._turn)


@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
@pytest.mark.parametrize("eps_T", [None, 3e4])
def test_friction_does_not_depend_on_the_choice_of_tangents(comm, monkeypatch, rng, method, eps_T):
    """Nodes that find other segments, or other points, find other tangents within a step."""

    def impact():
        friction = nts.Coulomb(0.5, eps_T=eps_T)
        return scenes.ball_plate(comm, friction=friction, method=method, shift=scenes.NO_TIES)

    fixed, turned = impact(), impact()
    before = [fixed.stepper.advance().newton_iterations for _ in range(15)]
    kind = MortarPairing if method == "mortar" else NodePairing
    measure = kind.slip

    def slip(*args):
        angle = rng.uniform(0.0, 2 * np.pi)
        c, s = np.cos(angle), np.sin(angle)
        return TurnedSlip(measure(*args), np.array([[c, s], [-s, c]]))

    monkeypatch.setattr(kind, "slip", slip)
    after = [turned.stepper.advance().newton_iterations for _ in range(15)]
    assert after == before
    assert np.abs(turned.positions() - fixed.positions()).max() <= TOLERANCE
    assert turned.stepper.contacts[0].history.active.sum() >= 3
