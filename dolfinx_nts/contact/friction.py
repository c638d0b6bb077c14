r"""Coulomb friction: the traction of a node that slips on its segment.

Functions are pure, of arrays over ``m`` pairs. The slip g_T of a step has two components in an
orthonormal frame of the segment (`cpp/nts/contact/slip.h`). The traction t is a nodal force
that opposes it, with

.. math:: |t| \le \mu p, \qquad p = -\lambda_N.
"""

from typing import Any, Literal, NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arguments import as_call, nonnegative, positive
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.common.declaration import Declaration

__all__ = ["Coulomb", "TractionModel", "slip_energy", "transport"]

# Least 1 + cosine of the angle between two normals [-] by which `transport` divides: it is 0
# where a normal is reversed, and there no rotation is the smallest.
_REVERSED = 1e-12


class TractionModel(NamedTuple):
    """Linear model of the traction for Newton's method, t = explicit + p direction + stiffness dg.

    Attributes:
        explicit: Part that does not scale with the pressing force p, shape ``(m, 2)`` [N].
        direction: Factor of p, shape ``(m, 2)`` [-].
        stiffness: Derivative by the slip at fixed p, shape ``(m, 2, 2)`` [N/m].
    """

    explicit: Floats
    direction: Floats
    stiffness: Floats


class Coulomb(Declaration):
    """Coulomb's law of friction: a node sticks up to mu times the normal force.

    Args:
        mu: Coefficient of friction [-].
        eps_T: Stiffness of the tangential spring at a node [N/m], whose elastic slip is stored
            and given back. None: no spring, so that a sticking node does not move at all
            (multipliers); but normal contact by penalty needs a spring, which then has the
            static stiffness of the node itself, as `Penalty` has.
        law: How slip is measured. ``"objective"``: by an increment that is quadratic in the
            positions, so that dissipation is exact (``cpp/nts/contact/slip.h``).
            ``"convective"``: by the convective coordinates on the segment (Franke, Hesch,
            Betsch 2011, eqs. 60-64); for comparison, with `Midpoint`, `Penalty` and a
            deformable counterpart only.

    Attributes:
        mu, eps_T, law: The arguments.

    Raises:
        ValueError: ``mu`` is negative, ``eps_T`` not positive, or there is no such ``law``.

    Example:
        >>> print(nts.ContactPair(bottom, top, friction=nts.Coulomb(mu=0.3)))
        contact by LagrangeMultiplier, Coulomb friction with mu = 0.3
    """

    def __init__(
        self,
        mu: float,
        eps_T: float | None = None,
        law: Literal["objective", "convective"] = "objective",
    ) -> None:
        """Check the coefficient, the stiffness and the name of the law."""
        nonnegative("a coefficient of friction mu", mu)
        if eps_T is not None:
            positive("a tangential stiffness eps_T", eps_T)
        if law not in ("objective", "convective"):
            raise ValueError(f"expected law 'objective' or 'convective', given {law!r}")
        self.mu, self.eps_T, self.law = float(mu), eps_T, law

    def __repr__(self) -> str:
        """Arguments in one line, eps_T in N/m. Local."""
        return as_call(self, mu=self.mu, eps_T=self.eps_T, law=self.law)

    def slides(
        self, trial: Floats, way: Floats, p: Floats, heading: Floats, sliding: Flags
    ) -> Flags:
        """Decide which nodes slide, shape ``(m,)``, by what is known now. Local.

        Args:
            trial: Traction if the node stuck, shape ``(m, 2)`` [N]: t_n + eps_T g with a
                spring, t + c g without.
            way: Where the node goes: the trial traction with a spring [N], the slip without
                [m], shape ``(m, 2)``.
            p: Pressing force, shape ``(m,)`` [N].
            heading: Direction of the traction, of any length, shape ``(m, 2)``.
            sliding: Whether a node slid in the last iteration, shape ``(m,)``; such a node
                sticks before it slides the other way.
        """
        return _kernels.slides(self.mu, trial, way, p, heading, sliding)

    def spring(
        self, trial: Floats, p: Floats, eps_T: Floats, heading: Floats, sliding: Flags
    ) -> TractionModel:
        """Map trial tractions of tangential springs back to Coulomb's limit. Local.

        A node that slides although its trial traction points backwards has the direction of
        before, which is no solution yet. ``trial`` is t_n + eps_T g, with the stiffness
        ``eps_T`` of the springs, shape ``(m,)`` [N/m]; ``sliding`` tells whether a node slides
        now; the others are as of `slides`.
        """
        turns = np.einsum("mi,mi->m", heading, trial) >= 0
        size, s, across = _polar(np.where((sliding & ~turns)[:, None], heading, trial))
        limit = self.mu * np.maximum(p, 0.0)
        part = np.where(sliding, turns * limit / np.where(size > 0, size, 1.0), 1.0)
        stiffness = np.where(sliding[:, None, None], across, np.eye(2))
        return TractionModel(
            explicit=np.where(sliding[:, None], 0.0, trial),
            direction=np.where(sliding[:, None], self.mu * s, 0.0),
            stiffness=(part * eps_T)[:, None, None] * stiffness,
        )

    def exact(
        self, t: Floats, slip: Floats, p: Floats, c: Floats, heading: Floats, sliding: Flags
    ) -> TractionModel:
        """Model stick and slip without a spring, for one semismooth Newton iteration. Local.

        The condition ``t - min(1, mu p/|t + c g|) (t + c g) = 0`` has the solutions ``g = 0``
        with ``|t| <= mu p`` (stick) and ``t = mu p g/|g|`` (slip); the weight c changes the
        path, not the solution. For a sliding node it is linearised and solved for t, so that a
        slip whose direction is not yet that of the traction turns it. The direction stays where
        there is no such slip, because it points backwards or nothing presses the node.

        Args:
            t: Traction of the last iteration, shape ``(m, 2)`` [N].
            slip: Slip of the step, shape ``(m, 2)`` [m].
            p: Pressing force, shape ``(m,)`` [N].
            c: Weight, part of the stiffness of the node, shape ``(m,)`` [N/m].
            heading: Direction of the traction, of any length, shape ``(m, 2)``.
            sliding: Whether the node slides now, shape ``(m,)``.
        """
        return TractionModel(*_kernels.exact_friction(self.mu, t, slip, p, c, heading, sliding))


