"""Enforcement of normal contact: which nodes may touch, and gap and force of those that do.

Methods of the laws are pure functions of arrays over nodes. The gap is positive when open, and
the multiplier lambda_N is not positive in contact, as in Wriggers' book; Laursen uses the
opposite signs.
"""

from typing import Literal

import numpy as np

from dolfinx_nts.common.arguments import as_call, finite, positive
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.common.declaration import Declaration

__all__ = ["TOUCHES", "LagrangeMultiplier", "Penalty", "Tied"]

# Gap, relative to the size of the longest segment [-], below which an active node stays
# eligible, as elastic impact holds it at the gap with which it came.
_NEAR = 1e-2
# Gap, relative to the size of segments [-], that counts as none: round-off of positions must
# not decide whether a node that lies on a segment may be held.
TOUCHES = 1e-9


class LagrangeMultiplier(Declaration):
    r"""Exact contact by a Lagrange multiplier at each active node.

    The complementarity of a step on the segment used in it is

    .. math:: 0 \le -\lambda_N \perp g_{n+1} - g_{ref} \ge 0.

    Args:
        impact: What happens when a node meets a segment. ``"elastic"``: the node keeps the gap
            that it had at the start of the step, g_ref = g_n, so that contact does no work in
            any step (persistency, after Laursen and Chawla 1997) and the energy-momentum scheme
            conserves the total energy exactly. Only nodes that touch, or would pass through
            within the step, can become active. ``"plastic"``: the gap is closed, g_ref = 0
            (Franke, Hesch, Betsch 2011, eq. 58), which dissipates the impact energy of the node.
            ``"resolved"``: elastic impact of surface nodes without mass; the nodes below the
            surface carry their mass, so that the force follows the waves in the body. It is of
            second order in time if a step is shorter than the time in which a wave crosses a
            cell, or half of one of degree 2, and is available in `EnergyMomentum`, without
            tangential springs.
            ``"restitution"``: the node leaves with ``e`` times the speed with which it arrived,
            wherever in the step it arrives: g_ref = g_n + (1 - e)/2 min(h dg_n/dt, 0). The
            energy-momentum scheme never gains energy by it; e = 1 is elastic impact. It is
            available in all methods of contact.
        e: Coefficient of restitution of ``"restitution"``, from 0 to 1 [-]. It applies to nodes.
            A soft body also rebounds by its waves, all the more the finer its mesh is, so that
            ``e`` is the coefficient of restitution of the whole body only if it is stiff.

    Attributes:
        impact: The argument.
        e: The argument; 1 without.

    Raises:
        ValueError: Another ``impact``; ``e`` is not from 0 to 1, missing, or given to another
            kind of impact.

    Example:
        >>> law = nts.LagrangeMultiplier(impact="plastic")
        >>> print(nts.ContactPair(bottom, top, enforcement=law))
        contact by LagrangeMultiplier
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
        """Whether the gap with which an active node came decides where it is held. Local."""
        return self.impact != "plastic"

    def __repr__(self) -> str:
        """Kind of impact in one line. Local."""
        e = {"e": self.e} if self.impact == "restitution" else {}
        return as_call(self, impact=self.impact, **e)

    @property
    def part(self) -> float:
        """Part of its way in a step that an active node goes nearer, (1 - e)/2 [-]. Local."""
        return (1 - self.e) / 2

    def eligible(self, gap_n: Floats, gap_trial: Floats, size: Floats, active: Flags) -> Flags:
        """Decide once per step which nodes may be held, unless gaps close. Local.

        Args:
            gap_n: Gap at t_n, NaN without a segment, shape ``(n,)`` [m].
            gap_trial: Gap of the ballistic state x_n + h v_n, shape ``(n,)`` [m].
            size: Diameter of the longest segment of the node's pair, shape ``(n,)`` [m].
            active: Whether the node was active in the last step, shape ``(n,)``.

        Returns:
            Flags, shape ``(n,)``.
        """
        # Such a node is held nearer to the surface in this step than in the next one: with
        # e = 1, where it stops at once, if it is nearer before the step than after it.
        # Points that arrive together do so but for round-off, also where it would tell them apart.
        near = (2 * gap_n - (2 - self.e) * (gap_n - gap_trial)) < TOUCHES * size
        passes = (gap_n > 0) & (gap_trial < gap_n) & near
        # Nodes without mass have no velocity of their own that would tell if they are released.
        stays = active if self.impact == "resolved" else active & (gap_n < _NEAR * size)
        flags: Flags = (gap_n <= TOUCHES * size) | passes | stays
        return flags

    def active(self, lambda_N: Floats, excess: Floats, stiffness: Floats) -> Flags:
        """Decide by the primal-dual test which nodes are active, shape ``(n,)``. Local.

        Args:
            lambda_N: Multiplier, shape ``(n,)`` [N].
            excess: Gap minus reference gap, shape ``(n,)`` [m].
            stiffness: Positive weight, shape ``(n,)`` [N/m]; it changes the path of Newton's
                method, not the solution.
        """
        flags: Flags = lambda_N + stiffness * excess < 0
        return flags


class Tied(LagrangeMultiplier):
    """Ties nodes permanently to the surface on which they lie.

    Multipliers hold the gap and the slip of each tied node in every step, and pull as well as
    push. Nodes are tied where they are in the first step: those within reach of a segment, whose
    gap stays as it is, so that surfaces which do not match exactly stay without stress. All other
    nodes of the surface are free. Energy and both momenta are as exact as with contact.
    ``method="mortar"`` transmits uniform stresses exactly, whatever the meshes. Local.

    Args:
        reach: Gap up to which a node is tied, relative to the size of its segment [-].

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
        """Reach in one line. Local."""
        return as_call(self, reach=self.reach)


