r"""Impact resolved in time, with massless contact nodes.

Interior nodes below the surface carry their mass, see `redistributed_mass`. After each step

* the massless nodes move to their static equilibrium, within the available energy, while all other
  nodes stay. Gaps of active nodes are closed if this needs little energy, and otherwise kept.
  Sticking nodes keep their positions, sliding nodes follow the friction of the new reactions.
* an energy correction restores the total energy except for friction and the work of moving
  supports and obstacles. With v = v_rigid + w, where w is orthogonal to rigid motions in the mass
  product, v becomes v + s w + a d. Here d is the rigid velocity due to the contact impulse of the
  step. Linear and angular momentum change by impulses of supports only.
"""

import logging
from collections.abc import Sequence
from functools import partial
from operator import attrgetter

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.fem.components import dimension, in_space, possible_motions
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.integrators.implicit.implicit_forms import StepForms
from dolfinx_nts.integrators.implicit.inertia import Inertia, VelocityUpdate
from dolfinx_nts.integrators.implicit.static_stiffness import long_step
from dolfinx_nts.integrators.inelastic.memory import Memory
from dolfinx_nts.integrators.massless.active_contact import ActiveContact
from dolfinx_nts.integrators.massless.body_groups import BodyGroups
from dolfinx_nts.integrators.massless.losses import StepLosses
from dolfinx_nts.integrators.massless.vibration import (
    EnergyCorrection,
    RigidCorrection,
    Vibration,
    VibrationAnalysis,
)
from dolfinx_nts.integrators.rates import MidpointRates
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.checks.inverted_cells import VolumeRatio
from dolfinx_nts.model.extrapolation import extrapolate
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.model.reaction import Reaction
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.massless.redistributed_mass import (
    MassForce,
    RedistributedBulk,
    RedistributedMass,
    RedistributedTangent,
)
from dolfinx_nts.solvers.massless.surface_equilibrium import SurfaceEquilibrium
from dolfinx_nts.solvers.massless.surface_forces import SurfaceForces
from dolfinx_nts.solvers.massless.surface_work import SurfaceWork

__all__ = ["ResolvedImpact", "SurfaceWaves"]

# Largest energy used to close gaps in a step, and used by the static solve in total, relative to
# the vibration energy [-].
_CLOSING, _MOST_SPENT = 0.05, 0.5
# Fraction of the displacement to equilibrium [-] below which nodes do not move.
_LEAST = 1e-3

_logger = logging.getLogger("dolfinx_nts")

# Courant number [-] above which a step does not resolve waves at the surface.
_RESOLVED = 1.0


class SurfaceWaves:
    """Courant number of waves at the surface. Collective.

    In a chain of springs k between masses m waves cross sqrt(k/m) springs per second. The last
    mass is m/2 and has the stiffness k.

    Args:
        comm: Communicator.
        stiffness: Stiffness of the owned nodes of the surface, shape ``(m,)`` [N/m].
        mass: Lumped mass of these nodes, shape ``(m,)`` [kg].
        degree: Degree of the cells; for degree 2 the length is half a cell.
    """

    def __init__(self, comm: MPI.Comm, stiffness: Floats, mass: Floats, degree: int) -> None:
        ratio = stiffness / (2 * mass)
        fastest = reductions.largest(comm, ratio.max(initial=0.0))
        self._cells_per_second = float(np.sqrt(fastest))
        self._is_silent = comm.rank != 0
        self._cell = "cells" if degree == 1 else "halves of cells"

    def check(self, dt: float) -> None:
        """Warn once if a step dt [s] does not resolve waves in a cell. Local."""
        crossings = self._cells_per_second * dt
        if self._is_silent or crossings <= _RESOLVED:
            return
        self._is_silent = True
        _logger.warning(
            "Courant number %.2g of %s at the surface: too large for second order in time with "
            "impact 'resolved'; harmless, as the energy is exact nevertheless, but 'elastic' is "
            "as accurate and faster; use dt <= %.2g s to resolve impact",
            crossings,
            self._cell,
            _RESOLVED / self._cells_per_second,
        )


