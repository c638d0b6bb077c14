"""Slip of pairs in a step, by either measure: kernel values with their names.

d stands for the 3(1+k) coordinates of a pair, its node first.
"""

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats

__all__ = ["ConvectiveSlip", "Slip"]


class Slip:
    """Slip of pairs, see `cpp/nts/contact/slip.h`.

    Args:
        values: What `SegmentCandidates.slip` gives.

    Attributes:
        value: Slip of the step, shape ``(m, 2)`` [m].
        force: Force per traction, of the step, shape ``(m, 2, d)``.
        gradient: Gradient of the slip at x, shape ``(m, 2, d)``.
        frame_n, frame: Tangents at t_n, orthonormal, and what has become
            of them at x, shape ``(m, 2, 3)``.
        normal_n, normal: Outward unit normals with them, ``(m, 3)``.
    """

    def __init__(self, values: tuple[Array, ...]) -> None:
        """Name the values."""
        self.value, self.force, self.gradient, *self._second = values[:-3]
        self.frame_n, self.frame, orientation = values[-3:]
        normals = [np.cross(frame[:, 0], frame[:, 1]) for frame in (self.frame_n, self.frame)]
        self.normal_n, self.normal = (
            (orientation / np.linalg.norm(normal, axis=1))[:, None] * normal for normal in normals
        )

    def work(self, t: Floats, dx: Floats) -> Floats:
        """Work of a traction in the step, which displaces by dx, ``(m,)`` [J].

        Args:
            t: Traction, shape ``(m, 2)`` [N].
            dx: Displacement of the pair's nodes, shape ``(m, 1+k, 3)`` [m].
        """
        work: Floats = np.einsum("mi,mi->m", t, self.value)
        return work

    def hessian(self, t: Floats) -> Floats:
        """Twice the derivative of t . force by the pair's coordinates."""
        w, b = self._second
        outer = np.einsum("ma,mi,mib->mab", w, t, b)
        blocks = outer + outer.transpose(0, 2, 1)
        m, k, _ = blocks.shape
        hessian: Floats = np.einsum("mab,ij->maibj", blocks, np.eye(3))
        return hessian.reshape(m, 3 * k, 3 * k)


class ConvectiveSlip(Slip):
    """The same by coordinates, see `cpp/nts/contact/convective_slip.h`."""

    def work(self, t: Floats, dx: Floats) -> Floats:
        """Work of a traction in the step, not exactly t . slip."""
        force = np.einsum("mi,mid->md", t, self.force)
        work: Floats = np.einsum("md,md->m", force, dx.reshape(force.shape))
        return work

    def hessian(self, t: Floats) -> Floats:
        """Twice the derivative of t . force by the pair's coordinates."""
        (H,) = self._second
        hessian: Floats = np.einsum("mi,mide->mde", t, H)
        return hessian
