"""Report of an accepted step."""

from typing import NamedTuple

from dolfinx_nts.contact.history import ContactWork

__all__ = ["StepReport"]


class StepReport(NamedTuple):
    """What happened in an accepted step.

    The same on all ranks. The works are energy given to the bodies; with that of the bulk,
    `Diagnostics.bulk_defect`, they add up to the change of kinetic and strain energy.

    Attributes:
        step: Number of the step, from 1.
        t: Time at its end [s].
        dt: Its length [s].
        newton_iterations: Linear systems solved, all attempts.
        active_set_changes: Pairs that changed during the iteration.
        residual_norms: Norms before each linear solve, and the last [N].
        num_active: Active pairs on all ranks.
        num_segments: Segments in reach of nodes, on all ranks; without any nothing was
            projected.
        num_sleeping: Bodies that the step left out, being at rest.
        contact_work: Work of contact, by cause [J].
        load_work: Work of the loads [J].
        support_work: Work of the reactions at moving supports [J].
        damping_work: Work of damping, never positive [J].
        solver_work: Work of the residual that Newton left [J].
        rejected: Longer steps that were tried before this one.
    """

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
    load_work: float
    support_work: float
    damping_work: float
    solver_work: float
    rejected: int = 0
