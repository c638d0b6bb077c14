"""Forces and energies of the springs of normal contact by `Penalty`."""

import numpy as np

from dolfinx_nts.common.arrays import Floats

__all__ = ["STIFFER", "spring_energy", "spring_force", "spring_slopes"]

# Stiffness of default springs beyond ``soft_depth``, relative to that below it [-].
# Larger: more iterations; smaller: more penetration. With 1, 5, 10 and 20 the peak force of a ball
# on a block of 6 cells is 7.2, 2.5, 1.9 and 1.5 % too small, and that of two balls of revolution
# 11.0, 2.6, 0.7 and 0.1 %. A step takes 3.4, 3.8, 4.0 and 4.3 Newton iterations.
STIFFER = 10.0
# Further springs of a node, in parallel with the first one: stiffness relative to it, and
# compression at which they begin, relative to ``soft_depth`` [-]. Without the last one, the force
# on a block of four cells that is pressed in 63 transit times of waves is 6.7 % too small, with it
# 3.7 %; forces of impacts and the numbers of iterations above stay the same.
_FURTHER = ((STIFFER - 1, 1.0), (STIFFER * (STIFFER - 1), 1.5))


def spring_energy(gap: Floats, eps_N: Floats, soft_depth: Floats | float = np.inf) -> Floats:
    """Energy of springs, shape ``(m,)`` [J]. Local.

    Args:
        gap: Gap, shape ``(m,)`` [m].
        eps_N: Stiffness, shape ``(m,)`` [N/m].
        soft_depth: Compression beyond which springs are stiffer, shape ``(m,)`` [m].
    """
    squares = np.minimum(gap, 0.0) ** 2
    for stiffness, depth in _FURTHER:
        squares = squares + stiffness * np.minimum(gap + depth * soft_depth, 0.0) ** 2
    energy: Floats = 0.5 * eps_N * squares
    return energy


def spring_force(
    gap_n: Floats,
    gap: Floats,
    eps_N: Floats,
    end_weight: float = 0.5,
    soft_depth: Floats | float = np.inf,
) -> tuple[Floats, Floats]:
    """Multiplier of a step and its derivative with respect to the gap at the end. Local.

    The multiplier is the quotient of the changes of energy and gap. A weight s > 1/2 of the end
    adds (s - 1/2) times the change of the force. This dissipates energy, as the stress of a scheme
    with this weight does.

    Args:
        gap_n: Gap at t_n, shape ``(m,)`` [m].
        gap: Gap at t_{n+1}, shape ``(m,)`` [m].
        eps_N: Stiffness, shape ``(m,)`` [N/m].
        end_weight: Weight of the end of the step in the force of a loaded spring [-].
        soft_depth: Compression beyond which springs are stiffer, shape ``(m,)`` [m].

    Returns:
        lambda_N [N, <= 0] and d lambda_N / d gap [N/m], both of shape ``(m,)``.
    """
    lambda_N, slope = _quotient(gap_n, gap, eps_N, end_weight)
    ends = np.isfinite(soft_depth)
    if np.any(ends):
        for ratio, depth in _FURTHER:
            start, stiffness = np.where(ends, depth * soft_depth, 0.0), ratio * eps_N * ends
            more = _quotient(gap_n + start, gap + start, stiffness, end_weight)
            lambda_N, slope = lambda_N + more[0], slope + more[1]
    if end_weight == 0.5:
        return lambda_N, slope
    # No tension, as for nodes that separate fast.
    pushes = lambda_N < 0
    return np.where(pushes, lambda_N, 0.0), np.where(pushes, slope, 0.0)


def spring_slopes(
    gap_n: Floats,
    gap: Floats,
    eps_N: Floats,
    end_weight: float = 0.5,
    soft_depth: Floats | float = np.inf,
) -> Floats:
    """Derivatives of the multiplier with respect to gap_n, gap and soft_depth. Local.

    Arguments as for `spring_force`.

    Returns:
        Derivatives [N/m], shape ``(3, m)``.
    """
    ends = np.isfinite(soft_depth)
    of_gaps, of_depth = _two_slopes(gap_n, gap, eps_N, end_weight), np.zeros(np.shape(gap))
    for ratio, depth in _FURTHER:
        start, stiffness = np.where(ends, depth * soft_depth, 0.0), ratio * eps_N * ends
        further = _two_slopes(gap_n + start, gap + start, stiffness, end_weight)
        of_gaps, of_depth = of_gaps + further, of_depth + depth * further.sum(axis=0)
    slopes: Floats = np.array([*of_gaps, of_depth])
    if end_weight != 0.5:
        slopes *= spring_force(gap_n, gap, eps_N, end_weight, soft_depth)[0] < 0
    return slopes


def _two_slopes(gap_n: Floats, gap: Floats, eps_N: Floats, end_weight: float) -> Floats:
    """Derivatives for springs of one stiffness with respect to both gaps, ``(2, m)``. Local."""
    # The quotient is symmetric in both gaps, the additional term is not.
    of_start = _quotient(gap, gap_n, eps_N, 0.5)[1]
    of_start -= (end_weight - 0.5) * np.where(gap_n < 0, eps_N, 0.0)
    return np.array([of_start, _quotient(gap_n, gap, eps_N, end_weight)[1]])


def _quotient(
    gap_n: Floats, gap: Floats, eps_N: Floats, end_weight: float
) -> tuple[Floats, Floats]:
    """Multipliers and slopes as in `spring_force`, for springs of one stiffness. Local."""
    below_n, below = np.minimum(gap_n, 0.0), np.minimum(gap, 0.0)
    both = (gap_n < 0) & (gap < 0)
    # If the spring is loaded at both ends of the step, the quotient equals its mean force. The
    # quotient is evaluated only if the gap is open at one end, so that it is never 0/0.
    rise = np.where(both | (gap == gap_n), 1.0, gap - gap_n)
    quotient = 0.5 * eps_N * (below**2 - below_n**2) / rise
    slope = (eps_N * below - quotient) / rise
    mean = 0.5 * eps_N * (below + below_n)
    lambda_N = np.where(both, mean, quotient)
    slope = np.where(both, 0.5 * eps_N, slope)
    if end_weight != 0.5:
        lambda_N += (end_weight - 0.5) * eps_N * (below - below_n)
        slope += (end_weight - 0.5) * np.where(gap < 0, eps_N, 0.0)
    return lambda_N, slope
