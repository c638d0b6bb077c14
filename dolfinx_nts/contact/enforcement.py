"""Enforcement of normal contact: Lagrange multipliers and penalty springs.

Methods of the laws are pure functions of arrays over nodes; forces and energies of springs are in
`springs`. The gap is positive when open, and the multiplier lambda_N is negative in contact, as in
Wriggers' book; Laursen uses the opposite signs.
"""

from typing import Literal

from dolfinx_nts.common.arguments import as_call, finite, positive
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.common.declaration import Declaration

__all__ = ["TOUCHES", "LagrangeMultiplier", "Penalty", "Tied"]

# Gap relative to the longest segment [-] below which an active node stays eligible: elastic impact
# keeps it at the gap at which it became active.
_NEAR = 1e-2
# Gap relative to the size of segments [-] that counts as zero, so that round-off does not decide
# whether a node on a segment may become active.
TOUCHES = 1e-9


class LagrangeMultiplier(Declaration):
    r"""Exact contact by a Lagrange multiplier at each active node.

    In each step the multiplier (negative in compression) and the gap of a node to its segment obey

    .. math:: 0 \le -\lambda_N \perp g_{n+1} - g_{ref} \ge 0,

    with a reference gap that depends on the law of impact.

    Args:
        impact: Law of impact of a node. ``"elastic"``: the node keeps its gap at the start of the
            step, g_ref = g_n (persistency, after Laursen and Chawla 1997). Contact then does no
            work, and the energy-momentum scheme conserves the total energy exactly. Only nodes
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
                "expected a coefficient e with impact 'restitution', and with no other impact, "
                f"given impact {impact!r} and e = {e!r}"
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
        """Constructor call with the kind of impact. Local."""
        e = {"e": self.e} if self.impact == "restitution" else {}
        return as_call(self, impact=self.impact, **e)

    @property
    def part(self) -> float:
        """Weight (1 - e)/2 of the ballistic change of the gap in the reference gap [-]. Local."""
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
        # Each node becomes active in the step that brings it closest to the surface: for e = 1, if
        # its gap is smaller before the step than the ballistic penetration after it. The tolerance
        # keeps round-off from separating simultaneous contacts.
        near = (2 * gap_n - (2 - self.e) * (gap_n - gap_trial)) < TOUCHES * size
        passes = (gap_n > 0) & (gap_trial < gap_n) & near
        # Massless nodes have no velocity that would indicate separation.
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
        """Constructor call with the reach. Local."""
        return as_call(self, reach=self.reach)


class Penalty(Declaration):
    r"""Contact by nodal springs whose force in a step is consistent with their energy.

    The energy of a spring is :math:`U = \varepsilon_N \langle -g \rangle^2/2`. Its force in a step
    is the difference quotient :math:`\lambda_N = (U_{n+1} - U_n)/(g_{n+1} - g_n)`. The
    energy-momentum scheme therefore conserves the energy of bodies and springs.

    Default stiffness, for ``eps_N=None``:

    - In dynamics it is 3/5 of the stiffness of the layer of cells behind the node or the segments,
      whichever is softer. It does not depend on the length of the steps, so that steps that resolve
      a cell are of second order in time. Under the pressure of plane waves, rho c v/2 where equal
      bodies meet at a speed v, springs are compressed by 5/3 of the compression of a cell. Beyond
      one and a half times this compression they are ten times as stiff, and beyond 2.25 times this
      compression a hundred times: the first slope stops an arriving node, the others carry larger
      loads. Where nodes arrive slowly, springs have the last slope nearly from the start.
    - In statics it is ten times the static stiffness of the softer node.
    - Between bodies that do not deform it is half the mass of the lighter one divided by the square
      of the first step; a body that strikes at one point then penetrates by about its motion in one
      or two steps. In statics it is ten times the stiffness of the stiffest deformable node.
    - In `CentralDifference` it is 3/5 of the stiffness of the layers of cells of both sides in
      series. Beyond one and a half times the pressure of plane waves it is up to two and a half
      times as large, as far as the length of the steps allows.

    A surface with all displacements prescribed counts as rigid.

    Args:
        eps_N: Stiffness of the spring at a node [N/m]; None for the default stiffness.

    Attributes:
        eps_N: The argument.
        share: Factor on the stiffness of normal and tangential springs [-]: 1, or less after
            `halved`.

    Raises:
        TypeError: A subclass is defined: the stiffness is all that can be chosen.
        ValueError: ``eps_N`` is not positive.

    Example:
        >>> springs = nts.Penalty(eps_N=1.0e6)  # N/m
        >>> print(nts.ContactPair(bottom, top, enforcement=springs))
        surface-to-surface contact by Penalty
    """

    def __init_subclass__(cls) -> None:
        raise TypeError(
            f"expected no subclass of Penalty, given {cls.__name__}: the force of a spring cannot "
            "be extended, choose its stiffness by Penalty(eps_N)"
        )

    def __init__(self, eps_N: float | None = None) -> None:
        if eps_N is not None:
            positive("a penalty eps_N", eps_N)
        self.eps_N = eps_N
        self.share = 1.0

    def __repr__(self) -> str:
        """Constructor call with the stiffness and, unless it is 1, the share. Local."""
        share = {} if self.share == 1 else {"share": self.share}
        return as_call(self, eps_N=self.eps_N, **share)

    def halved(self) -> "Penalty":
        """Law with springs of half the stiffness. Local."""
        half = Penalty(self.eps_N)
        vars(half)["share"] = self.share / 2  # allowed before the declaration is in use
        return half
