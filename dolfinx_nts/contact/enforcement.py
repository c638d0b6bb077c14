"""Enforcement of normal contact: Lagrange multipliers and penalty springs.

Methods of the laws are pure functions of arrays over nodes. The gap is positive when open, and
the multiplier lambda_N is negative in contact, as in Wriggers' book; Laursen uses the opposite
signs.
"""

from typing import Literal

import numpy as np

from dolfinx_nts.common.arguments import as_call, finite, positive
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.common.declaration import Declaration

__all__ = ["TOUCHES", "LagrangeMultiplier", "Penalty", "Tied"]

# Gap relative to the longest segment [-] below which an active node stays eligible: elastic impact
# keeps it at the gap at which it became active.
_NEAR = 1e-2
# Stiffness of default springs beyond their soft part, relative to it [-]. Larger: more iterations;
# smaller: more compliance. With 1, 5, 10 and 20 the peak force of a ball on a block of 6 cells is
# 7.2, 2.5, 1.9 and 1.5 % too small, and that of two balls of revolution 11.0, 2.6, 0.7 and 0.1 %,
# after 3.4, 3.8, 4.0 and 4.3 Newton iterations a step.
_STIFFER = 10.0
# Gap relative to the size of segments [-] that counts as zero, so that round-off does not decide
# whether a node on a segment may become active.
TOUCHES = 1e-9


class LagrangeMultiplier(Declaration):
    r"""Exact contact by a Lagrange multiplier at each active node.

    The complementarity of a step on the segment used in it is

    .. math:: 0 \le -\lambda_N \perp g_{n+1} - g_{ref} \ge 0.

    Args:
        impact: Law of impact of a node. ``"elastic"``: the node keeps its gap at the start of the
            step, g_ref = g_n, so that contact does no work (persistency, after Laursen and Chawla
            1997) and the energy-momentum scheme conserves the total energy exactly. Only nodes
            that touch, or would pass through within the step, can become active.
            ``"plastic"``: the gap is closed, g_ref = 0 (Franke, Hesch, Betsch 2011, eq. 58), which
            dissipates the impact energy of the node.
            ``"resolved"``: elastic impact of massless surface nodes; the nodes below the surface
            carry their mass, so that the force follows the waves in the body. It is of second
            order in time for Courant numbers below one (for degree 2 with respect to half a
            cell), and needs `EnergyMomentum` without tangential springs.
            ``"restitution"``: the node leaves with ``e`` times its arrival speed, independent of
            the time of impact in the step: g_ref = g_n + (1 - e)/2 min(h dg_n/dt, 0). The
            energy-momentum scheme never gains energy by it; e = 1 is elastic impact. It is
            available in all methods of contact.
        e: Coefficient of restitution of ``"restitution"``, from 0 to 1 [-]. It applies to nodes.
            A soft body also rebounds by its waves, the more the finer its mesh is, so that ``e``
            is the coefficient of restitution of the whole body only if it is stiff.

    Attributes:
        impact: The argument.
        e: The argument; 1 if not given.

    Raises:
        ValueError: Unknown ``impact``; ``e`` is not in [0, 1], missing, or given for another
            kind of impact.

    Example:
        >>> law = nts.LagrangeMultiplier(impact="plastic")
        >>> print(nts.ContactPair(bottom, top, enforcement=law))
        surface-to-surface contact by LagrangeMultiplier
    """

    def __init__(
        self,
        impact: Literal["elastic", "plastic", "resolved", "restitution"] = "elastic",
        e: float | None = None,
    ) -> None:
        if impact not in ("elastic", "plastic", "resolved", "restitution"):
            raise ValueError(
                "expected impact 'elastic', 'plastic', 'resolved' or 'restitution', given "
                f"{impact!r}"
            )
        if (impact == "restitution") != (e is not None):
            raise ValueError(
                "expected a coefficient e with impact 'restitution' and with no other, given "
                f"impact {impact!r} and e = {e!r}"
            )
        if e is not None and not 0 <= finite("e", e) <= 1:
            raise ValueError(f"expected a coefficient of restitution e from 0 to 1, given {e}")
        self.impact = impact
        self.e = 1.0 if e is None else float(e)

    @property
    def holds_gaps(self) -> bool:
        """Whether the reference gap depends on the gap at the start of the step. Local."""
        return self.impact != "plastic"

    def __repr__(self) -> str:
        """Kind of impact. Local."""
        e = {"e": self.e} if self.impact == "restitution" else {}
        return as_call(self, impact=self.impact, **e)

    @property
    def part(self) -> float:
        """Fraction of its approach in the step that an active node makes, (1 - e)/2 [-]. Local."""
        return (1 - self.e) / 2

    def eligible(self, gap_n: Floats, gap_trial: Floats, size: Floats, active: Flags) -> Flags:
        """Decide once per step which nodes may become active. Local.

        Args:
            gap_n: Gap at t_n, NaN without a segment, shape ``(n,)`` [m].
            gap_trial: Gap of the ballistic state x_n + h v_n, shape ``(n,)`` [m].
            size: Diameter of the longest segment of the node's pair, shape ``(n,)`` [m].
            active: Whether the node was active in the last step, shape ``(n,)``.

        Returns:
            Flags, shape ``(n,)``.
        """
        # Each node is caught in the step that brings it closest to the surface: for e = 1, if its
        # gap is smaller before the step than after it. The tolerance keeps round-off from
        # separating simultaneous contacts.
        near = (2 * gap_n - (2 - self.e) * (gap_n - gap_trial)) < TOUCHES * size
        passes = (gap_n > 0) & (gap_trial < gap_n) & near
        # Massless nodes have no velocity that would indicate a release.
        stays = active if self.impact == "resolved" else active & (gap_n < _NEAR * size)
        flags: Flags = (gap_n <= TOUCHES * size) | passes | stays
        return flags

    def active(self, lambda_N: Floats, excess: Floats, stiffness: Floats) -> Flags:
        """Active nodes by the primal-dual test, shape ``(n,)``. Local.

        Args:
            lambda_N: Multiplier, shape ``(n,)`` [N].
            excess: Gap minus reference gap, shape ``(n,)`` [m].
            stiffness: Positive weight, shape ``(n,)`` [N/m]; it changes the path of Newton's
                method, not the solution.
        """
        flags: Flags = lambda_N + stiffness * excess < 0
        return flags