class Penalty(Declaration):
    r"""Contact by nodal springs, whose force in a step is consistent with their energy.

    The energy of a spring is :math:`U = \varepsilon_N \langle -g \rangle^2/2`, its force in a
    step the difference quotient :math:`\lambda_N = (U_{n+1} - U_n)/(g_{n+1} - g_n)`, so that
    the energy-momentum scheme conserves the energy of bodies and springs.

    Args:
        eps_N: Stiffness of the spring at a node [N/m]. None: the static stiffness of the node
            itself, or that of the stiffest vertex of the segments if that is less; in statics,
            ten times that. It does not depend on the length of the steps, so that steps which
            resolve a cell are of second order in time. A node then penetrates about as far as
            its cell is compressed: in an impact by v/c of the height of the cell, where v is
            the speed of the impact and c the speed of waves. Between bodies that do not deform,
            None means half the mass of the lighter one divided by the square of the first step,
            so that a body which strikes at one point penetrates about as far as it moves in one
            or two steps; in statics, ten times the stiffness of the stiffest node that deforms.
            A surface whose displacements are all prescribed counts as rigid.

    Attributes:
        eps_N: The argument.
        share: Factor on the stiffness of the springs, normal and tangential [-]: 1, or less
            after `halved`.

    Raises:
        ValueError: ``eps_N`` is not positive.

    Example:
        >>> springs = nts.Penalty(eps_N=1.0e6)  # N/m
        >>> print(nts.ContactPair(bottom, top, enforcement=springs))
        contact by Penalty
    """

    def __init__(self, eps_N: float | None = None) -> None:
        if eps_N is not None:
            positive("a penalty eps_N", eps_N)
        self.eps_N = eps_N
        self.share = 1.0

    def __repr__(self) -> str:
        """Stiffness as given [N/m] and, unless it is 1, the share. Local."""
        share = {} if self.share == 1 else {"share": self.share}
        return as_call(self, eps_N=self.eps_N, **share)

    def halved(self) -> "Penalty":
        """Make the same law with springs of half the stiffness. Local."""
        half = Penalty(self.eps_N)
        vars(half)["share"] = self.share / 2  # before anybody has it
        return half

    def energy(self, gap: Floats, eps_N: Floats) -> Floats:
        """Energy of springs, ``(m,)`` [J], loaded where the gap, ``(m,)`` [m], is negative."""
        energy: Floats = 0.5 * eps_N * np.minimum(gap, 0.0) ** 2
        return energy

    def force(
        self, gap_n: Floats, gap: Floats, eps_N: Floats, share: float = 0.5
    ) -> tuple[Floats, Floats]:
        """Compute the multiplier of a step and its derivative by the gap at the end. Local.

        With a share s > 1/2 of the end it has (s - 1/2) of the change of the force besides,
        which takes energy, as the stress of a scheme does that has this share.

        Args:
            gap_n: Gap at t_n, shape ``(m,)`` [m].
            gap: Gap at t_{n+1}, shape ``(m,)`` [m].
            eps_N: Stiffness, shape ``(m,)`` [N/m].
            share: Share that the end of the step has in the force of a loaded spring [-].

        Returns:
            lambda_N [N, <= 0] and d lambda_N / d gap [N/m], both of shape ``(m,)``.
        """
        below_n, below = np.minimum(gap_n, 0.0), np.minimum(gap, 0.0)
        both = (gap_n < 0) & (gap < 0)
        # With both ends in the spring the quotient is its mean force; the quotient is formed
        # only where one end is outside, so that it is never 0/0.
        rise = np.where(both | (gap == gap_n), 1.0, gap - gap_n)
        quotient = 0.5 * eps_N * (below**2 - below_n**2) / rise
        slope = (eps_N * below - quotient) / rise
        mean = 0.5 * eps_N * (below + below_n)
        lambda_N = np.where(both, mean, quotient)
        slope = np.where(both, 0.5 * eps_N, slope)
        if share == 0.5:
            return lambda_N, slope
        lambda_N += (share - 0.5) * eps_N * (below - below_n)
        slope += (share - 0.5) * np.where(gap < 0, eps_N, 0.0)
        # A node that parts fast would be pulled back.
        pushes = lambda_N < 0
        return np.where(pushes, lambda_N, 0.0), np.where(pushes, slope, 0.0)
