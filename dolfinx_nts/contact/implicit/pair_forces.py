"""Forces of pairs and their derivatives."""

from typing import NamedTuple

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contributions import ContactContribution, PairKinematics
from dolfinx_nts.contact.implicit.friction.interface import Friction
from dolfinx_nts.contact.implicit.normal.interface import NormalContact

__all__ = ["PairForces", "contribution_of"]


class PairForces(NamedTuple):
    """Forces of ``m`` pairs and their derivatives, including prescribed displacements.

    Attributes:
        force: Forces of the pairs, shape ``(m, d)`` [N].
        tangent: Derivative at fixed multipliers and tractions, of `PairBlocks` [N/m].
        columns: Force per multiplier, see `ContactContribution`.
        slopes: Derivative of multipliers w.r.t. gap and slip, see `ContactContribution` [N/m].
    """

    force: Floats
    tangent: Floats
    columns: Floats
    slopes: Floats

    @classmethod
    def of(cls, pairs: PairKinematics, normal: NormalContact, friction: Friction) -> "PairForces":
        """Forces for the current state of normal contact and friction. Local."""
        active, lambda_N = normal.active[pairs.node], normal.lambda_N[pairs.node]
        force = lambda_N[:, None] * pairs.contact.force
        turning, slope = normal.tangent(pairs.node)
        tangent = pairs.blocks.tangent(turning)
        columns, slopes = friction.add_to(pairs, active, force, tangent)
        slopes[:, 0, 0] = slope
        return cls(force, tangent, columns, slopes)


def contribution_of(
    pairs: PairKinematics, normal: NormalContact, friction: Friction, dim: int, changed: int
) -> ContactContribution:
    """Residual and tangent of pairs without prescribed displacements. Local.

    ``dim`` is the number of components of a displacement, and of constraints of a sticking node;
    ``changed`` is the number of pairs that changed their state.
    """
    active = normal.active[pairs.node]
    force, tangent, columns, slopes = PairForces.of(pairs, normal, friction)
    rank = normal.rank(active)
    rank[friction.sticks(pairs.node, active)] = dim
    residual = pairs.blocks.restrict(force, tangent)
    failed = pairs.failures(active)
    return ContactContribution(
        pairs, active, rank, columns, slopes, residual, tangent, force, changed, failed
    )
