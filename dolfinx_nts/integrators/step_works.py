"""Works and energies of an accepted step, which its report and the ledger account for."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.integrators.inertia import Inertia
from dolfinx_nts.integrators.step_forces import StepForces
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers import newton
from dolfinx_nts.solvers.bulk import Bulk

__all__ = ["StepWorks"]


class StepWorks(NamedTuple):
    """Works and energies of a step, the same on all ranks.

    Attributes:
        damping: Work of damping and of viscous branches, never positive [J].
        solver: Work of the residual that Newton's method left [J].
        inertia: Kinetic energy that was gained beyond the work of all forces [J].
        open_gaps: Work of multipliers on gaps that count as closed, at most [J].
        kinetic: Kinetic energy before and after the step, of lumped masses [J].
        loads: Work of each load [J].
        num_segments: Number of segments in reach of nodes.
    """

    damping: float
    solver: float
    inertia: float
    open_gaps: float
    kinetic: tuple[float, float]
    loads: tuple[float, ...]
    num_segments: int

    @classmethod
    def of(
        cls,
        bulk: Bulk,
        inertia: Inertia,
        forces: StepForces,
        steps: Sequence[ContactStep],
        solution: newton.Solution,
        *,
        defect: float,
        du: Floats,
        v_n: Floats,
        v: Floats,
        closed_within: float,
    ) -> "StepWorks":
        """Add up the works of a step whose velocity is set, in one reduction. Collective.

        Args:
            bulk: Residual of the bodies.
            inertia: How their masses act.
            forces: Forces of the step.
            steps: Contact of the step.
            solution: What Newton's method found for it.
            defect: Kinetic energy gained on this rank beyond the work of all forces [J].
            du: Increments of the owned displacements in it, ``(d n,)`` [m].
            v_n: Velocities of the owned dofs before the step, ``(d n,)`` [m/s].
            v: The same after it.
            closed_within: Gap up to which one is closed [m].
        """
        multipliers = sum(float(np.abs(step.normal.lambda_N).sum()) for step in steps)
        of_this_rank = [
            -inertia.dissipated(),
            float(solution.end.R @ du),
            defect,
            multipliers * closed_within,
            forces.kinetic_energy(v_n),
            forces.kinetic_energy(v),
            float(sum(len(step.candidates.size) for step in steps)),
            *(float(force @ du) for force in bulk.loads()),
        ]
        total = reductions.total(bulk.comm, of_this_rank)
        damping, solver, gained, open_gaps, before, after, segments, *loads = total
        kinetic = before, after
        return cls(damping, solver, gained, open_gaps, kinetic, tuple(loads), int(segments))
