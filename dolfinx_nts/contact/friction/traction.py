r"""Friction: tangential force of a node on its segment, as a function of the slip.

Functions are pure, of arrays over ``m`` pairs. The slip g_T of a step has two components in an
orthonormal frame of the segment (`cpp/nts/contact/slip.h`). The traction t is a nodal force
that opposes it, with

.. math:: |t| \le L(p, |g_T|), \qquad p = -\lambda_N,

and the limit L of a `FrictionLaw`.
"""

from typing import Any, NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.friction.laws import FrictionLaw
from dolfinx_nts.contact.friction.limits import NodalLimit

__all__ = [
    "TractionModel",
    "exact_model",
    "slip_energy",
    "slip_stiffness",
    "spring_model",
    "transport",
]

# Least 1 + cosine of the angle between two normals [-] by which `transport` divides: it is 0 if the
# normal is reversed, where the smallest rotation is not unique.
_REVERSED = 1e-12


class TractionModel(NamedTuple):
    """Linear model of the traction for Newton's method, t = explicit + p direction + stiffness dg.

    Attributes:
        explicit: Part that does not depend on the normal force p, shape ``(m, 2)`` [N].
        direction: Derivative with respect to the normal force p, shape ``(m, 2)`` [-].
        stiffness: Derivative with respect to the slip at fixed p, shape ``(m, 2, 2)`` [N/m].
    """

    explicit: Floats
    direction: Floats
    stiffness: Floats


def spring_model(
    limit: NodalLimit, trial: Floats, p: Floats, eps_T: Floats, heading: Floats, sliding: Flags
) -> TractionModel:
    """Return mapping of the trial tractions of tangential springs, linearised. Local.

    A sliding node whose trial traction opposes the sliding keeps the direction of the last
    iteration, which is not a solution yet.

    Args:
        limit: Limits of the nodes, see `Limits.of_springs`.
        trial: Trial traction of a sticking node, t_n + eps_T g, shape ``(m, 2)`` [N].
        p: Normal force, shape ``(m,)`` [N].
        eps_T: Stiffness of the springs, shape ``(m,)`` [N/m].
        heading: Direction of the traction, of any length, shape ``(m, 2)``.
        sliding: Whether the node slides now, shape ``(m,)``.
    """
    turns = np.einsum("mi,mi->m", heading, trial) >= 0
    size, s, across = _polar(np.where((sliding & ~turns)[:, None], heading, trial))
    largest = np.maximum(limit.force, 0.0)
    part = np.where(sliding, turns * largest / np.where(size > 0, size, 1.0), 1.0)
    stiffness = np.where(sliding[:, None, None], across, np.eye(2))
    stiffness = (part * eps_T)[:, None, None] * stiffness
    along = sliding * turns * limit.by_slip * eps_T
    stiffness += along[:, None, None] * (np.eye(2) - across)
    rest = limit.force - limit.by_p * p
    return TractionModel(
        explicit=np.where(sliding[:, None], rest[:, None] * s, trial),
        direction=np.where(sliding[:, None], limit.by_p[:, None] * s, 0.0),
        stiffness=stiffness,
    )


def exact_model(
    limit: NodalLimit,
    t: Floats,
    slip: Floats,
    p: Floats,
    c: Floats,
    heading: Floats,
    sliding: Flags,
) -> TractionModel:
    """Linearise stick and slip without a spring, for one semismooth Newton iteration. Local.

    The condition ``t - min(1, L/|t + c g|) (t + c g) = 0`` with the limit L has the solutions
    ``g = 0`` with ``|t| <= L`` (stick) and ``t = L g/|g|`` (slip); the weight c changes the
    path, not the solution. For a sliding node it is linearised and solved for t: the traction turns
    towards the direction of the slip. The direction is kept if the slip opposes it or no normal
    force acts.

    Args:
        limit: Limits of the nodes at this slip.
        t: Traction of the last iteration, shape ``(m, 2)`` [N].
        slip: Slip of the step, shape ``(m, 2)`` [m].
        p: Normal force, shape ``(m,)`` [N].
        c: Weight, part of the stiffness of the node, shape ``(m,)`` [N/m].
        heading: Direction of the traction, of any length, shape ``(m, 2)``.
        sliding: Whether the node slides now, shape ``(m,)``.
    """
    return TractionModel(*_kernels.exact_friction(*limit, t, slip, p, c, heading, sliding))


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


def slip_stiffness(
    law: FrictionLaw | None, eps_T: Floats | None, fraction: Floats
) -> Floats | None:
    """Stiffness of tangential springs that acts, shape ``(n,)`` [N/m]; None without springs. Local.

    Args:
        law: Law of friction, which may have a given stiffness.
        eps_T: Largest stiffness, where the stiffest segment is faced, shape ``(n,)`` [N/m].
        fraction: Fraction of the stiffness of default normal springs that acts, ``(n,)`` [-].
    """
    if eps_T is None or law is None or law.eps_T is not None:
        return eps_T
    return fraction * eps_T


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
    """Lengths and directions of vectors, and projectors normal to them; 0 for zero vectors."""
    size: Floats = np.linalg.norm(t, axis=1)
    s = t / np.where(size > 0, size, 1.0)[:, None]
    across: Any = np.eye(2) - s[:, :, None] * s[:, None, :]
    return size, s, across
