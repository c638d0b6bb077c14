"""Enforcement of normal contact: which nodes may touch, gap and force.

Pure functions of arrays over nodes. The gap is positive when open, the
multiplier lambda_N is not positive in contact (Wriggers' convention; Laursen
uses the opposite signs).
"""

from typing import Literal

import numpy as np

from dolfinx_nts.common.arguments import as_call, positive
from dolfinx_nts.common.arrays import Flags, Floats

__all__ = ["LagrangeMultiplier", "Penalty"]


# An active node stays eligible while its gap is below this part of the
# segment's size.
_NEAR = 1e-2
# A gap below this part of the segment's size is none: round-off of positions
# must not decide whether a node that lies on a segment may be held.
_TOUCHES = 1e-9


class LagrangeMultiplier:
    r"""Exact contact: one multiplier for each active node.

    The complementarity of a step on the segment used in it is

    .. math:: 0 \le -\lambda_N \perp g_{n+1} - g_{ref} \ge 0.

    Args:
        impact: What a node does that meets a segment. ``"elastic"``: it
            keeps the gap with which it came, g_ref = g_n, so that
            contact does no work in any step (persistency, after Laursen
            and Chawla 1997) and the energy-momentum scheme conserves
            the total energy exactly; only nodes that touch, or would
            pass through within the step, are eligible. ``"plastic"``:
            g_ref = 0 (Franke, Hesch, Betsch 2011, eq. 58); the node
            loses its impact energy.

    Raises:
        ValueError: Another ``impact``.
    """

    def __init__(self, impact: Literal["elastic", "plastic"] = "elastic") -> None:
        """Check the kind of impact."""
        if impact not in ("elastic", "plastic"):
            raise ValueError(f"expected impact 'elastic' or 'plastic', given {impact!r}")
        self.impact = impact

    def __repr__(self) -> str:
        """Kind of impact. Local."""
        return as_call(self, impact=self.impact)

    def eligible(self, gap_n: Floats, gap_trial: Floats, size: Floats, active: Flags) -> Flags:
        """Nodes that elastic impact may hold; decided once per step.

        Args:
            gap_n: Gap at t_n, NaN without a segment, shape ``(n,)`` [m].
            gap_trial: Gap of the ballistic state x_n + h v_n [m].
            size: Diameter of the node's segment [m].
            active: Whether the node was active in the last step.

        Returns:
            Flags, shape ``(n,)``.
        """
        # Nearer to the surface before than after the step: stop before.
        passes = (gap_n > 0) & (gap_trial < -gap_n)
        flags: Flags = (gap_n <= _TOUCHES * size) | passes | (active & (gap_n < _NEAR * size))
        return flags

    def active(self, lambda_N: Floats, excess: Floats, stiffness: Floats) -> Flags:
        """Primal-dual active set.

        Args:
            lambda_N: Multiplier [N].
            excess: Gap minus reference gap [m].
            stiffness: Positive weight [N/m]; changes the path of
                Newton's method, not its solution.
        """
        flags: Flags = lambda_N + stiffness * excess < 0
        return flags


class Penalty:
    r"""Contact by nodal springs, with energy-consistent force.

    The spring's energy is :math:`U = \varepsilon_N \langle -g \rangle^2/2`, its
    force in a step the difference quotient
    :math:`\lambda_N = (U_{n+1} - U_n)/(g_{n+1} - g_n)`, so that the
    energy-momentum scheme conserves the energy of bodies and springs.

    Args:
        eps_N: Stiffness of the spring at a node [N/m]; None: ten times
            the stiffness of the node itself, mass included, or of the
            stiffest vertex of the segments if that is less.

    Attributes:
        share: Part of the stiffness that a spring has, and that of
            friction with it: 1, or what `halved` left of it.

    Raises:
        ValueError: ``eps_N`` is not positive.
    """

    def __init__(self, eps_N: float | None = None) -> None:
        """Check the stiffness."""
        if eps_N is not None:
            positive("a penalty eps_N", eps_N)
        self.eps_N = eps_N
        self.share = 1.0

    def __repr__(self) -> str:
        """Stiffness as given [N/m] and, unless it is 1, the share. Local."""
        share = {} if self.share == 1 else {"share": self.share}
        return as_call(self, eps_N=self.eps_N, **share)

    def halved(self) -> "Penalty":
        """The same law with springs of half the stiffness."""
        half = Penalty(self.eps_N)
        half.share = self.share / 2
        return half

    def energy(self, gap: Floats, eps_N: Floats) -> Floats:
        """Energy of the springs [J].

        Args:
            gap: Gap from which the spring counts [m].
            eps_N: Stiffness [N/m].
        """
        energy: Floats = 0.5 * eps_N * np.minimum(gap, 0.0) ** 2
        return energy

    def force(self, gap_n: Floats, gap: Floats, eps_N: Floats) -> tuple[Floats, Floats]:
        """Multiplier of a step and its derivative by the gap at its end.

        Args:
            gap_n: Gap at t_n [m].
            gap: Gap at t_{n+1} [m].
            eps_N: Stiffness [N/m].

        Returns:
            lambda_N [N, <= 0] and d lambda_N / d gap [N/m].
        """
        below_n, below = np.minimum(gap_n, 0.0), np.minimum(gap, 0.0)
        both = (gap_n < 0) & (gap < 0)
        # With both ends in the spring the quotient is its mean force; it
        # is formed only where one end is outside, so never 0/0.
        rise = np.where(both | (gap == gap_n), 1.0, gap - gap_n)
        quotient = 0.5 * eps_N * (below**2 - below_n**2) / rise
        slope = (eps_N * below - quotient) / rise
        mean = 0.5 * eps_N * (below + below_n)
        return np.where(both, mean, quotient), np.where(both, 0.5 * eps_N, slope)
