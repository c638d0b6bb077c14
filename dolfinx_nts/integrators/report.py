"""Reports, which tell the user what happened in an accepted step."""

from typing import NamedTuple

from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.model.reaction import Reaction

__all__ = ["StepReport"]


class _Numbers(NamedTuple):
    """Fields of a `StepReport`."""

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
    """What happened in an accepted step, the same on all ranks.

    The works are energy given to the bodies. Together with `Diagnostics.bulk_defect` they are
    the change of kinetic and strain energy.

    Attributes:
        step: Number of the step, from 1.
        t: Time at its end [s].
        dt: Its length [s].
        newton_iterations: Linear systems solved in all attempts.
        active_set_changes: Pairs that changed during the iteration.
        residual_norms: Norms of the residual before each linear solve, and the last one [N].
        num_active: Active pairs.
        num_segments: Segments in reach of nodes; with none of them nothing was projected.
        num_sleeping: Sleeping bodies, which the step left out.
        contact_work: Work of contact, by cause [J].
        load_work: Work of the loads [J].
        support_work: Work of the reactions at moving supports [J].
        damping_work: Work of damping and of viscous branches, never positive [J].
        solver_work: Work of the residual that Newton's method left [J].
        load_works: Work of each load [J], in the order of the loads of the stepper.
        reactions: Reaction of each support, in the order of ``bcs`` of the stepper, then of each
            guide of a rigid body, in the order of the bodies. A degree of freedom with several
            conditions counts for the first of them.
        rejected: Number of steps that were tried before this one, and failed.

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
        """Work of the reactions at all moving supports [J]."""
        return float(sum(reaction.work for reaction in self.reactions))
