"""Facets of a rigid body with an exact spherical surface as candidates."""

import copy

import numpy as np

from dolfinx_nts._kernels import HYSTERESIS
from dolfinx_nts.common.arrays import Floats, Ints, indices
from dolfinx_nts.model.kinematics import ContactKinematics, Slip
from dolfinx_nts.model.obstacles.rigid_shapes import RigidSphere
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.search.points import ContactPoints
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates
from dolfinx_nts.search.smooth.smooth_candidates import SmoothCandidates

__all__ = ["SphereCandidates", "SphereSlip"]

# Least cosine of the angle between the normal at t_n, rotated with the sphere, and the present one
# [-].
_SIDEWAYS = 1e-6


class SphereSlip(Slip):
    r"""Slip along tangents :math:`e_i` that rotate with a sphere.

    At t_{n+1} a node is at another point of the sphere, where :math:`e_i` have the normal
    components :math:`s_i = e_i \cdot n`. Schemes with forces at t_{n+1} use the tangents

    .. math:: e'_i = e_i + \frac{s_i}{c (1 + c)} s_j e_j - \frac{s_i}{c} n, \quad
       c^2 = 1 - s_j s_j,

    which are :math:`e_i` after the smallest rotation to the normal there.

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
        """Derivative of t . force with respect to the coordinates, see `Slip.tangent`."""
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


class SphereCandidates(SmoothCandidates):
    r"""Facets of a sphere near the points of this rank.

    Facets are only used to find nearby points. Gap, force and slip are evaluated on the sphere,
    whose control points are the centre :math:`c` and points :math:`p_i` that rotate with it, see
    `SphereFrame`. Normal forces act on the centre. Friction acts on the material point of the
    contact at t_n, :math:`x_c = c + \nu_i (p_i - c)`, along tangents :math:`e = \tau_i (p_i - c)/R`
    of the body: the slip is the change of :math:`(x - x_c) \cdot e`, as for facets.

    Args:
        found: The facets, with the nodes that define the sphere and their weights.
        k: Number of vertices of a facet.
        sphere: The sphere in the reference configuration.
        bulge: Largest distance of the sphere from the facets [m].
    """

    # The kernel of facets does not apply to spheres.
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
        some = indices(segment >= 0)
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
        part[:2] = 1.0, -1.0  # force on the point, and its reaction on the centre
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
        frame = frame_n.copy()  # in the plane the second tangent is along z
        frame[:, : num_axes - 1] = e[:, : num_axes - 1]
        right = np.ones(len(x))
        return Slip(value, force, gradient, w, b, frame_n=frame_n, frame=frame, orientation=right)

    def _tangents(self, x_n: Floats, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Tangents at t_n, weights of the control points in these, and tangents at t_{n+1}.

        Shapes ``(m, 2, 3)``, ``(m, 2, 1+c)`` and ``(m, 2, 3)``; in the plane the second tangent is
        along z at t_n and zero otherwise.
        """
        frame_n, _ = self._sphere.frames(*(self._at_rest(y) for y in (x_n, x)))
        axes = (x_n[:, 2:] - x_n[:, 1:2]) / self._sphere.radius
        tau = np.einsum("mki,mai->mak", axes, frame_n) / self._sphere.radius
        b = np.zeros((len(x), 2, x.shape[1]))
        b[:, :, 1], b[:, :, 2:] = -tau.sum(axis=2), tau
        return frame_n, b, b @ x

    def slip(
        self, measure: str, points: ContactPoints, x_n: Floats, x: Floats, segment: Ints
    ) -> Slip:
        slip = super().slip(measure, points, x_n, x, segment)
        pairs_n, pairs, _ = self._both_states(points, x_n, x, segment)
        return SphereSlip(
            slip,
            self._tangents(pairs_n, pairs)[2],
            self.contact("static", points, x_n, x, segment),
        )

    def _at_rest(self, pairs: Floats) -> Floats:
        """Points of pairs in the reference frame of the sphere, ``(m, 3)`` [m]."""
        relative: Floats = pairs[:, 0] - pairs[:, 1] + self._sphere.centre
        return relative
