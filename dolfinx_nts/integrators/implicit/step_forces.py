"""Norms of forces, works and reactions of implicit steps."""

from collections.abc import Sequence
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep, contact_forces
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.integrators.implicit.inertia import Inertia
from dolfinx_nts.integrators.statics.mean_forces import MeanForces
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.reaction import Reaction
from dolfinx_nts.model.rigid_body import guided
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers import newton
from dolfinx_nts.solvers.bulk import Bulk

__all__ = ["Reactions", "StepForces", "StepWorks"]

# Fraction of momentum/dt [-] in the force scale of the residual. A body in free flight has no other
# force, and the round-off of its momentum limits the residual.
_INERTIA_PART = 1e-3
# Relative change of the loads [-] that counts as round-off.
_SAME_LOAD = 1e-9


class StepForces:
    """Norms of the forces in the current and in the last step. Collective, as are its methods.

    Args:
        bulk: Residual of the bodies and loads.
        mass: Lumped masses of the owned dofs, ``(d n,)`` [kg].

    Attributes:
        internal: Norm of the internal forces of the last step [N].
        load: Norm of the loads of the last step [N].
    """

    def __init__(self, bulk: Bulk, mass: Floats) -> None:
        self._bulk, self._mass = bulk, mass
        self._comm: MPI.Comm = bulk.comm
        self.internal = self.load = 0.0

    def forget(self) -> None:
        """Discard the norm of the loads of the last step. Local."""
        self.load = np.inf

    def serialize(self, archive: Archive) -> None:
        """Serialize the norms of the last step."""
        self.internal = archive.same("internal_force", self.internal)
        self.load = archive.same("load_norm", self.load)

    def accept(self, load: float, internal: Floats) -> None:
        """Store the norm of the loads [N] and the internal forces of the owned dofs [N]."""
        self.load, self.internal = load, self.norm(internal)

    def loads(self) -> Floats:
        """Forces of all loads on the owned dofs [N]."""
        total: Floats = np.sum([np.zeros_like(self._mass), *self._bulk.loads()], axis=0)
        return total

    def stays(self, load: float) -> bool:
        """Whether the norm ``load`` of the loads [N] equals that of the last step. Local."""
        return abs(load - self.load) <= _SAME_LOAD * load

    def scale(self, load: float, v: Floats, dt: float) -> float:
        """Force scale to which the residual is relative [N].

        Args:
            load: Norm of the loads [N].
            v: Velocities of the owned dofs [m/s].
            dt: Length of the step [s].
        """
        return self.internal + load + _INERTIA_PART * self.norm(self._mass * v) / dt

    def kinetic_energy(self, v: Floats) -> float:
        """Kinetic energy of the owned dofs for their velocities [m/s], on this rank [J]. Local."""
        return float(self._mass @ v**2) / 2

    def norm(self, values: Floats) -> float:
        """Euclidean norm of values at the owned dofs, over all ranks."""
        return float(np.sqrt(reductions.total(self._comm, values @ values)))


class StepWorks(NamedTuple):
    """Works and energies of a step, the same on all ranks.

    Attributes:
        damping: Work of damping and of viscous branches, never positive [J].
        solver: Work of the remaining residual of Newton's method [J].
        inertia: Change of kinetic energy minus the work of all forces [J].
        open_gaps: Upper bound on the work of multipliers by the gaps left within tolerance [J].
        kinetic: Kinetic energy before and after the step, with lumped masses [J].
        loads: Work of each load [J].
        num_segments: Number of candidate segments.
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
        loads: Sequence[Floats],
        du: Floats,
        v_n: Floats,
        v: Floats,
        closed_within: float,
    ) -> "StepWorks":
        """Sum the works of a solved step in one reduction. Collective.

        Args:
            bulk: Residual of the bodies.
            inertia: Inertia of the bodies.
            forces: Forces of the step.
            steps: Contact of the step.
            solution: Solution of Newton's method.
            defect: Change of kinetic energy minus the work of all forces on this rank [J].
            loads: Each load that does work, on the owned dofs, ``(d n,)`` [N].
            du: Displacement increments of the owned dofs, ``(d n,)`` [m].
            v_n: Velocities of the owned dofs before the step, ``(d n,)`` [m/s].
            v: Velocities of the owned dofs after the step, ``(d n,)`` [m/s].
            closed_within: Tolerance of closed gaps [m].
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
            *(float(load @ du) for load in loads),
        ]
        total = reductions.total(bulk.comm, of_this_rank)
        damping, solver, gained, open_gaps, before, after, segments, *works = total
        kinetic = before, after
        return cls(damping, solver, gained, open_gaps, kinetic, tuple(works), int(segments))


