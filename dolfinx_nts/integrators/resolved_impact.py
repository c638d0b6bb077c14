r"""Impact that is resolved in time: nodes that touch have no mass.

Their mass acts at nodes below them, see `redistributed_mass`. After each step

* they go to their static equilibrium, as far as the energy of this can be paid, while all others
  stay where they are; gaps at which they were caught are closed as far as this costs little
  energy, and otherwise held; nodes that stick keep their place, and those that slide go on with
  the friction of the new reactions,
* the strain energy that this takes or gives, dV, comes from the impulse of contact, and from the
  vibration of the body: with the velocity v = v_rigid + w, where w is orthogonal to rigid motions
  with regard to the mass, v becomes v + s w + a d, where bodies that are rigid would have d by the
  impulse of contact in the step. This changes neither linear nor angular momentum but by impulses
  of supports, and s and a are such that the total energy is what it was before, but for what
  sliding dissipates, and for the work of what moves.
"""

from collections.abc import Sequence
from functools import partial
from operator import attrgetter

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.fem.components import dimension, in_space, possible_motions
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.integrators.body_groups import BodyGroups
from dolfinx_nts.integrators.held_contact import HeldContact
from dolfinx_nts.integrators.implicit_forms import StepForms
from dolfinx_nts.integrators.inertia import Inertia, Settlement
from dolfinx_nts.integrators.memory import Memory
from dolfinx_nts.integrators.payment import Payment
from dolfinx_nts.integrators.rates import MidpointRates
from dolfinx_nts.integrators.recoil import Recoil
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.integrators.static_stiffness import long_step
from dolfinx_nts.integrators.step_losses import StepLosses
from dolfinx_nts.integrators.surface_waves import SurfaceWaves
from dolfinx_nts.integrators.vibration import Vibration, VibrationAnalysis
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.extrapolation import extrapolate
from dolfinx_nts.model.inverted_cells import VolumeRatio
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.model.reaction import Reaction
from dolfinx_nts.solvers.redistributed_mass import (
    MassForce,
    RedistributedBulk,
    RedistributedMass,
    RedistributedTangent,
)
from dolfinx_nts.solvers.surface_equilibrium import SurfaceEquilibrium
from dolfinx_nts.solvers.surface_forces import SurfaceForces
from dolfinx_nts.solvers.surface_work import SurfaceWork

__all__ = ["ResolvedImpact"]

# Part of the energy of vibration that closing gaps may cost in a step [-], and that the
# equilibrium may cost in all.
_CLOSING, _MOST_SPENT = 0.05, 0.5
# Part of the way to equilibrium [-] below which nodes stay where they are.
_LEAST = 1e-3


