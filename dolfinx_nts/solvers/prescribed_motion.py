"""Prescribed motion of supports, guides and obstacles, applied in one increment."""

from collections.abc import Sequence

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.solvers.bulk import Bulk

__all__ = ["PrescribedMotion"]


class PrescribedMotion:
    """Prescribed motion of supports, rigid-body guides and obstacles, applied in one increment.

    `SubsteppedMotion` applies it in substeps. Methods are local unless noted.

    Args:
        bulk: Residual of the bodies.
        steps: Contact attempts, whose obstacles move.

    Attributes:
        duration: Number of increments up to the last one with a significant prescribed part.
    """

    def __init__(self, bulk: Bulk, steps: Sequence[ContactStep]) -> None:
        self._bulk, self._steps, self.duration = bulk, steps, 0
        self._place_obstacles(1.0)

    @property
    def is_complete(self) -> bool:
        """Whether the prescribed motion has been applied completely."""
        return True

    @property
    def advances(self) -> bool:
        """Whether a part of the prescribed motion is applied in the current iteration."""
        return False

    @property
    def length(self) -> float:
        """Largest prescribed increment in the current iteration [m]."""
        return 0.0

    def finish(self) -> None:
        """Place obstacles at the end of their motion."""
        self._place_obstacles(1.0)

    def add_forces(
        self, R: Floats, states: Sequence[ContactContribution], target: float | None = None
    ) -> Floats:
        """Add the forces of the prescribed increment to a residual. Collective.

        Args:
            R: Residual on the owned dofs, with the balance of rigid bodies, shape ``(d n,)`` [N].
            states: Pairs of the attempts.
            target: Norm of the residual of a solution [N], below which the next substep begins even
                if the increment causes no forces. None keeps the last decision.
        """
        return R

    def predict(self, states: Sequence[ContactContribution]) -> tuple[ContactContribution, ...]:
        """Contact states with gaps and slips after the prescribed increment, to first order.

        ``states`` are the states of the last `add_forces`.
        """
        return tuple(states)

    def limit(self, du: Floats) -> Floats:
        """Increment of all nodes, ``(d n,)`` [m], including the prescribed increment of supports.

        It is scaled down to limit strains of cells, and penetrations of new contacts. Collective.
        """
        return du

    def advance(self, nodes: Floats, du: Floats, part: float) -> Floats:
        """Displacements after a fraction of the increment from `limit`. Collective.

        Args:
            nodes: Displacements of the owned nodes, shape ``(n, d)`` [m].
            du: The applied fraction of the increment, of the same shape [m].
            part: The fraction, from 0 to 1.
        """
        return self._bulk.rigid.moved(nodes, du)

    def _place_obstacles(self, part: float) -> None:
        """Place obstacles after a fraction of their motion, from 0 to 1."""
        for step in self._steps:
            step.state.search.frame.advance_to(part)
