"""Segments of a rigid body that stand for the sphere that it is."""

import numpy as np

from dolfinx_nts._kernels import HYSTERESIS
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.rigid_shapes import RigidSphere
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.search.points import ContactPoints
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates
from dolfinx_nts.search.smooth_candidates import SmoothCandidates
from dolfinx_nts.search.sphere_slip import SphereSlip

__all__ = ["SphereCandidates"]


class SphereCandidates(SmoothCandidates):
    r"""Facets of a sphere within reach of this rank's points, see `Candidates`.

    Facets tell which points are near; gap, force and slip are those of the sphere, whose control
    points are the centre :math:`c` and points :math:`p_i` that turn with it, see `SphereFrame`.
    The force of a gap acts on the centre. Friction acts on the point of the body at which contact
    was at t_n, :math:`x_c = c + \nu_i (p_i - c)`, along tangents :math:`e = \tau_i (p_i - c)/R` of
    the body: the slip is the change of :math:`(x - x_c) \cdot e`, as of facets.

    Args:
        found: The facets, with the nodes that carry the sphere and their weights.
        k: Number of vertices of a facet.
        sphere: The sphere in the reference configuration.
        bulge: How far it is outside of the facets at most [m].
    """

    # Springs of facets would see facets.
    penalty_forces = Candidates.penalty_forces

    def __init__(self, found: FoundSegments, k: int, sphere: RigidSphere, bulge: float) -> None:
        super().__init__(found, k)
        self._sphere, self._bulge = sphere, bulge
        vertices = np.arange(1, 1 + k)
        self.segments = np.ascontiguousarray(self.segments[:, k:])
        self._weights = np.delete(self._weights, vertices, axis=2)

    def pair(
        self,
        points: ContactPoints,
        x: Floats,
        current: Ints,
        reach: float,
        slack: float = HYSTERESIS,
    ) -> tuple[Ints, Floats]:
        far = reach + self._bulge
        segment, gap = SegmentCandidates.pair(self, points, x, current, far, slack)
        some = np.flatnonzero(segment >= 0).astype(np.int32)
        gap[some] = self.gap(points.take(some), x, segment[some])
        segment[gap > reach] = -1
        gap[gap > reach] = np.nan
        return segment, gap

    def gap(self, points: ContactPoints, x: Floats, segment: Ints) -> Floats:
        return self._sphere.distance(self._at_rest(self._patches(points, x, segment)[0]))[0]

    def _kinematics(
        self, scheme: str, x_n: Floats, x: Floats, orientation: Floats
    ) -> ContactKinematics:
        none = np.zeros(len(x), dtype=np.int32)
        of_point = self._sphere.contact(scheme, self._at_rest(x_n), self._at_rest(x), none)
        part = np.zeros(x.shape[1])
        part[:2] = 1.0, -1.0  # of the point and the centre
        m, d = len(x), 3 * len(part)
        return of_point._replace(
            force=np.einsum("a,mi->mai", part, of_point.force).reshape(m, d),
            gradient=np.einsum("a,mi->mai", part, of_point.gradient).reshape(m, d),
            tangent=np.einsum("a,b,mij->maibj", part, part, of_point.tangent).reshape(m, d, d),
        )

    def _slip(self, x_n: Floats, x: Floats, orientation: Floats) -> Slip:
        frame_n, b, e = self._tangents(x_n, x)
        radius, num_axes = self._sphere.radius, x.shape[1] - 2
        axes = (x_n[:, 2:] - x_n[:, 1:2]) / radius
        arm = x_n[:, 0] - x_n[:, 1]
        nu = np.einsum("mki,mi->mk", axes, arm) / np.linalg.norm(arm, axis=1)[:, None]
        w = np.ones((len(x), 2 + num_axes))
        w[:, 1], w[:, 2:] = nu.sum(axis=1) - 1, -nu
        shape = len(x), 2, 3 * w.shape[1]
        r_n, r = (np.einsum("mk,mki->mi", w, y) for y in (x_n, x))
        e_n = b @ x_n
        value = np.einsum("mi,mai->ma", r, e) - np.einsum("mi,mai->ma", r_n, e_n)
        force, gradient = (
            (w[:, None, :, None] * e_[:, :, None] + b[..., None] * r_[:, None, None]).reshape(shape)
            for r_, e_ in (((r_n + r) / 2, (e_n + e) / 2), (r, e))
        )
        frame = frame_n.copy()  # in the plane the second tangent is normal to it
        frame[:, : num_axes - 1] = e[:, : num_axes - 1]
        right = np.ones(len(x))
        return Slip(value, force, gradient, w, b, frame_n=frame_n, frame=frame, orientation=right)

    def _tangents(self, x_n: Floats, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Tangents at t_n, by which control points, and what has become of them at t_{n+1}.

        Shapes ``(m, 2, 3)``, ``(m, 2, 1+c)`` and ``(m, 2, 3)``; in the plane the second is
        normal to it at t_n and zero otherwise.
        """
        frame_n, _ = self._sphere.frames(*(self._at_rest(y) for y in (x_n, x)))
        axes = (x_n[:, 2:] - x_n[:, 1:2]) / self._sphere.radius
        tau = np.einsum("mki,mai->mak", axes, frame_n) / self._sphere.radius
        b = np.zeros((len(x), 2, x.shape[1]))
        b[:, :, 1], b[:, :, 2:] = -tau.sum(axis=2), tau
        return frame_n, b, b @ x

    def slip(self, law: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints) -> Slip:
        slip = super().slip(law, points, x_n, x, segment)
        pairs_n, pairs, _ = self._both_states(points, x_n, x, segment)
        return SphereSlip(
            slip,
            self._tangents(pairs_n, pairs)[2],
            self.contact("static", points, x_n, x, segment),
        )

    def _at_rest(self, pairs: Floats) -> Floats:
        """Points relative to where the sphere is declared, by those of pairs, ``(m, 3)`` [m]."""
        relative: Floats = pairs[:, 0] - pairs[:, 1] + self._sphere.centre
        return relative
