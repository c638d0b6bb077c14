"""Default penalty stiffness of implicit steps, from the static stiffness of nodes."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.integrators.rates import Rates
from dolfinx_nts.integrators.rigid import spring_stiffness
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.layers import nodal_densities, nodal_moduli, nodal_shear_ratios
from dolfinx_nts.solvers.precond.tangent import Tangent

__all__ = ["choose_default_stiffness", "long_step", "static_stiffness"]

# Length of a step relative to the usual one [-] at which inertia and damping are negligible.
_LONG = 1e12

# Default stiffness of normal springs in statics relative to the static stiffness of their nodes
# [-]. Larger: less penetration; smaller: faster convergence of Newton's method.
_STIFF = 10.0


def choose_default_stiffness(
    contacts: Sequence[PairState],
    bodies: Sequence[Body],
    tangent: Tangent,
    rates: Rates,
    mass: Floats,
    dt: fem.Constant,
    share: float,
    free: Floats | None,
) -> None:
    """Set the default stiffness of springs without a given number. Collective.

    Args:
        contacts: States of the contact pairs.
        bodies: All bodies.
        tangent: Tangent of a step; its matrix is discarded if a stiffness is needed.
        rates: Relation between velocities and displacements.
        mass: Lumped mass of the owned nodes, shape ``(n,)`` [kg].
        dt: Length of a step in forms [s].
        share: Weight of the stiffness in the tangent, see `Scheme.stress_share` [-].
        free: 1 where a displacement is unknown, otherwise 0, ``(n, d)``; None if all are.
    """

    @cache
    def stiffness() -> tuple[Floats, Floats]:
        static = partial(static_stiffness, tangent, dt, share)
        return spring_stiffness(static, bodies, mass, rates, free)

    @cache
    def cells() -> tuple[Floats, Floats, Floats]:
        moduli, n = nodal_moduli(bodies, len(mass)), len(mass)
        if free is not None:
            moduli[~free.any(axis=1)] = np.inf
        return moduli, nodal_densities(bodies, n), nodal_shear_ratios(bodies, n)

    for contact in contacts:
        if rates.acceleration is None or contact.pair.method == EDGES:
            contact.derive_penalty(stiffness, _STIFF)
        else:
            contact.derive_penalty(stiffness, 1.0, cells)


@contextmanager
def long_step(dt: fem.Constant) -> Iterator[None]:
    """Context with a step so long that inertia and damping are negligible in forms. Local.

    Args:
        dt: Length of a step in forms [s].
    """
    length = float(dt.value)
    dt.value = _LONG * length
    try:
        yield
    finally:
        dt.value = length


def static_stiffness(tangent: Tangent, dt: fem.Constant, share: float) -> Floats:
    """Mean diagonal entry of the static stiffness at each owned node. Collective.

    Inertia terms of a tangent grow as 1/dt^2. Springs proportional to these would become stiffer
    with shorter steps, so that no step could resolve their vibration.

    Args:
        tangent: Tangent of a step, whose matrix is discarded.
        dt: Length of a step in its forms [s].
        share: Weight of the stiffness in the forms [-], see `Scheme.stress_share`.

    Returns:
        Stiffness, shape ``(n,)`` [N/m].
    """
    with long_step(dt):
        tangent.assemble_nearby()
        stiffness = tangent.nodal_stiffness()
        tangent.forget()
    static: Floats = (1 / share) * stiffness
    return static
