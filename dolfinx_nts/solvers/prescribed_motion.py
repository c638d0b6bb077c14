"""The given way in a solution: what is led, at the end of its way at once."""

from collections.abc import Sequence

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.solvers.bulk import Bulk

__all__ = ["PrescribedMotion"]


class PrescribedMotion:
    """What is led has still to go in a solution: nothing, unless `SubsteppedMotion` says otherwise.

    Supports, guides of rigid bodies and obstacles are led. Methods are local unless noted.

    Args:
        bulk: Residual of the bodies.
        steps: Contact attempts, whose obstacles go along.

    Attributes:
        duration: Number of increments until the last one that took on what is led by a part of
            its way that counts.
    """

    def __init__(self, bulk: Bulk, steps: Sequence[ContactStep]) -> None:
        """Lead obstacles to the end."""
        self._bulk, self._steps, self.duration = bulk, steps, 0
        self._place_obstacles(1.0)

    @property
    def is_complete(self) -> bool:
        """Whether all is where it is led to."""
        return True

    @property
    def advances(self) -> bool:
        """Whether what is led goes a part of its way in this iteration."""
        return False

    @property
    def length(self) -> float:
        """Largest way of what is led in this iteration [m]."""
        return 0.0

    def finish(self) -> None:
        """Let obstacles be at the ends of their ways."""
        self._place_obstacles(1.0)

    def add_forces(
        self, R: Floats, states: Sequence[ContactContribution], target: float | None = None
    ) -> Floats:
        """Add the forces of the way that is gone in this iteration to a residual. Collective.

        Args:
            R: Residual on the owned dofs, of rigid bodies their balance, shape ``(d n,)`` [N].
            states: Pairs of the attempts.
            target: Norm of the residual of a solution [N], for which the way need not wait: where
                all of a body is led, it adds no forces. None: what was decided last stays.
        """
        return R

    def predict(self, states: Sequence[ContactContribution]) -> tuple[ContactContribution, ...]:
        """Let constraints see gaps and slips at the end of the way of this iteration.

        ``states`` are those of the last `add_forces`.
        """
        return tuple(states)

    def limit(self, du: Floats) -> Floats:
        """Increment of all nodes, shape ``(d n,)`` [m], with that of supports in its place.

        It is so short that cells can follow, also where nodes meet others. Collective.
        """
        return du

    def advance(self, nodes: Floats, du: Floats, part: float) -> Floats:
        """Displacements after a part of the increment that `limit` has returned. Collective.

        Args:
            nodes: Displacements of the owned nodes, shape ``(n, d)`` [m].
            du: That part of the increment, of the same shape [m].
            part: The part, from 0 to 1.
        """
        return self._bulk.rigid.moved(nodes, du)

    def _place_obstacles(self, part: float) -> None:
        """Let obstacles be where they are after a part of their ways, from 0 to 1."""
        for step in self._steps:
            step.state.search.frame.go(part)