class ResolvedImpact(Inertia):
    """Mass of the bodies without that of some nodes, and their equilibrium, see `Inertia`.

    Args:
        bodies: The bodies.
        rates: How velocities follow from displacements.
        scheme: The scheme.
        bcs: Dirichlet conditions.
        loads: Virtual work of the loads.
        massless: Owned nodes without mass, sorted.
        memory: Memory of materials.

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
        """Mean stiffness of statics at the owned nodes, where they are free, ``(n,)`` [N/m].

        That of the last matrix would depend on how linear systems were solved.
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
        """Derivative of the mean velocity by the displacement [1/s]. Local."""
        return 1 / float(self._rates.dt.value)

    def _per_time_squared(self) -> float:
        """Derivative of the mean acceleration by the displacement [1/s^2]. Local."""
        return 2 / float(self._rates.dt.value) ** 2

    def momentum(self) -> Floats:
        v = self._rates.v.x.array[: self.bulk.num_owned]
        return self._mass.times(v.reshape(self._X.shape))

    def carried(self, forces: Floats) -> Floats:
        return self._mass.carried(forces)

    def dissipated(self) -> float:
        return self._losses.on_this_rank()

    def accept(self, steps: Sequence[ContactStep]) -> Settlement:
        rates, massless = self._rates, self._equilibrium.nodes
        defect, n = rates.accept(), self.bulk.num_owned
        u, v = (f.x.array[:n].reshape(self._X.shape) for f in (rates.u, rates.v))
        dt, held = float(rates.dt.value), HeldContact(steps, self._groups)
        impulses, of_obstacles = held.impulses(v.shape[1], dt)
        # Nodes without mass have no part in these.
        x, mean = self._X + u, self._mean_velocity()[:n].reshape(v.shape)
        vibration, recoil = self._motions.of(x, v, mean, impulses)
        recoil = recoil._replace(linear=recoil.linear - of_obstacles)
        if any(step.num_active for step in steps):
            self._waves.tell(dt)
        cost, dissipation, payment = self._equilibrate(held, vibration, recoil)
        recoils, factors = payment.recoils, payment.factors
        moves = recoil.velocities(recoils)
        for g, factor, move in zip(self._groups.nodes, factors, moves, strict=True):
            v[g] += factor * vibration.w[g] + move
        impulses = factors[:, None, None] * vibration.held + np.tensordot(recoils, recoil.held, 1)
        reactions = self._reactions(recoil.at_nodes(impulses), x, mean)
        held.add_recoil(recoils)
        mean_velocity = rates.mean_velocity.x.array
        mean_velocity[:] = self._mean_velocity()
        v[massless] = mean_velocity[:n].reshape(v.shape)[massless]
        rates.v.x.scatter_forward()
        energies = cost, -dissipation, payment.wanted + dissipation, recoils * of_obstacles
        spent, friction, back, obstacles = (float(part.sum()) for part in energies)
        work = ContactWork(equilibrium=spent, friction=friction, refund=back, obstacles=obstacles)
        return Settlement(defect, work, reactions)

    def _reactions(
        self, impulses: Sequence[Floats], x: Floats, velocity: Floats
    ) -> tuple[Reaction, ...]:
        """Reactions of supports by impulses at nodes of groups, if they are fixed. Collective.

        Args:
            impulses: Of each group, ``(n, d)`` [N s].
            x: Positions of the owned nodes, ``(n, d)`` [m].
            velocity: Mean velocity of the step there, ``(n, d)`` [m/s].
        """
        supports, dt, force = self.bulk.supports, float(self._rates.dt.value), np.zeros_like(x)
        if not supports.exist:
            return ()
        for g, impulse in zip(self._groups.nodes, impulses, strict=True):
            force[g] = impulse / dt
        force, way = (values.ravel()[supports.fixed] for values in (force, dt * velocity))
        return supports.reactions(force, in_space(x), way)

    def _equilibrate(
        self,
        held: HeldContact,
        vibration: Vibration,
        recoil: Recoil,
    ) -> tuple[Floats, Floats, Payment]:
        """Move nodes without mass towards equilibrium, as far as groups can pay for it.

        ``vibration`` and ``recoil`` are what they pay with. Returns the work of stress and damping
        on this way, and what friction dissipates, both ``(g,)`` [J], and what is paid. Collective.
        """
        u = self._rates.u.x
        massless, way = self._equilibrium.nodes, np.zeros_like(self._X)
        before, work, damping = u.array.copy(), self._work.at_nodes(), self._losses.begin()
        most = vibration.energy + recoil.most
        part = partial(self._affordable, _CLOSING * vibration.energy + recoil.most)
        increments = self._equilibrium.find(held.holds, part, damping)
        share: Floats = np.ones(len(self._groups.nodes))
        while True:
            way[massless] = share[self._groups.number_of[massless], None] * increments
            u.array[: way.size] = before[: way.size] + way.ravel()
            u.scatter_forward()
            self._memory.accept()
            cost = self._groups.sums(slice(None), self._work.at_nodes() - work)
            cost += self._losses.follow(way[massless])
            histories, dissipation = held.after(way)
            payment = Payment.of(vibration, recoil, -cost - dissipation)
            good = payment.is_whole
            good &= (cost <= _MOST_SPENT * most) & (not self._volume_ratio.inverted())
            if np.all(good | (share == 0)):
                break
            share = np.where(good, share, np.where(share > _LEAST, share / 2, 0.0))
        held.accept(histories)
        return cost, dissipation, payment

    def _affordable(self, budget: Floats, costs: Floats) -> Floats:
        """Parts of gaps that groups can pay for closing, at nodes without mass, ``(m,)``.

        ``budget`` are energies of the groups, ``(g,)``, and ``costs`` those of the nodes for the
        whole gaps, ``(m,)`` [J]. Collective.
        """
        massless = self._equilibrium.nodes
        sums = self._groups.sums(massless, costs)
        part: Floats = np.divide(budget, sums, out=np.ones_like(sums), where=sums > budget)
        return part[self._groups.number_of[massless]]
