"""Slip of nodes whose multipliers act on the contact points around them (mortar)."""

from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.model.kinematics import Slip
from dolfinx_nts.search.mortar_points import MortarPoints

__all__ = ["MortarSlip", "NodalFrames"]


class NodalFrames(NamedTuple):
    """Frames of nodes at t_n, into which those of the segments of their points are turned.

    Attributes:
        at_nodes: Orthonormal tangents at the nodes, shape ``(m, 2, 3)``.
        parts: Part of component b of the slip of each point in component a of that of each
            node, by shares, shape ``(i, 2, 2)``.
    """

    at_nodes: Floats
    parts: Floats

    @classmethod
    def of(cls, points: MortarPoints, slip: Slip) -> "NodalFrames":
        """Make them from frames and normals of the segments of the points at t_n. Local."""
        shares = points.shares
        at_nodes = _tangents(shares.sums(slip.normal_n[shares.point]))
        turns = _turns(at_nodes[shares.node], slip.frame_n[shares.point])
        return cls(at_nodes, shares.value[:, None, None] * turns)


class MortarSlip(Slip):
    """Mean slip of the points of each node, see `Slip`.

    Turns of frames and the shares of nodes in points are constants of the step, so that what
    holds for the slip of each point holds for the mean: the work of tractions is exact, and
    momenta are conserved.

    Args:
        points: Points of the nodes.
        slip: Their slip.
        frames: Frames of the nodes.
    """

    def __init__(self, points: MortarPoints, slip: Slip, frames: NodalFrames) -> None:
        """Sum up."""
        self._points, self._slip, self._parts = points, slip, frames.parts
        shares = points.shares
        m = len(shares.area)
        of_points = np.concatenate([slip.value[:, :, None], slip.frame], axis=2)
        turned = frames.parts @ of_points[shares.point]
        means = shares.reduced(np.add, turned, 0.0)
        rows = np.zeros((m, 2, 2, 3 * points.lists.shape[1]))
        both = np.stack([slip.force, slip.gradient], axis=2)
        for a, b in np.ndindex(2, 2):
            rows[:, a] += points.rows(both[:, b], shares.weighted(frames.parts[:, a, b]))
        super().__init__(
            means[:, :, 0],
            *rows.transpose(2, 0, 1, 3).copy(),
            frame_n=frames.at_nodes,
            frame=_orthonormal(means[:, :, 1:]),
            orientation=np.ones(m),
        )

    def hessian(self, t: Floats) -> Floats:
        """Second derivative of slips of points, ``(b, 3 k, 3 k)``, see `PairBlocks`."""
        shares, of_points = self._points.shares, np.empty_like(self._slip.value)
        of_shares = np.einsum("iab,ia->ib", self._parts, t[shares.node])
        for b in range(2):
            of_points[:, b] = np.bincount(shares.point, of_shares[:, b], len(of_points))
        return self._points.blocks(np.ones(len(of_points)), self._slip.hessian(of_points))


def _tangents(normal: Floats) -> Floats:
    """Orthonormal tangents, ``(m, 2, 3)``, to planes with normals of any length, ``(m, 3)``."""
    normal = normal / np.linalg.norm(normal, axis=1)[:, None]
    # The second is near the coordinate axis that is farthest from the normal, the last of several:
    # in two dimensions it is that across the plane.
    axis = np.eye(3)[2 - np.abs(normal[:, ::-1]).argmin(axis=1)]
    second = axis - np.einsum("mi,mi->m", axis, normal)[:, None] * normal
    second /= np.linalg.norm(second, axis=1)[:, None]
    return np.stack([np.cross(second, normal), second], axis=1)


def _turns(to: Floats, frame: Floats) -> Floats:
    """Orthogonal matrices nearest to the products of two frames, ``(i, 2, 3)``; ``(i, 2, 2)``."""
    M = np.einsum("iac,ibc->iab", to, frame)
    # Frames of segments may be left-handed.
    sign = np.where(np.linalg.det(M) < 0, -1.0, 1.0)
    cofactor = np.stack([M[:, 1, ::-1], M[:, 0, ::-1]], axis=1) * [[1, -1], [-1, 1]]
    turns = M + sign[:, None, None] * cofactor
    unit: Floats = turns / np.hypot(turns[:, 0, 0], turns[:, 0, 1])[:, None, None]
    return unit


def _orthonormal(frame: Floats) -> Floats:
    """Orthonormal vectors nearest to two, ``(m, 2, 3)``: the polar factor, which no axis marks."""
    G = np.einsum("mai,mbi->mab", frame, frame)
    adjugate = G[:, ::-1, ::-1] * [[1, -1], [-1, 1]]
    area = np.sqrt(np.einsum("mi,mi->m", G[:, 0], adjugate[:, 0]))
    length = np.sqrt(G[:, 0, 0] + G[:, 1, 1] + 2 * area)
    # (G^-1/2) of a matrix of two rows.
    root = (adjugate + area[:, None, None] * np.eye(2)) / (area * length)[:, None, None]
    result: Floats = root @ frame
    return result
