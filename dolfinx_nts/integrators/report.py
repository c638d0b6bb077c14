"""Reports of accepted steps."""

from typing import NamedTuple

from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.model.reaction import Reaction

__all__ = ["StepReport"]


class _Numbers(NamedTuple):
    """Stored fields of `StepReport`, from which its properties are computed."""

    step: int
    t: float
    dt: float
    newton_iterations: int
    active_set_changes: int
    residual_norms: tuple[float, ...]
    num_active: int
    num_segments: int
    num_sleeping: int
    contact_work: ContactWork
    damping_work: float
    solver_work: float
    load_works: tuple[float, ...] = ()
    reactions: tuple[Reaction, ...] = ()
    rejected: int = 0


class StepReport(_Numbers):
    """Report of an accepted step, the same on all ranks.

    Works are positive if bodies receive energy. Together with `Diagnostics.bulk_defect` they add up
    to the change of kinetic and strain energy.

    Attributes:
        step: Number of the step, starting from 1.
        t: Time at its end [s].
        dt: Its length [s].
        newton_iterations: Linear systems solved in all attempts.
        active_set_changes: Number of changes of the active set during the iteration.
        residual_norms: Norms of the residual before each linear solve, and the last one [N].
        num_active: Number of active contact points.
        num_segments: Number of candidate segments; if 0, nothing was projected.
        num_sleeping: Number of inactive bodies that the step skipped.
        contact_work: Work of contact, by cause [J].
        load_work: Work of the loads [J].
        support_work: Work of the reactions at moving supports and guides [J].
        damping_work: Work of damping and of viscous branches, never positive [J].
        solver_work: Work of the remaining residual of Newton's method [J].
        load_works: Work of each load [J], in the order of the loads of the stepper.
        reactions: Reaction of each support, in the order of ``bcs`` of the stepper, then of each
            guide of a rigid body, in the order of the bodies. A degree of freedom with several
            conditions counts for the first of them.
        rejected: Number of failed attempts with longer steps before this one.

    Example:
        >>> step = stepper.advance()
        >>> step.step, step.t, step.num_active
        (1, 0.01, 0)
    """

    __slots__ = ()

    @property
    def load_work(self) -> float:
        """Work of all loads [J]."""
        return float(sum(self.load_works))

    @property
    def support_work(self) -> float:
        """Sum of the works of all reactions, of supports and of guides [J]."""
        return float(sum(reaction.work for reaction in self.reactions))
