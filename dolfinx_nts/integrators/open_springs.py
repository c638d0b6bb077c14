"""Stiffness of the springs of contact that the user left open, in implicit steps."""

from collections.abc import Sequence
from functools import cache, partial

from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.integrators.rates import Rates
from dolfinx_nts.integrators.rigid import spring_stiffness
from dolfinx_nts.integrators.static_stiffness import static_stiffness
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["choose_springs"]

# Stiffness of normal springs that are left open, relative to that of their nodes without inertia
# [-]. In a motion stiffer ones make nodes bounce in a time that steps do not resolve; in statics
# nothing bounces, and Newton's method alone limits them.
_RESOLVED, _STIFF = 1.0, 10.0


def choose_springs(
    contacts: Sequence[PairState],
    bodies: Sequence[Body],
    tangent: Tangent,
    rates: Rates,
    mass: Floats,
    dt: fem.Constant,
    share: float,
    free: Floats | None,
) -> None:
    """Choose the stiffness of springs that is not known yet. Collective.

    Args:
        contacts: States of the contact pairs.
        bodies: All bodies.
        tangent: Tangent of a step, which forgets its matrix if one is needed.
        rates: How velocities follow from displacements.
        mass: Lumped mass of the owned nodes, shape ``(n,)`` [kg].
        dt: Length of a step in forms [s].
        share: Part of the stiffness in the tangent, see `Scheme.stress_share` [-].
        free: 1 where a displacement is unknown, otherwise 0, ``(n, d)``; None if all are.
    """

    @cache
    def stiffness() -> tuple[Floats, Floats]:
        """That of all nodes, which the pairs with open springs have in common."""
        static = partial(static_stiffness, tangent, dt, share)
        return spring_stiffness(static, bodies, mass, rates, free)

    for contact in contacts:
        contact.derive_penalty(stiffness, _STIFF if rates.acceleration is None else _RESOLVED)