class Tied(LagrangeMultiplier):
    """Permanent tie of nodes to a surface. Local.

    Multipliers of either sign keep the gap and the slip of each tied node in every step. The first
    step ties the nodes within reach of a segment at their current gap, so that surfaces that do
    not match exactly remain without stress. All other nodes of the surface are free. Energy and
    both momenta are conserved as in contact. ``method="mortar"`` transmits uniform stresses exactly
    on any meshes.

    Args:
        reach: Largest gap of tied nodes relative to the size of the segment [-].

    Attributes:
        reach: The argument.

    Raises:
        ValueError: ``reach`` is not positive.

    Example:
        >>> law = nts.Tied()
        >>> print(nts.ContactPair(bottom, top, enforcement=law, method="mortar"))
        surface-to-surface contact by Tied
    """

    def __init__(self, reach: float = 0.05) -> None:
        super().__init__()
        positive("the reach of a tie", reach)
        self.reach = float(reach)

    def __repr__(self) -> str:
        """Reach. Local."""
        return as_call(self, reach=self.reach)


class Penalty(Declaration):
    r"""Contact by nodal springs whose force in a step is consistent with their energy.

    The energy of a spring is :math:`U = \varepsilon_N \langle -g \rangle^2/2`, its force in a
    step the difference quotient :math:`\lambda_N = (U_{n+1} - U_n)/(g_{n+1} - g_n)`, so that
    the energy-momentum scheme conserves the energy of bodies and springs.

    Args:
        eps_N: Stiffness of the spring at a node [N/m]. None for 3/5 of the stiffness of the layer
            of cells behind the node or the segments, whichever is softer; in statics, for ten times
            the static stiffness of the softer node. It does not depend on the length of the steps,
            so that steps that resolve a cell are of second order in time. Under the pressure of
            plane waves, rho c v/2 where equal bodies meet at a speed v, springs are compressed by
            5/3 of the compression of a cell. Beyond one and a half times that they are ten times
            as stiff, and stiff from the start where nodes arrive slowly: the soft part stops the
            arriving node, the stiff part carries other loads. Between bodies that do not deform,
            None means half the mass of the lighter one divided by the square of the first step, so
            that a body striking at one point penetrates by about its motion in one or two steps; in
            statics, ten times the stiffness of the stiffest deformable node. A surface with all
            displacements prescribed counts as rigid. `CentralDifference` has linear springs, chosen
            by the stiffness of the cells at the surfaces.

    Attributes:
        eps_N: The argument.
        share: Factor on the stiffness of normal and tangential springs [-]: 1, or less after
            `halved`.

    Raises:
        ValueError: ``eps_N`` is not positive.

    Example:
        >>> springs = nts.Penalty(eps_N=1.0e6)  # N/m
        >>> print(nts.ContactPair(bottom, top, enforcement=springs))
        surface-to-surface contact by Penalty
    """

    def __init__(self, eps_N: float | None = None) -> None:
        if eps_N is not None:
            positive("a penalty eps_N", eps_N)
        self.eps_N = eps_N
        self.share = 1.0

    def __repr__(self) -> str:
        """Stiffness [N/m] and, unless it is 1, the share. Local."""
        share = {} if self.share == 1 else {"share": self.share}
        return as_call(self, eps_N=self.eps_N, **share)

    def halved(self) -> "Penalty":
        """Law with springs of half the stiffness. Local."""
        half = Penalty(self.eps_N)
        vars(half)["share"] = self.share / 2  # allowed before the declaration is in use
        return half

    def energy(self, gap: Floats, eps_N: Floats, soft_depth: Floats | float = np.inf) -> Floats:
        """Energy of springs. Local.

        Args:
            gap: Gap, shape ``(m,)`` [m].
            eps_N: Stiffness, shape ``(m,)`` [N/m].
            soft_depth: Compression beyond which springs are stiffer, shape ``(m,)`` [m].

        Returns:
            Energy, shape ``(m,)`` [J].
        """
        beyond = np.minimum(gap + soft_depth, 0.0)
        energy: Floats = 0.5 * eps_N * (np.minimum(gap, 0.0) ** 2 + (_STIFFER - 1) * beyond**2)
        return energy

    def force(
        self,
        gap_n: Floats,
        gap: Floats,
        eps_N: Floats,
        share: float = 0.5,
        soft_depth: Floats | float = np.inf,
    ) -> tuple[Floats, Floats]:
        """Multiplier of a step and its derivative with respect to the gap at the end. Local.

        A weight s > 1/2 of the end adds (s - 1/2) times the change of the force, which dissipates
        energy as does the stress of a scheme with this weight.

        Args:
            gap_n: Gap at t_n, shape ``(m,)`` [m].
            gap: Gap at t_{n+1}, shape ``(m,)`` [m].
            eps_N: Stiffness, shape ``(m,)`` [N/m].
            share: Weight of the end of the step in the force of a loaded spring [-].
            soft_depth: Compression beyond which springs are stiffer, shape ``(m,)`` [m].

        Returns:
            lambda_N [N, <= 0] and d lambda_N / d gap [N/m], both of shape ``(m,)``.
        """
        lambda_N, slope = _quotient(gap_n, gap, eps_N, share)
        ends = np.isfinite(soft_depth)
        if np.any(ends):
            # A second spring in parallel begins at that compression.
            start, stiffness = np.where(ends, soft_depth, 0.0), (_STIFFER - 1) * eps_N * ends
            more = _quotient(gap_n + start, gap + start, stiffness, share)
            lambda_N, slope = lambda_N + more[0], slope + more[1]
        if share == 0.5:
            return lambda_N, slope
        # No tension, as for nodes that separate fast.
        pushes = lambda_N < 0
        return np.where(pushes, lambda_N, 0.0), np.where(pushes, slope, 0.0)


def _quotient(gap_n: Floats, gap: Floats, eps_N: Floats, share: float) -> tuple[Floats, Floats]:
    """Multipliers and slopes of springs of one stiffness, as of `Penalty.force`. Local."""
    below_n, below = np.minimum(gap_n, 0.0), np.minimum(gap, 0.0)
    both = (gap_n < 0) & (gap < 0)
    # If the spring is loaded at both ends, the quotient is its mean force. It is evaluated only
    # if one end is open, so that it is never 0/0.
    rise = np.where(both | (gap == gap_n), 1.0, gap - gap_n)
    quotient = 0.5 * eps_N * (below**2 - below_n**2) / rise
    slope = (eps_N * below - quotient) / rise
    mean = 0.5 * eps_N * (below + below_n)
    lambda_N = np.where(both, mean, quotient)
    slope = np.where(both, 0.5 * eps_N, slope)
    if share != 0.5:
        lambda_N += (share - 0.5) * eps_N * (below - below_n)
        slope += (share - 0.5) * np.where(gap < 0, eps_N, 0.0)
    return lambda_N, slope
