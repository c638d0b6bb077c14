"""Normals of slip frames, against NumPy's cross product."""

import numpy as np
import pytest

from dolfinx_nts.model.kinematics import Slip

pytestmark = pytest.mark.serial


def test_normal_of_a_collapsed_segment_is_nan_without_a_warning(rng):
    frame = rng.normal(size=(5, 2, 3))
    frame[1] = 0.0
    frame[3, 1] = 2.0 * frame[3, 0]  # parallel tangents
    orientation = np.array([1.0, 1.0, -1.0, 1.0, -1.0])
    arrays = (np.zeros((5, 2)), np.zeros((5, 2, 9)), np.zeros((5, 2, 9)))
    slip = Slip(*arrays, frame_n=frame, frame=frame, orientation=orientation)
    with np.errstate(all="raise"):
        normals = [slip.normal_n, slip.normal]
    normal = np.cross(frame[:, 0], frame[:, 1])
    good = [0, 2, 4]
    for unit in normals:
        assert np.isnan(unit[[1, 3]]).all()
        expected = normal[good] / np.linalg.norm(normal[good], axis=1, keepdims=True)
        np.testing.assert_allclose(unit[good], orientation[good, None] * expected, rtol=1e-14)
