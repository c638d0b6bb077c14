r"""Interior point method for Coulomb's law at all contact points of a linear system.

If rigid bodies touch at more points than they have degrees of freedom, contact forces are not
unique, and active-set updates point by point cycle. All conditions of a linearised step form a
small problem: the forces f at the points, normal component first, and the relative motions y
satisfy

.. math:: y = W f + q, \qquad f \in K, \quad y + \mu |y_T| e_N \in K^*, \quad
   f \cdot (y + \mu |y_T| e_N) = 0,

with the friction cone K, its dual K^* and the normal :math:`e_N` (G. De Saxce, Z.-Q. Feng, Math.
Comput. Modelling 28 (1998)). The method follows the central path, on which the Jordan product of
both is a small multiple of the identity of the cone (F. Alizadeh, D. Goldfarb, Math. Program. 95
(2003)). It ends at the analytic centre of the set of solutions, in which a point slides only if all
solutions require it.
"""

from typing import Any, NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints, indices

__all__ = ["ConeSolution", "solve"]

_MOST_ITERATIONS = 60
# Limits on the duality gap, relative to forces and motions of the problem [-]: for convergence; if
# progress stagnates; and if steps have become short.
_NONE, _FEW, _CLEAR = 1e-18, 1e-13, 1e-9
# Limits on the residual of the motions, relative to the problem [-]: for convergence, and if steps
# have become short.
_EQUAL, _NEAR = 1e-12, 1e-8
# Number of iterations after which stagnation, and after which short steps, end the method.
_BEFORE_FEW, _BEFORE_SHORT = 8, 12
# Step length [-] that counts as short; and below which the next step is a pure centring step.
_SHORT, _OFF_CENTRE = 0.1, 0.3
# Fraction of the distance to the boundary of the cones that a step takes [-].
_INSIDE = 0.999
# Least centring parameter [-]: while residuals are large, later, and of a centring step.
_FIRST_AIM, _AIM, _CENTRING = 1e-2, 1e-4, 0.5
_DIFFERS = 1e-6
# Coupling of two points, relative to their own compliances [-], that counts as round-off.
_NOT_FELT = 1e-13
# Compliance added to the points, relative to that of the bodies [-], which makes the forces unique.
_COMPLIANCE = 1e-10


class ConeSolution(NamedTuple):
    """Forces and motions at ``m`` points, in ``d`` components, the normal one first.

    Attributes:
        force: Forces on the points, shape ``(m, d)`` [N].
        motion: Gaps and slips, shape ``(m, d)`` [m].
        presses: Whether a point transmits force, shape ``(m,)``.
        slides: Whether a point with force slides, shape ``(m,)``.
    """

    force: Floats
    motion: Floats
    presses: Flags
    slides: Flags

    def subset(self, points: slice) -> "ConeSolution":
        """Subset of the points. Local."""
        return ConeSolution(
            self.force[points], self.motion[points], self.presses[points], self.slides[points]
        )


def solve(W: Floats, q: Floats, mu: Floats) -> ConeSolution | None:
    """Find forces that obey Coulomb's law at all points. Local.

    Groups of points that do not interact are solved one after the other.

    Args:
        W: Compliance matrix of the points, shape ``(m d, m d)`` [m/N].
        q: Motions without any contact force, shape ``(m d,)`` [m].
        mu: Coefficients of friction, positive, shape ``(m,)`` [-].

    Returns:
        A solution, or None if none is found.
    """
    m, d = len(mu), len(q) // max(len(mu), 1)
    force, motion = np.zeros((2, m, d))
    presses, slides = np.zeros((2, m), dtype=bool)
    for points in _groups(W, m):
        rows = (d * points[:, None] + np.arange(d)).ravel()
        found = _solve_group(W[np.ix_(rows, rows)], q[rows], mu[points])
        if found is None:
            return None
        force[points], motion[points], presses[points], slides[points] = found
    return ConeSolution(force, motion, presses, slides)


def _groups(W: Floats, m: int) -> list[Ints]:
    """Groups of interacting points. Local."""
    d = len(W) // max(m, 1)
    size = np.abs(W).reshape(m, d, m, d).max(axis=(1, 3), initial=0.0)
    own = np.sqrt(np.diag(size))
    feels = size > _NOT_FELT * own[:, None] * own
    feels |= feels.T
    group = np.arange(m, dtype=np.int32)
    while True:
        least = np.where(feels | np.eye(m, dtype=bool), group, m).min(axis=1, initial=m)
        if np.array_equal(least, group):
            return [indices(group == g) for g in np.unique(group)]
        group = least


