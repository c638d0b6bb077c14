"""Slip of nodes in mortar contact: weighted mean of the slips of the quadrature points."""

from typing import NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.model.frames import TurnedSlip
from dolfinx_nts.model.kinematics import Slip
from dolfinx_nts.search.mortar.mortar_points import MortarPoints

__all__ = ["NodalFrames", "mean_slip"]


class NodalFrames(NamedTuple):
    """Nodal frames at t_n, and rotations from the frames of the contact points to these.

    Attributes:
        at_nodes: Orthonormal tangents at the nodes, shape ``(m, 2, 3)``.
        weights: Weight of component b of the slip of a point in component a of the slip of a node,
            for each entry of `Shares`, shape ``(i, 2, 2)``.
    """

    at_nodes: Floats
    weights: Floats

    @classmethod
    def of(cls, points: MortarPoints, slip: Slip) -> "NodalFrames":
        """Compute nodal frames from the frames and normals of the segments at t_n. Local."""
        shares = points.shares
        at_nodes = _tangents(shares.sums(slip.normal_n[shares.point]))
        of_shares = shares.start, shares.point, shares.value
        return cls(at_nodes, _kernels.turn_shares(*of_shares, at_nodes, slip.frame_n))


class MortarSlip(Slip):
    """Mean slip of the points of each node.

    Rotations of frames, and shares of nodes in points, are constant in a step. As for the slip of
    each point, the work of tractions is therefore exact, and momenta are conserved.

    Args:
        points: Points of the nodes.
        slip: Their slip.
        frames: Frames of the nodes.
    """

    def __init__(self, points: MortarPoints, slip: Slip, frames: NodalFrames) -> None:
        """Average the slips of the points for each node."""
        shares = points.shares
        self._points, self._slip = points, slip
        self._of_shares = shares.start, shares.point, frames.weights
        value, frame = _kernels.sum_slip(*self._of_shares, slip.value, slip.frame)
        rows = (points.rows(values, frames.weights) for values in (slip.force, slip.gradient))
        kept = {"frame_n": frames.at_nodes, "frame": frame, "orientation": np.ones(len(value))}
        super().__init__(value, *rows, **kept)

    def hessian(self, t: Floats) -> Floats:
        """Second derivative of the slips of the points, shape ``(b, 3 k, 3 k)`` [N/m]."""
        points, (w, b) = self._points, self._slip.second
        of_points = _kernels.spread_tractions(*self._of_shares, t, len(w))
        to = points.phi, points.patch, len(points.patch_nodes)
        return _kernels.sum_slip_blocks(*to, w, b, of_points)


def mean_slip(points: MortarPoints, slip: Slip, frames: NodalFrames) -> Slip:
    """Mean slip of the points of each node, see `MortarSlip`. Local."""
    if isinstance(slip, TurnedSlip):

        def average(slip: Slip, at_nodes: Floats) -> Slip:
            return MortarSlip(points, slip, NodalFrames(at_nodes, frames.weights))

        return slip.averaged(average, frames.at_nodes)
    return MortarSlip(points, slip, frames)


def _tangents(normal: Floats) -> Floats:
    """Orthonormal tangents, ``(m, 2, 3)``, to planes with normals of any length, ``(m, 3)``."""
    normal = normal / np.linalg.norm(normal, axis=1)[:, None]
    # The second tangent is close to the coordinate axis with the largest angle to the normal, or
    # the last such axis. In two dimensions this is the z axis.
    axis = np.eye(3)[2 - np.abs(normal[:, ::-1]).argmin(axis=1)]
    second = axis - np.einsum("mi,mi->m", axis, normal)[:, None] * normal
    second /= np.linalg.norm(second, axis=1)[:, None]
    return np.stack([np.cross(second, normal), second], axis=1)