class Reactions:
    """Reactions of supports and guides, and work of rigidity constraints.

    Args:
        bulk: Residual of the bodies, with supports and rigid motions.
        bodies: All bodies.
        means: Mean forces of static steps, None with inertia.
        at_mean: Whether forces act in the middle of a step rather than at its end.

    Attributes:
        means: As given.
    """

    def __init__(
        self,
        bulk: Bulk,
        bodies: Sequence[Body],
        means: MeanForces | None,
        *,
        at_mean: bool,
    ) -> None:
        self._bulk, self._at_mean, self.means = bulk, at_mean, means
        rigid = bulk.rigid
        # Constraint forces of rigid bodies in the middle of the step do no work.
        self._constraints_work = rigid.exists and means is None and rigid.part != 0.5
        self._exist = bulk.supports.exist or bool(guided(bodies)) or self._constraints_work

    def _forces(self, steps: Sequence[ContactStep], solution: newton.Solution) -> Floats:
        """Forces of supports and of rigid bodies on the owned dofs, ``(d n,)`` [N]."""
        supports, rigid = self._bulk.supports, self._bulk.rigid
        forces = np.zeros((self._bulk.num_owned // rigid.dim, rigid.dim))
        if self._exist:
            contact = contact_forces(steps, solution.end.states, forces.shape)
            unbalanced = solution.end.forces.reshape(forces.shape) + contact
            forces[rigid.nodes] = unbalanced[rigid.nodes]
            forces.ravel()[supports.fixed] = unbalanced.ravel()[supports.fixed]
        return forces.ravel()

    def of(
        self, steps: Sequence[ContactStep], solution: newton.Solution, x: Floats, du: Floats
    ) -> tuple[tuple[Reaction, ...], list[Floats], float]:
        """Reactions of supports, then of guides, and loads that do work. Collective.

        Args:
            steps: Contact of the step.
            solution: Solution of Newton's method.
            x: Positions of the local nodes at the end of the step, shape ``(l, 3)`` [m].
            du: Displacement increments of the owned nodes, shape ``(n, d)`` [m].

        Returns:
            The reactions; each load that does work, on the owned dofs, ``(d n,)`` [N]; and a work
            on this rank [J]: with inertia, of the rigidity constraints; in statics, of the end
            forces minus the work of the mean forces.
        """
        ends = [self._forces(steps, solution), *self._bulk.loads()]
        means, work = ends, 0.0
        if self.means is not None:
            means = self.means.of(ends)
            work = sum(
                float((end - mean) @ du.ravel()) for end, mean in zip(ends, means, strict=True)
            )
        (force, *_), (mean, *loads) = ends, means
        if not self._exist:
            return (), loads, work
        supports, rigid = self._bulk.supports, self._bulk.rigid
        fixed, (n, d) = supports.fixed, du.shape
        if self._at_mean:
            x = x.copy()
            x[:n] -= in_space(du) / 2
        of_supports = supports.reactions(force[fixed], x, du.ravel()[fixed], mean[fixed])
        force, mean = (each.reshape(n, d) for each in (force, mean))
        if self._constraints_work:
            u = self._bulk.u.x.array[: n * d].reshape(n, d)
            prescribed, nodes = rigid.prescribed_displacement(u), rigid.nodes
            work = float(np.vdot(force[nodes], (du - prescribed)[nodes]))
            du = prescribed
        return of_supports + rigid.guides.reactions(force, x, du, mean), loads, work
