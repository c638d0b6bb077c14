"""Slip of nodes over an exact surface, whose tangents turn as nodes move along it."""

import copy

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.model.kinematics import Slip

__all__ = ["SurfaceSlip", "turned_tangents"]

# Least 1 + cos of the angle by which normals turn [-]: half a turn has no shortest way.
_REVERSED = 1e-12


class SurfaceSlip(Slip):
    """Displacement of nodes in the tangent plane of t_n of an exact surface, see `Slip`.

    Forces of a scheme that has them at t_{n+1} act along the surface there.

    Args:
        value: Slip of the step, shape ``(m, 2)`` [m].
        frame_n: Orthonormal tangents at t_n, shape ``(m, 2, 3)``.
        frame: The same at t_{n+1}, see `turned_tangents`.
        curvature: Derivative of the normal at t_{n+1} by the position, ``(m, 3, 3)`` [1/m].
    """

    def __init__(self, value: Floats, frame_n: Floats, frame: Floats, curvature: Floats) -> None:
        m = len(value)
        frames = {"frame_n": frame_n, "frame": frame, "orientation": np.ones(m)}
        second = np.ones((m, 1)), np.zeros((m, 2, 1))
        super().__init__(value, frame_n, frame_n, *second, **frames)
        self._curvature, self._is_at_end = curvature, False

    def at_end(self) -> "SurfaceSlip":
        end = copy.copy(self)
        end.force, end._is_at_end = self.frame, True
        return end

    def tangent(self, t: Floats) -> Floats:
        """Derivative of t . force by the coordinates, see `Slip.tangent`."""
        if not self._is_at_end:
            return super().tangent(t)
        n_n, n, D = self.normal_n, self.normal, self._curvature
        along = np.einsum("mi,mij->mj", t, self.frame_n)
        share = np.einsum("mi,mi->m", along, n)[:, None]
        whole = np.maximum(1 + np.einsum("mi,mi->m", n_n, n), _REVERSED)[:, None]
        turn = np.einsum("mi,mij->mj", along / whole - share / whole**2 * n_n, D)
        tangent: Floats = -(n_n + n)[:, :, None] * turn[:, None] - (share / whole)[:, :, None] * D
        return tangent


def turned_tangents(frame_n: Floats, normal_n: Floats, normal: Floats) -> Floats:
    """Turn tangents with a normal on the shortest way. Local.

    Args:
        frame_n: Tangents, shape ``(m, 2, 3)``.
        normal_n: Unit normals to them, shape ``(m, 3)``.
        normal: Unit normals after the turn, shape ``(m, 3)``.

    Returns:
        Tangents after the turn, of the same lengths and angles, shape ``(m, 2, 3)``.
    """
    whole = np.maximum(1 + np.einsum("mi,mi->m", normal_n, normal), _REVERSED)
    share = np.einsum("mki,mi->mk", frame_n, normal) / whole[:, None]
    frame: Floats = frame_n - share[:, :, None] * (normal_n + normal)[:, None]
    return frame
