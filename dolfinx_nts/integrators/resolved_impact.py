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

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.history import ContactHistory, ContactWork
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.held_nodes import HeldNodes
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.fem.components import dimension, in_space, possible_motions
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.integrators.body_groups import BodyGroups
from dolfinx_nts.integrators.implicit_forms import StepForms
from dolfinx_nts.integrators.inertia import Inertia, Settlement
from dolfinx_nts.integrators.memory import Memory
from dolfinx_nts.integrators.rates import MidpointRates
from dolfinx_nts.integrators.recoil import Recoil
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.integrators.static_stiffness import long_step
from dolfinx_nts.integrators.step_losses import StepLosses
from dolfinx_nts.integrators.vibration import Vibration, VibrationAnalysis
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.extrapolation import extrapolate
from dolfinx_nts.model.inverted_cells import VolumeRatio
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.model.reaction import Reaction
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.held_gaps import Holds
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

_logger = logging.getLogger("dolfinx_nts")

# Part of the energy of vibration that closing gaps may cost in a step [-], and that the
# equilibrium may cost in all.
_CLOSING, _MOST_SPENT = 0.05, 0.5
# Energy that was not paid, relative to what was wanted [-], that is round-off.
_ROUND_OFF = 1e-12
# Part of the way to equilibrium [-] below which nodes stay where they are.
_LEAST = 1e-3
# Cells that waves cross in a step [-] above which a step does not resolve them.
_RESOLVED = 1.0


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
        """Compile the forms, and give the mass to the nodes below."""
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
        self._X = V.tabulate_dof_coordinates()[:n, : dimension(V)]
        possible = possible_motions(V)
        self._motions = VibrationAnalysis(
            groups.comm, mass, groups.nodes, fixed, self._X.shape, possible
        )
        self._untold_speed = self._cells_per_second(stiffness, lumped_mass(bodies)[massless])

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

    def _cells_per_second(self, stiffness: Floats, lumped: Floats) -> float:
        """How many cells, or halves of those of degree 2, a wave crosses in a second. Collective.

        At the surface: in a chain of springs k between masses m it crosses sqrt(k/m) of them, and
        the last one, which has the mass m/2, has the stiffness k.
        """
        ratio = stiffness / (2 * lumped)
        return float(np.sqrt(reductions.largest(self._groups.comm, ratio.max(initial=0.0))))

    def _tell(self) -> None:
        """Say once, when there is contact, if a step does not resolve what waves do in a cell."""
        speed = self._untold_speed
        crossings = speed * float(self._rates.dt.value)
        if crossings <= _RESOLVED:
            return
        self._untold_speed = 0.0
        degree = Element.of(self._rates.u.function_space).degree
        if self._groups.comm.rank == 0:
            _logger.warning(
                "waves cross %.2g %s at the surface in a step, too many for impact 'resolved' "
                "to be of second order in time: harmless, as the energy is exact nevertheless, "
                "but 'elastic' does as well in less time; take dt <= %.2g s to resolve impact",
                crossings,
                "cells" if degree == 1 else "halves of cells",
                _RESOLVED / speed,
            )

    def momentum(self) -> Floats:
        """Multiply the velocity by the mass, see `Inertia.momentum`."""
        v = self._rates.v.x.array[: self.bulk.num_owned]
        return self._mass.times(v.reshape(self._X.shape))

    def carried(self, forces: Floats) -> Floats:
        """Take forces to the nodes below, see `Inertia.carried`."""
        return self._mass.carried(forces)

    def dissipated(self) -> float:
        """Energy that is lost, see `Inertia.dissipated`."""
        return self._losses.on_this_rank()

    def accept(self, steps: Sequence[ContactStep]) -> Settlement:
        """Set the velocity, then find the equilibrium and pay for it, see `Inertia.accept`."""
        rates, massless = self._rates, self._equilibrium.nodes
        defect, n = rates.accept(), self.bulk.num_owned
        u, v = (f.x.array[:n].reshape(self._X.shape) for f in (rates.u, rates.v))
        held = [(step, HeldNodes.of(step)) for step in steps if is_resolved(step.state.pair)]
        impulses, of_obstacles = self._impulses(held)
        # Nodes without mass have no part in these.
        x, mean = self._X + u, self._mean_velocity()[:n].reshape(v.shape)
        vibration, recoil = self._motions.of(x, v, mean, impulses)
        recoil = recoil._replace(linear=recoil.linear - of_obstacles)
        cost, dissipation, recoils, factors = self._equilibrate(steps, held, vibration, recoil)
        refund = -cost - dissipation
        moves = recoil.velocities(recoils)
        for g, factor, move in zip(self._groups.nodes, factors, moves, strict=True):
            v[g] += factor * vibration.w[g] + move
        impulses = factors[:, None, None] * vibration.held + np.tensordot(recoils, recoil.held, 1)
        reactions = self._reactions(recoil.at_nodes(impulses), x, mean)
        self._share(held, recoils)
        mean_velocity = rates.mean_velocity.x.array
        mean_velocity[:] = self._mean_velocity()
        v[massless] = mean_velocity[:n].reshape(v.shape)[massless]
        rates.v.x.scatter_forward()
        energies = cost, -dissipation, refund + dissipation, recoils * of_obstacles
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

    def _impulses(self, held: Sequence[tuple[ContactStep, HeldNodes]]) -> tuple[Floats, Floats]:
        """Impulses of normal contact in the step, see `VibrationAnalysis.of`. Collective.

        They act at the end of the step, where gaps have gradients without resultant and moment.
        Also returns the work of moving obstacles by them, shape ``(g,)`` [J].
        """
        n, d = self._X.shape
        dt, size = float(self._rates.dt.value), len(self._groups.nodes)
        impulses, work = np.zeros((size, size, 1 + d, d)), np.zeros(size)
        group = np.zeros((n, 3))
        group[:, 0] = self._groups.number_of
        for step, some in held:
            mine = self._groups.number_of[step.state.nodes.nodes[some.node]]
            other = step.candidates.scatter.forward(group)[some.dofs, 0].astype(np.int32)
            x_n, x = (positions[some.dofs] for positions in (step.search.x_n, step.x))
            impulse = some.gradients[:, 0].reshape(x.shape) * (dt * some.force)[:, None, None]
            fields = np.insert(x[:, :, :d], 0, 1.0, axis=2)
            products = fields[:, :, :, None] * impulse[:, :, None, :d]
            np.add.at(impulses, (mine[:, None], other), products)
            carried = step.state.search.frame.carried(x_n, x)
            np.add.at(work, mine, (impulse * carried).sum(axis=(1, 2)) / dt)
        comm = self._groups.comm
        return reductions.total(comm, impulses), reductions.total(comm, work)

    def _equilibrate(
        self,
        steps: Sequence[ContactStep],
        held: Sequence[tuple[ContactStep, HeldNodes]],
        vibration: Vibration,
        recoil: Recoil,
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Move nodes without mass towards equilibrium, as far as groups can pay for it.

        ``vibration`` and ``recoil`` are what they pay with. Returns the work of stress and damping
        on this way, and what friction dissipates, both ``(g,)`` [J], and the factors of recoil and
        of vibration that pay for it. Collective.
        """
        u = self._rates.u.x
        massless, way = self._equilibrium.nodes, np.zeros_like(self._X)
        before, work, damping = u.array.copy(), self._work.at_nodes(), self._losses.begin()
        if any(step.num_active for step in steps):
            self._tell()
        holds = [_held(step, some) for step, some in held]
        most = vibration.energy + recoil.most
        part = partial(self._affordable, _CLOSING * vibration.energy + recoil.most)
        increments = self._equilibrium.find(holds, part, damping)
        share: Floats = np.ones(len(self._groups.nodes))
        while True:
            way[massless] = share[self._groups.number_of[massless], None] * increments
            u.array[: way.size] = before[: way.size] + way.ravel()
            u.scatter_forward()
            self._memory.accept()
            cost = self._groups.sums(slice(None), self._work.at_nodes() - work)
            cost += self._losses.follow(way[massless])
            histories, dissipation = self._slid(held, way)
            wanted = -cost - dissipation
            recoils, factors, given = _payment(vibration, recoil, wanted)
            good = np.abs(wanted - given) <= _ROUND_OFF * np.abs(wanted)
            good &= (cost <= _MOST_SPENT * most) & (not self._volume_ratio.inverted())
            if np.all(good | (share == 0)):
                break
            share = np.where(good, share, np.where(share > _LEAST, share / 2, 0.0))
        for (step, _), history in zip(held, histories, strict=True):
            step.state.accept(history)
        return cost, dissipation, recoils, factors

    def _share(self, held: Sequence[tuple[ContactStep, HeldNodes]], recoils: Floats) -> None:
        """Let contact know the impulses of recoil, factors ``(g,)`` of its own. Local."""
        for step, some in held:
            nodes, history = step.state.nodes.nodes, step.state.history
            factor = recoils[self._groups.number_of[nodes]]
            lambda_N = (1 + factor) * history.lambda_N
            force = history.force + factor[:, None] * some.pushes
            step.state.accept(replace(history, lambda_N=lambda_N, force=force))

    def _affordable(self, budget: Floats, costs: Floats) -> Floats:
        """Parts of gaps that groups can pay for closing, at nodes without mass, ``(m,)``.

        ``budget`` are energies of the groups, ``(g,)``, and ``costs`` those of the nodes for the
        whole gaps, ``(m,)`` [J]. Collective.
        """
        massless = self._equilibrium.nodes
        sums = self._groups.sums(massless, costs)
        part: Floats = np.divide(budget, sums, out=np.ones_like(sums), where=sums > budget)
        return part[self._groups.number_of[massless]]

    def _slid(
        self, held: Sequence[tuple[ContactStep, HeldNodes]], way: Floats
    ) -> tuple[list[ContactHistory], Floats]:
        """Contact of each pair after its nodes have gone a way, ``(n, d)`` [m]. Collective.

        Also returns what friction dissipates in each group on it, ``(g,)`` [J].
        """
        histories, dissipated = [], np.zeros(len(self._groups.nodes))
        for step, some in held:
            history = step.state.history
            rows = some.gradients.reshape(len(some.node), 3, some.dofs.shape[1], 3)
            ways = step.candidates.scatter.forward(in_space(way))[some.dofs]
            opened, *slid = np.einsum("mcki,mki->cm", rows, ways)
            gap, dissipation = history.gap.copy(), history.dissipation.copy()
            gap[some.node] = some.gap + opened
            # In all a step never gets energy from friction.
            lost = (some.traction * np.transpose(slid)).sum(axis=1)
            lost = np.maximum(lost, -np.maximum(dissipation[some.node], 0.0))
            dissipation[some.node] += lost
            histories.append(replace(history, gap=gap, dissipation=dissipation))
            dissipated += self._groups.sums(step.state.nodes.nodes[some.node], lost)
        return histories, dissipated


def _payment(vibration: Vibration, recoil: Recoil, wanted: Floats) -> tuple[Floats, Floats, Floats]:
    """Factors of recoil and of vibration by which groups get energy, ``(g,)`` [J]. Local.

    Each of both gives in proportion to the energy that it has. Also returns what groups get,
    which is what is wanted, or as much of it as they can give or take.
    """
    whole = vibration.energy + recoil.energy
    share = np.divide(recoil.energy, whole, out=np.zeros_like(whole), where=whole > 0)
    recoils, by_recoil = recoil.factors(share * wanted)
    factors, by_vibration = vibration.factors(wanted - by_recoil)
    return recoils, factors, by_recoil + by_vibration


def _held(step: ContactStep, some: HeldNodes) -> Holds:
    """Gaps that nodes close, ``(m,)``, and slips of those that stick. Local."""
    sticks = some.sticks
    gradient, *along = some.gradients.transpose(1, 0, 2)
    slides = ~sticks & (some.force > 0)
    ratio = np.divide(
        some.traction,
        -some.force[:, None],
        out=np.zeros_like(some.traction),
        where=slides[:, None],
    )
    force = gradient + np.einsum("ma,ami->mi", ratio, np.array(along))
    stuck = [rows[sticks] for rows in along]
    return Holds(
        step.candidates.scatter,
        np.concatenate([some.dofs, some.dofs[sticks], some.dofs[sticks]]),
        np.concatenate([gradient, *stuck]),
        np.concatenate([force, *stuck]),
        np.concatenate([-some.gap, np.zeros(2 * np.count_nonzero(sticks))]),
    )