class ResolvedImpact(Inertia):
    """Inertia with massless contact nodes, and their static equilibrium.

    Args:
        bodies: The bodies.
        rates: Relation between velocities and displacements.
        scheme: The scheme.
        bcs: Dirichlet conditions.
        loads: Virtual work of the loads.
        massless: Owned massless nodes, sorted.
        memory: Internal variables of materials.

    Raises:
        ValueError: There are too few nodes below the surface.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        rates: MidpointRates,
        scheme: Scheme,
        bcs: Sequence[fem.DirichletBC],
        loads: Sequence[ufl.Form],
        massless: Ints,
        memory: Memory,
    ) -> None:
        self._rates, self._memory, u = rates, memory, rates.u
        self._groups = groups = BodyGroups(bodies)
        below = extrapolate(bodies, massless)
        self._mass = mass = RedistributedMass(bodies, below)
        inertia = [MassForce(mass, rates.mean_acceleration, self._per_time_squared)]
        if any(body.material.mass_damping > 0 for body in bodies):
            damped = RedistributedMass(bodies, below, attrgetter("mass_damping"))
            inertia.append(MassForce(damped, self._mean_velocity, self._per_time))
        forms = StepForms(bodies, rates, scheme, memory, inertia=False)
        residual = forms.residual()
        self.bulk = RedistributedBulk(residual, u, bcs, loads, inertia, jumps=memory.flows)
        self.tangent = RedistributedTangent(
            *(residual, u, bcs, loads, forms.nearby_tangent(), [body.nodes for body in bodies]),
            *(inertia, rates.dt),
        )
        stiffness = self._undeformed_stiffness(scheme.stress_share)[massless]
        fixed = self.bulk.supports.fixed
        surface = SurfaceForces(forms.elastic_residual(), u, massless, fixed)
        self._losses = StepLosses(forms, rates, inertia[1:], massless, fixed, groups)
        self._work = SurfaceWork(forms.undamped_residual(), rates.u_n, u, surface.cells)
        self._equilibrium = SurfaceEquilibrium(
            surface, rates.u_n, scheme.stress_share, stiffness, self._losses.resistance
        )
        self._volume_ratio = VolumeRatio(u, surface.cells)
        V = u.function_space
        n = V.dofmap.index_map.size_local
        self._X: Floats = reference_positions(V)[:n, : dimension(V)]
        possible = possible_motions(V)
        self._motions = VibrationAnalysis(
            groups.comm, mass, groups.nodes, fixed, (n, dimension(V)), possible
        )
        mass_there, degree = lumped_mass(bodies)[massless], Element.of(V).degree
        self._waves = SurfaceWaves(groups.comm, stiffness, mass_there, degree)

    def _undeformed_stiffness(self, share: float) -> Floats:
        """Mean static stiffness of the free dofs of each owned node, ``(n,)`` [N/m].

        The last tangent matrix would make results depend on the solution of the linear systems.
        """
        with long_step(self._rates.dt):
            self.tangent.assemble_nearby()
            diagonal = self.tangent.rows.diagonal() / share
            self.tangent.forget()
        free: Floats = np.ones(diagonal.shape)
        free.ravel()[self.bulk.supports.fixed] = 0
        count = free.sum(axis=1)
        stiffness: Floats = (free * diagonal).sum(axis=1) / np.maximum(count, 1)
        return np.where(count > 0, stiffness, 1.0)

    def _mean_velocity(self) -> Floats:
        """Mean velocity of the step at the local dofs, shape ``(d l,)`` [m/s]. Local."""
        velocity: Floats = self._per_time() * (self._rates.u.x.array - self._rates.u_n.x.array)
        return velocity

    def _per_time(self) -> float:
        """Derivative of the mean velocity with respect to the displacement [1/s]. Local."""
        return 1 / float(self._rates.dt.value)

    def _per_time_squared(self) -> float:
        """Derivative of the mean acceleration with respect to the displacement [1/s^2]. Local."""
        return 2 / float(self._rates.dt.value) ** 2

    def momentum(self) -> Floats:
        v = self._rates.v.x.array[: self.bulk.num_owned]
        return self._mass.times(v.reshape(self._X.shape))

    def carried(self, forces: Floats) -> Floats:
        return self._mass.carried(forces)

    def dissipated(self) -> float:
        return self._losses.on_this_rank()

    def accept(self, steps: Sequence[ContactStep]) -> VelocityUpdate:
        rates, massless = self._rates, self._equilibrium.nodes
        defect, n = rates.accept(), self.bulk.num_owned
        u, v = (f.x.array[:n].reshape(self._X.shape) for f in (rates.u, rates.v))
        dt, active = float(rates.dt.value), ActiveContact(steps, self._groups)
        impulses, of_obstacles = active.impulses(v.shape[1], dt)
        # Massless nodes do not contribute to momentum and kinetic energy.
        x, mean = self._X + u, self._mean_velocity()[:n].reshape(v.shape)
        vibration, rigid_correction = self._motions.of(x, v, mean, impulses)
        rigid_correction = rigid_correction._replace(linear=rigid_correction.linear - of_obstacles)
        if any(step.num_active for step in steps):
            self._waves.check(dt)
        cost, dissipation, correction = self._equilibrate(active, vibration, rigid_correction)
        rigid_factors, factors = correction.rigid_factors, correction.factors
        moves = rigid_correction.velocities(rigid_factors)
        for g, factor, move in zip(self._groups.nodes, factors, moves, strict=True):
            v[g] += factor * vibration.w[g] + move
        impulses = factors[:, None, None] * vibration.support_impulses + np.tensordot(
            rigid_factors, rigid_correction.support_impulses, 1
        )
        reactions = self._reactions(rigid_correction.at_nodes(impulses), x, mean)
        active.add_impulses(rigid_factors)
        mean_velocity = rates.mean_velocity.x.array
        mean_velocity[:] = self._mean_velocity()
        v[massless] = mean_velocity[:n].reshape(v.shape)[massless]
        rates.v.x.scatter_forward()
        energies = cost, -dissipation, correction.wanted + dissipation, rigid_factors * of_obstacles
        spent, friction, back, obstacles = (float(part.sum()) for part in energies)
        work = ContactWork(equilibrium=spent, friction=friction, refund=back, obstacles=obstacles)
        return VelocityUpdate(defect, work, reactions)

    def _reactions(
        self, impulses: Sequence[Floats], x: Floats, velocity: Floats
    ) -> tuple[Reaction, ...]:
        """Reactions of supports due to impulses at fixed nodes. Collective.

        Args:
            impulses: Impulses at the nodes of each group, ``(n, d)`` [N s].
            x: Positions of the owned nodes, ``(n, d)`` [m].
            velocity: Mean velocity of the step there, ``(n, d)`` [m/s].
        """
        supports, dt, force = self.bulk.supports, float(self._rates.dt.value), np.zeros_like(x)
        if not supports.exist:
            return ()
        for g, impulse in zip(self._groups.nodes, impulses, strict=True):
            force[g] = impulse / dt
        force, du = (values.ravel()[supports.fixed] for values in (force, dt * velocity))
        return supports.reactions(force, in_space(x), du)

    def _equilibrate(
        self,
        active: ActiveContact,
        vibration: Vibration,
        rigid_correction: RigidCorrection,
    ) -> tuple[Floats, Floats, EnergyCorrection]:
        """Move massless nodes towards static equilibrium within the available energy. Collective.

        Returns:
            Work of stress and damping, and dissipation of friction, both ``(g,)`` [J], and the
            energy correction.
        """
        u = self._rates.u.x
        massless, du = self._equilibrium.nodes, np.zeros_like(self._X)
        before, work, damping = u.array.copy(), self._work.at_nodes(), self._losses.begin()
        most = vibration.energy + rigid_correction.most
        part = partial(self._affordable, _CLOSING * vibration.energy + rigid_correction.most)
        increments = self._equilibrium.find(active.constraints, part, damping)
        share: Floats = np.ones(len(self._groups.nodes))
        while True:
            du[massless] = share[self._groups.number_of[massless], None] * increments
            u.array[: du.size] = before[: du.size] + du.ravel()
            u.scatter_forward()
            self._memory.accept()
            cost = self._groups.sums(slice(None), self._work.at_nodes() - work)
            cost += self._losses.follow(du[massless])
            histories, dissipation = active.after(du)
            correction = EnergyCorrection.of(vibration, rigid_correction, -cost - dissipation)
            good = correction.is_whole
            good &= (cost <= _MOST_SPENT * most) & (not self._volume_ratio.inverted())
            if np.all(good | (share == 0)):
                break
            share = np.where(good, share, np.where(share > _LEAST, share / 2, 0.0))
        active.accept(histories)
        return cost, dissipation, correction

    def _affordable(self, budget: Floats, costs: Floats) -> Floats:
        """Fractions of the gaps that can be closed within an energy budget. Collective.

        Args:
            budget: Energy of each group, ``(g,)`` [J].
            costs: Energy for closing the whole gap at each massless node, ``(m,)`` [J].

        Returns:
            Fractions at the massless nodes, ``(m,)``.
        """
        massless = self._equilibrium.nodes
        sums = self._groups.sums(massless, costs)
        part: Floats = np.divide(budget, sums, out=np.ones_like(sums), where=sums > budget)
        return part[self._groups.number_of[massless]]
