"""Slip of nodes over a sphere that is the surface of a rigid body."""

import copy

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.model.kinematics import ContactKinematics, Slip

__all__ = ["SphereSlip"]

# Least cosine of the angle between the carried normal and that at the node [-].
_SIDEWAYS = 1e-6


class SphereSlip(Slip):
    r"""Slip along tangents :math:`e_i` that a sphere carries along, see `Slip`.

    At t_{n+1} a node has left the point at which it was, so that :math:`e_i` leave the surface
    by :math:`s_i = e_i \cdot n`. Forces of a scheme that has them there act along

    .. math:: e'_i = e_i + \frac{s_i}{c (1 + c)} s_j e_j - \frac{s_i}{c} n, \quad
       c^2 = 1 - s_j s_j,

    which are the tangents turned with the normal on the shortest way.

    Args:
        slip: The slip, with the tangents of t_{n+1} carried along.
        e: These tangents, zero across the plane in two dimensions, shape ``(m, 2, 3)``.
        contact: Gap and force of the scheme ``"static"`` of the same pairs.
    """

    def __init__(self, slip: Slip, e: Floats, contact: ContactKinematics) -> None:
        frames = {"frame_n": slip.frame_n, "frame": slip.frame, "orientation": slip.orientation}
        super().__init__(slip.value, slip.force, slip.gradient, *slip.second, **frames)
        self._e, self._contact, self._is_at_end = e, contact, False
        self._s = np.einsum("mki,mi->mk", e, contact.force[:, :3])
        self._c = np.sqrt(np.maximum(1 - np.einsum("mk,mk->m", self._s, self._s), _SIDEWAYS**2))

    def at_end(self) -> "SphereSlip":
        end = copy.copy(self)
        s, c = self._s, self._c[:, None]
        along = np.einsum("mk,mkd->md", s, self.gradient) / (c * (1 + c))
        along -= self._contact.force / c
        end.force, end._is_at_end = self.gradient + s[:, :, None] * along[:, None], True
        return end

    def tangent(self, t: Floats) -> Floats:
        """Derivative of t . force by the coordinates, see `Slip.tangent`."""
        if not self._is_at_end:
            return super().tangent(t)
        s, c, force = self._s, self._c[:, None], self._contact.force
        m, d = force.shape
        _, b = self.second
        n, dn = force[:, :3], self._contact.tangent[:, :3]
        ds = (b[..., None] * n[:, None, None]).reshape(m, 2, d)
        ds += np.einsum("mki,mid->mkd", self._e, dn)
        dc = -np.einsum("mk,mkd->md", s, ds) / c
        part = 1 / (c * (1 + c))
        d_part = -(part**2) * (1 + 2 * c) * dc
        p, dp = np.einsum("mk,mk->m", s, t)[:, None], np.einsum("mk,mkd->md", t, ds)
        of_tangents = t + s * p * part
        d_tangents = (p * part)[:, None] * ds + s[:, :, None] * (part * dp + p * d_part)[:, None]
        d_normal = p / c**2 * dc - dp / c
        tangent: Floats = self.hessian(of_tangents)
        tangent = tangent - (p / c)[:, None] * self._contact.tangent
        tangent += np.einsum("mkd,mke->mde", self.gradient, d_tangents)
        tangent += force[:, :, None] * d_normal[:, None]
        return tangent