def transport(traction: Floats, normal_from: Floats, frame: Floats, normal: Floats) -> Floats:
    """Turn tractions by the smallest rotation between two normals. Local.

    Args:
        traction: Cartesian vectors in the old tangent planes, shape ``(m, 3)`` [N].
        normal_from: Old unit normals, shape ``(m, 3)``.
        frame: New orthonormal frames, shape ``(m, 2, 3)``.
        normal: New unit normals, shape ``(m, 3)``.

    Returns:
        Components in the new frames, shape ``(m, 2)`` [N]; lengths do not change.
    """
    along = np.einsum("mi,mi->m", traction, normal)
    cosine = np.einsum("mi,mi->m", normal_from, normal)
    factor = along / np.maximum(1.0 + cosine, _REVERSED)
    rotated = traction - factor[:, None] * (normal_from + normal)
    components: Floats = np.einsum("mij,mj->mi", frame, rotated)
    return components


def slip_energy(traction: Floats, eps_T: Floats | None) -> Floats:
    """Compute the energy of tangential springs. Local.

    Args:
        traction: Tractions, shape ``(n, 3)`` [N].
        eps_T: Stiffness, shape ``(n,)`` [N/m]; None without springs.

    Returns:
        Energy, shape ``(n,)`` [J].
    """
    if eps_T is None:
        return np.zeros(len(traction))
    energy: Floats = np.einsum("ni,ni->n", traction, traction) / (2 * eps_T)
    return energy


def _polar(t: Floats) -> tuple[Floats, Floats, Floats]:
    """Length of vectors, their direction, 0 for zero vectors, and the projector across it."""
    size: Floats = np.linalg.norm(t, axis=1)
    s = t / np.where(size > 0, size, 1.0)[:, None]
    across: Any = np.eye(2) - s[:, :, None] * s[:, None, :]
    return size, s, across
