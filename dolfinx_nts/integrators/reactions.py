"""Reactions of supports and guides in an implicit step, from the forces that its balance leaves."""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep, contact_residual
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.reaction import Reaction
from dolfinx_nts.model.rigid_body import guided
from dolfinx_nts.solvers import newton
from dolfinx_nts.solvers.bulk import Bulk

__all__ = ["Reactions"]


class Reactions:
    """Sums the forces of a step on what is held, led or kept rigid.

    Args:
        bulk: Balance of the bodies, with their supports and rigid motions.
        bodies: All bodies.
        at_mean: Whether forces act in the middle of a step, rather than at its end.
        is_static: Whether bodies have no inertia.
    """

    def __init__(
        self, bulk: Bulk, bodies: Sequence[Body], *, at_mean: bool, is_static: bool
    ) -> None:
        self._bulk, self._at_mean = bulk, at_mean
        rigid = bulk.rigid
        # Where forces act in the middle of the step, what keeps bodies rigid does no work.
        self._constraints_work = rigid.exists and not is_static and rigid.part != 0.5
        self._exist = bulk.supports.exist or bool(guided(bodies)) or self._constraints_work

    def of(
        self, steps: Sequence[ContactStep], solution: newton.Solution, x: Floats, du: Floats
    ) -> tuple[tuple[Reaction, ...], float]:
        """Reactions of supports, then of guides. Collective.

        Args:
            steps: Contact of the step.
            solution: What Newton's method found for it.
            x: Positions at its end, of the local nodes, shape ``(l, 3)`` [m].
            du: Increments of the owned displacements in it, shape ``(n, d)`` [m].

        Returns:
            The reactions, and the work on this rank of what keeps bodies rigid [J].
        """
        if not self._exist:
            return (), 0.0
        supports, rigid = self._bulk.supports, self._bulk.rigid
        fixed, (n, d) = supports.fixed, du.shape
        # The residual of a state has no forces on given displacements; ``force`` has all.
        everywhere = [state._replace(residual=state.force) for state in solution.end.states]
        force = solution.end.forces + contact_residual(steps, everywhere, (n, d))
        if self._at_mean:
            x = x.copy()
            x[:n] -= in_space(du) / 2
        of_supports = supports.reactions(force[fixed], x, du.ravel()[fixed])
        force, work = force.reshape(n, d), 0.0
        if self._constraints_work:
            u = self._bulk.u.x.array[: n * d].reshape(n, d)
            led, nodes = rigid.prescribed_displacement(u), rigid.nodes
            work = float(np.vdot(force[nodes], (du - led)[nodes]))
            du = led
        return of_supports + rigid.guides.reactions(force, x, du), work
