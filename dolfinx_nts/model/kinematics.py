"""Kinematics of contact pairs in a step: named results of the kernels.

A pair is a contact point and the vertices of its segment. Arrays are over ``m`` pairs; ``d`` are
the 3 (1+k) coordinates of a pair, the point first. A rigid obstacle has no vertices, so
that d = 3.
"""

import copy
from functools import cached_property
from typing import NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.vectors import cross

__all__ = ["ContactKinematics", "ConvectiveSlip", "Slip"]


class ContactKinematics(NamedTuple):
    """Gap of pairs at both ends of a step and the force of a unit multiplier.

    Attributes:
        gap_n: Gap at t_n, shape ``(m,)`` [m].
        gap: Gap at t_{n+1}, shape ``(m,)`` [m].
        force: Force of the scheme per multiplier, shape ``(m, d)``.
        gradient: Gradient of the gap at t_{n+1}, shape ``(m, d)``.
        tangent: Derivative of ``force``, shape ``(m, d, d)`` [1/m].
        turn: Cosine of the rotation angle of the normal, ``(m,)``; NaN if the pair is degenerate.
    """

    gap_n: Floats
    gap: Floats
    force: Floats
    gradient: Floats
    tangent: Floats
    turn: Floats

    def combined(self, weights: Floats) -> "ContactKinematics":
        """Kinematics in terms of other nodes, whose linear combinations are the nodes of the pairs.

        Args:
            weights: Weight of each of j other nodes in each of k nodes, shape ``(m, k, j)``.
        """
        m, k, j = weights.shape
        to_nodes = weights.swapaxes(1, 2)
        force, gradient = (
            (to_nodes @ values.reshape(m, k, 3)).reshape(m, 3 * j)
            for values in (self.force, self.gradient)
        )
        # The weights are applied to rows, then to rows of the transposed matrix.
        tangent = self.tangent
        for d in (k, j):
            tangent = (to_nodes @ tangent.reshape(m, k, 9 * d)).reshape(m, 3 * j, 3 * d)
            tangent = tangent.swapaxes(1, 2)
        return self._replace(force=force, gradient=gradient, tangent=tangent)


class Slip:
    """Slip of pairs in a step in the objective measure, see `cpp/nts/contact/slip.h`.

    Args:
        value: Slip of the step, shape ``(m, 2)`` [m].
        force: Force of the scheme per traction, shape ``(m, 2, d)``.
        gradient: Gradient of the slip at t_{n+1}, shape ``(m, 2, d)``.
        *second: Second derivatives for `hessian`, as returned by the kernel.
        frame_n: Orthonormal tangents at t_n, shape ``(m, 2, 3)``.
        frame: Convected tangents at t_{n+1}, shape ``(m, 2, 3)``.
        orientation: Orientation of the segments, shape ``(m,)``.

    Attributes:
        value, force, gradient, second, frame_n, frame, orientation: The arguments.
    """

    # Ratio of the derivative of the force to the second derivative of the slip [-].
    _share = 0.5

    def __init__(
        self,
        value: Floats,
        force: Floats,
        gradient: Floats,
        *second: Floats,
        frame_n: Floats,
        frame: Floats,
        orientation: Floats,
    ) -> None:
        self.value, self.force, self.gradient, self.second = value, force, gradient, second
        self.frame_n, self.frame = frame_n, frame
        self.orientation = orientation

    # Computed on demand: few evaluations need the normals, which take longer than the kernel.
    @cached_property
    def normal_n(self) -> Floats:
        """Outward unit normals of the frames at t_n, shape ``(m, 3)``, NaN if degenerate."""
        return _normal(self.frame_n, self.orientation)

    @cached_property
    def normal(self) -> Floats:
        """Outward unit normals of the frames at t_{n+1}, shape ``(m, 3)``, NaN if degenerate."""
        return _normal(self.frame, self.orientation)

    def at_end(self) -> "Slip":
        """Slip with the gradient at t_{n+1} as force, for schemes with forces at t_{n+1}."""
        end = copy.copy(self)
        end.force, end._share = self.gradient, 1.0
        return end

    def tangent(self, t: Floats) -> Floats:
        """Derivative of t . force with respect to the coordinates, ``(m, d, d)`` [N/m]."""
        tangent: Floats = self._share * self.hessian(t)
        return tangent

    def work(self, t: Floats, dx: Floats) -> Floats:
        """Work of tractions in the step, shape ``(m,)`` [J].

        Args:
            t: Traction, shape ``(m, 2)`` [N].
            dx: Displacement of the pairs in the step, shape ``(m, d)`` [m].
        """
        work: Floats = np.einsum("mi,mi->m", t, self.value)
        return work

    def combined(self, weights: Floats) -> "Slip":
        """Slip in terms of other nodes, whose linear combinations are the nodes of the pairs.

        Args:
            weights: Weight of each of j other nodes in each of k nodes, shape ``(k, j)`` or
                ``(m, k, j)``.
        """
        (m, k), j = self.second[0].shape, weights.shape[-1]
        w, b = self.second
        to_nodes = np.broadcast_to(weights.swapaxes(-1, -2), (m, j, k))
        force, gradient = (
            (to_nodes[:, None] @ values.reshape(m, 2, k, 3)).reshape(m, 2, 3 * j)
            for values in (self.force, self.gradient)
        )
        w, b = ((to_nodes[:, None] @ values[..., None])[..., 0] for values in (w[:, None], b))
        return Slip(
            self.value,
            force,
            gradient,
            *(w[:, 0], b),
            frame_n=self.frame_n,
            frame=self.frame,
            orientation=self.orientation,
        )

    def hessian(self, t: Floats) -> Floats:
        """Second derivative of t . slip with respect to the coordinates, ``(m, d, d)`` [N/m]."""
        w, b = self.second
        return _kernels.slip_hessian(w, b, t)


class ConvectiveSlip(Slip):
    """Slip in convective coordinates, see `cpp/nts/contact/convective_slip.h`."""

    def work(self, t: Floats, dx: Floats) -> Floats:
        """Work of tractions in the step, which is not exactly t . slip."""
        work: Floats = np.einsum("md,md->m", np.einsum("mi,mid->md", t, self.force), dx)
        return work

    def hessian(self, t: Floats) -> Floats:
        """Twice the derivative of t . force w.r.t. the coordinates, ``(m, d, d)`` [N/m]."""
        (H,) = self.second
        hessian: Floats = np.einsum("mi,mide->mde", t, H)
        return hessian


def _normal(frame: Floats, orientation: Floats) -> Floats:
    """Unit normals, NaN if the tangents are parallel."""
    normal = cross(frame[:, 0], frame[:, 1])
    length = np.linalg.norm(normal, axis=1)
    factor = np.full_like(length, np.nan)
    np.divide(orientation, length, out=factor, where=length > 0)
    unit: Floats = factor[:, None] * normal
    return unit