def _solve_group(W: Floats, q: Floats, mu: Floats) -> ConeSolution | None:
    m, d = len(mu), len(q) // len(mu)
    own = np.diag(W)
    length = _kernels.largest_size(q)
    if not (length > 0 and (own > 0).any()):
        return None
    # Scaling to right-angled cones and to dimensionless forces and motions.
    compliance = float(own[own > 0].mean())
    scale: Floats = np.ones((m, d))
    scale[:, 0] = 1 / mu
    s = scale.ravel()
    soft: Any = s[:, None] * (W / compliance + _COMPLIANCE * np.eye(len(q))) * s
    given: Any = s * q / length
    with np.errstate(all="ignore"):
        try:
            found = _central(soft, given, d)
        except np.linalg.LinAlgError:
            return None
    if found is None:
        return None
    (f, v), size = found, length / compliance
    f_across, v_across = (np.linalg.norm(a[:, 1:], axis=1) for a in (f, v))
    opens = v[:, 0] - v_across > f[:, 0] + f_across
    sticks = f[:, 0] - f_across > v[:, 0] + v_across
    force = f * scale * size
    motion = (W @ force.ravel() + q).reshape(m, d)
    return ConeSolution(force, motion, ~opens, ~opens & ~sticks)


def _central(W: Floats, q: Floats, d: int) -> tuple[Floats, Floats] | None:
    """Scaled forces and motions at the end of the central path; None without a solution. Local."""
    m, size = len(q) // d, len(q)
    unit = np.zeros(d)
    unit[0] = 1.0
    f, v = np.tile(unit, (m, 1)), np.tile(unit, (m, 1))
    last, part = np.inf, 1.0
    diagonal = np.arange(m)
    for iteration in range(_MOST_ITERATIONS):
        across = np.linalg.norm(v[:, 1:], axis=1)
        differs = (W @ f.ravel() + q).reshape(m, d) - v
        differs[:, 0] += across
        product = _product(f, v)
        mean, error = float(product[:, 0].mean()), float(np.abs(differs).max())
        if not np.isfinite(mean + error):
            return None
        if error < _EQUAL and (
            mean < _NONE or (iteration > _BEFORE_FEW and last / 2 < mean < _FEW)
        ):
            return f, v
        if iteration > _BEFORE_SHORT and part < _SHORT and mean < _CLEAR and error < _NEAR:
            return f, v
        if mean <= 0:  # the duality gap is round-off
            return None
        last = mean
        # The dual cone adds the size of the slip to the normal motion.
        of_slip = np.tile(np.eye(d), (m, 1, 1))
        of_slip[:, 0, 1:] += v[:, 1:] / np.where(across > 0, across, 1.0)[:, None]
        rows = _arrow(f) @ of_slip
        A = (rows @ W.reshape(m, d, size)).reshape(m, d, m, d)
        A[diagonal, :, diagonal] += _arrow(v)
        inverse: Any = np.linalg.inv(A.reshape(size, size))
        known = product + np.einsum("mij,mj->mi", rows, differs)
        given = W, of_slip, differs, inverse

        df, dv = _direction(known, *given)
        length = min(1.0, _kernels.longest_in_cones(f, df), _kernels.longest_in_cones(v, dv))
        reached = float(_product(f + length * df, v + length * dv)[:, 0].mean())
        aim = max(min(1.0, max(reached / mean, 0.0) ** 2), _AIM if error < _DIFFERS else _FIRST_AIM)
        if part < _OFF_CENTRE:
            aim = max(aim, _CENTRING)
            df, dv = _direction(known - aim * mean * unit, *given)
        else:
            second = length**2 * _product(df, dv)
            df, dv = _direction(known - aim * mean * unit + second, *given)
        part = min(
            1.0, _INSIDE * min(_kernels.longest_in_cones(f, df), _kernels.longest_in_cones(v, dv))
        )
        f, v = f + part * df, v + part * dv
    return None


def _direction(
    known: Floats, W: Floats, of_slip: Floats, differs: Floats, inverse: Floats
) -> tuple[Floats, Floats]:
    """Newton directions of forces and motions for the right-hand side ``known``, ``(m, d)``."""
    df = -(inverse @ known.ravel())
    moved = (W @ df).reshape(known.shape) + differs
    return df.reshape(known.shape), np.einsum("mij,mj->mi", of_slip, moved)


def _arrow(v: Floats) -> Floats:
    """Matrices of the Jordan products with vectors, ``(m, d, d)``."""
    d = v.shape[1]
    matrices: Floats = v[:, :1, None] * np.eye(d)
    matrices[:, 0, :] = v
    matrices[:, :, 0] = v
    return matrices


def _product(a: Floats, b: Floats) -> Floats:
    """Jordan products of vectors, ``(m, d)``."""
    product = a[:, :1] * b + b[:, :1] * a
    product[:, 0] = np.einsum("mi,mi->m", a, b)
    return product
