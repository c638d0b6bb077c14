r"""Impact that is resolved in time: nodes that touch have no mass.

Their mass acts at nodes below them, see `redistributed_mass`. After each step

* they find their static equilibrium, while all others stay where they are; gaps at which they
  were caught are closed as far as this costs little energy, and otherwise held; nodes that stick
  keep their place, and those that slide go on with the friction of the new reactions,
* the strain energy that this takes or gives, dV, comes from the vibration of the body: with the
  velocity v = v_rigid + w, where w is orthogonal to rigid motions with regard to the mass, v
  becomes v + s w. This changes neither linear nor angular momentum, and s is such that the total
  energy is what it was before, but for what sliding dissipates.
"""

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.held_nodes import HeldNodes
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.fem.components import dimension, in_space, possible_motions
from dolfinx_nts.integrators.implicit_forms import StepForms
from dolfinx_nts.integrators.inertia import Inertia
from dolfinx_nts.integrators.rates import MidpointRates
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.integrators.vibration import VibrationAnalysis
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.extrapolation import extrapolate, group_of_nodes
from dolfinx_nts.model.inverted_cells import VolumeRatio
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.solvers.held_gaps import Holds
from dolfinx_nts.solvers.redistributed_mass import (
    RedistributedBulk,
    RedistributedMass,
    RedistributedTangent,
)
from dolfinx_nts.solvers.surface_equilibrium import SurfaceEquilibrium
from dolfinx_nts.solvers.surface_forces import SurfaceForces

__all__ = ["ResolvedImpact"]

_logger = logging.getLogger("dolfinx_nts")

# Part of the energy of vibration that closing gaps may cost in a step [-], and that the
# equilibrium may cost in all.
_CLOSING, _MOST_SPENT = 0.05, 0.5
# Cells that waves cross in a step [-] above which a step does not resolve them.
_RESOLVED = 1.0


class _Costs(NamedTuple):
    """What it costs to close the gaps of held nodes, of all pairs.

    Attributes:
        energy: About the energy for each, shape ``(m,)`` [J].
        group: Group of bodies of each, shape ``(m,)``.
    """

    energy: Floats
    group: Ints


class ResolvedImpact(Inertia):
    """Mass of the bodies without that of some nodes, and their equilibrium, see `Inertia`.

    Args:
        bodies: The bodies.
        rates: How velocities follow from displacements.
        scheme: The scheme.
        bcs: Dirichlet conditions.
        loads: Virtual work of the loads.
        massless: Owned nodes without mass, sorted.

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
    ) -> None:
        """Compile the forms, and give the mass to the nodes below."""
        self._rates, u = rates, rates.u
        self._mass = mass = RedistributedMass(bodies, extrapolate(bodies, massless))
        forms = StepForms(bodies, rates, scheme, inertia=False)
        residual = forms.residual()

        def factor() -> float:
            return 2 / float(rates.dt.value) ** 2

        acceleration = rates.mean_acceleration
        self.bulk = RedistributedBulk(residual, u, bcs, loads, mass, acceleration, factor)
        self.tangent = RedistributedTangent(
            *(residual, u, bcs, loads, forms.nearby_tangent(), [body.nodes for body in bodies]),
            *(mass, rates.dt, factor),
        )
        self._stiffness = self._undeformed_stiffness(scheme.stress_share)
        fixed = self.bulk.supports.fixed
        surface = SurfaceForces(residual, u, massless, fixed)
        self._equilibrium = SurfaceEquilibrium(surface, rates.u_n, scheme.stress_share)
        self._volume_ratio = VolumeRatio(u, surface.cells)
        V = u.function_space
        self._comm: MPI.Comm = V.mesh.comm
        n = V.dofmap.index_map.size_local
        self._X = V.tabulate_dof_coordinates()[:n, : dimension(V)]
        group = group_of_nodes(bodies)[:n]
        numbers = np.unique(joined(self._comm, group[massless]))
        self._groups = [np.flatnonzero(group == number).astype(np.int32) for number in numbers]
        self._group_of = np.searchsorted(numbers, group)
        possible = possible_motions(V)
        self._vibrations = VibrationAnalysis(
            self._comm, mass, self._groups, fixed, self._X.shape, possible
        )
        self._owed: Floats = np.zeros(len(numbers))
        self._untold_speed = self._cells_per_second(lumped_mass(bodies))

    def _undeformed_stiffness(self, share: float) -> Floats:
        """Mean stiffness of statics at the owned nodes, where they are free, ``(n,)`` [N/m].

        That of the last matrix would depend on how linear systems were solved.
        """
        self.tangent.assemble_nearby()
        diagonal = self.tangent.rows.diagonal() / share
        self.tangent.forget()
        free: Floats = np.ones(diagonal.shape)
        free.ravel()[self.bulk.supports.fixed] = 0
        count = free.sum(axis=1)
        stiffness: Floats = (free * diagonal).sum(axis=1) / np.maximum(count, 1)
        return np.where(count > 0, stiffness, 1.0)

    def _cells_per_second(self, lumped: Floats) -> float:
        """How many cells at the surface a wave crosses in a second. Collective.

        In a chain of springs k between masses m it crosses sqrt(k/m) of them, and the last one,
        which has the mass m/2, has the stiffness k.
        """
        massless = self._equilibrium.nodes
        ratio = self._stiffness[massless] / (2 * lumped[massless])
        return float(np.sqrt(reductions.largest(self._comm, ratio.max(initial=0.0))))

    def _tell(self) -> None:
        """Say once, when there is contact, if a step does not resolve what waves do in a cell."""
        speed = self._untold_speed
        crossings = speed * float(self._rates.dt.value)
        if crossings <= _RESOLVED:
            return
        self._untold_speed = 0.0
        if self._comm.rank == 0:
            _logger.warning(
                "waves cross %.2g cells at the surface in a step, too many for impact 'resolved' "
                "to be of second order in time: harmless, as the energy is exact nevertheless, "
                "but 'elastic' does as well in less time; take dt <= %.2g s to resolve impact",
                crossings,
                _RESOLVED / speed,
            )

    def momentum(self) -> Floats:
        """Multiply the velocity by the mass, see `Inertia.momentum`."""
        v = self._rates.v.x.array[: self.bulk.num_owned]
        return self._mass.times(v.reshape(self._X.shape))

    def carried(self, forces: Floats) -> Floats:
        """Take forces to the nodes below, see `Inertia.carried`."""
        return self._mass.carried(forces)

    def serialize(self, archive: Archive) -> None:
        """Serialize the energy that is owed, see `Inertia.serialize`."""
        self._owed = archive.same("owed_to_vibration", self._owed)

    def accept(self, steps: Sequence[ContactStep]) -> tuple[float, ContactWork]:
        """Set the velocity, then find the equilibrium and pay for it, see `Inertia.accept`."""
        rates, massless = self._rates, self._equilibrium.nodes
        defect, n = rates.accept(), self.bulk.num_owned
        u, v = (f.x.array[:n].reshape(self._X.shape) for f in (rates.u, rates.v))
        # Nodes without mass have no part in these.
        vibration = self._vibrations.of(self._X + u, v)
        strain, dissipation = self._equilibrate(steps, vibration.energy)
        wanted = self._owed - strain - dissipation
        factors, refund = vibration.factors(wanted)
        self._owed = wanted - refund
        for g, factor in zip(self._groups, factors, strict=True):
            v[g] += factor * vibration.w[g]
        mean_velocity = rates.mean_velocity.x.array
        mean_velocity[:] = (rates.u.x.array - rates.u_n.x.array) / float(rates.dt.value)
        v[massless] = mean_velocity[:n].reshape(v.shape)[massless]
        rates.v.x.scatter_forward()
        energies = strain, -dissipation, refund + dissipation
        spent, friction, back = (float(part.sum()) for part in energies)
        return defect, ContactWork(equilibrium=spent, friction=friction, refund=back)

    def _equilibrate(self, steps: Sequence[ContactStep], energy: Floats) -> tuple[Floats, Floats]:
        """Move nodes without mass; returns what it costs each group, ``(g,)`` [J].

        That is strain energy, and what friction dissipates. ``energy`` is that of the vibration
        of each group, shape ``(g,)`` [J].
        """
        u = self._rates.u.x
        massless, dx = self._equilibrium.nodes, np.zeros_like(self._X)
        before, group = u.array.copy(), self._group_of[massless]
        held = [(step, HeldNodes.of(step)) for step in steps if is_resolved(step.state.pair)]
        if any(step.num_active for step in steps):
            self._tell()
        closed = self._affordable(self._costs(held), _CLOSING * energy)
        for part in (closed, np.zeros_like(closed)):
            holds, rest = [], part
            for step, some in held:
                mine, rest = np.split(rest, [len(some.node)])
                holds.append(_held(step, some, mine))
            dx[massless] = self._equilibrium.find(holds, self._stiffness[massless])
            u.array[: dx.size] += dx.ravel()
            u.scatter_forward()
            cost = np.zeros(len(self._groups))
            np.add.at(cost, group, self._equilibrium.work(before))
            cost = reductions.total(self._comm, cost)
            if (cost <= _MOST_SPENT * energy).all() and not self._volume_ratio.inverted():
                return cost, self._remember(held, dx)
            u.array[:] = before
        nothing = np.zeros(len(self._groups))
        return nothing, nothing

    def _costs(self, held: Sequence[tuple[ContactStep, HeldNodes]]) -> _Costs:
        """What it costs to close the gaps of held nodes."""
        node = np.concatenate([step.state.nodes.nodes[some.node] for step, some in held])
        gap, force = (
            np.concatenate([getattr(some, name) for _, some in held]) for name in ("gap", "force")
        )
        way = np.abs(gap)
        energy = way * np.where(force > 0, force, self._stiffness[node] * way)
        return _Costs(energy, self._group_of[node])

    def _affordable(self, costs: _Costs, budget: Floats) -> Floats:
        """Parts of the gaps that may be closed, first of the cheapest, ``(m,)``. Collective."""
        part: Floats = np.zeros(len(costs.energy))
        for number, most in enumerate(budget):
            mine = costs.group == number
            energies = np.sort(joined(self._comm, costs.energy[mine]))
            sums = np.concatenate([[0.0], np.cumsum(energies)])
            num_paid = int(np.count_nonzero(sums[1:] <= most))
            rest = sums[-1] - sums[num_paid]
            dearest = energies[num_paid - 1] if num_paid else -1.0
            part[mine] = np.where(
                costs.energy[mine] <= dearest,
                1.0,
                (most - sums[num_paid]) / rest if rest > 0 else 0.0,
            )
        return part

    def _remember(self, held: Sequence[tuple[ContactStep, HeldNodes]], dx: Floats) -> Floats:
        """Let contact know gaps and slips of nodes that have moved.

        Returns what friction dissipates in each group, ``(g,)`` [J]. Collective.
        """
        dissipated = np.zeros(len(self._groups))
        for step, some in held:
            history = step.state.history
            rows = some.gradients.reshape(len(some.node), 3, some.dofs.shape[1], 3)
            ways = step.candidates.scatter.forward(in_space(dx))[some.dofs]
            opened, *slid = np.einsum("mcki,mki->cm", rows, ways)
            gap, dissipation = history.gap.copy(), history.dissipation.copy()
            gap[some.node] = some.gap + opened
            # In all a step never gets energy from friction.
            lost = (some.traction * np.transpose(slid)).sum(axis=1)
            lost = np.maximum(lost, -np.maximum(dissipation[some.node], 0.0))
            dissipation[some.node] += lost
            step.state.accept(replace(history, gap=gap, dissipation=dissipation))
            group = self._group_of[step.state.nodes.nodes[some.node]]
            np.add.at(dissipated, group, lost)
        return reductions.total(self._comm, dissipated)


def _held(step: ContactStep, some: HeldNodes, part: Floats) -> Holds:
    """Gaps that nodes keep or close in part, ``(m,)``, and slips of those that stick. Local."""
    kept = (some.force > 0) | (part > 0)
    sticks = some.sticks & kept
    gradient, *along = some.gradients.transpose(1, 0, 2)
    slides = kept & ~sticks & (some.force > 0)
    ratio = np.divide(
        some.traction,
        -some.force[:, None],
        out=np.zeros_like(some.traction),
        where=slides[:, None],
    )
    force = gradient + np.einsum("ma,ami->mi", ratio, np.array(along))
    stuck = [rows[sticks] for rows in along]
    rows = np.concatenate([gradient[kept], *stuck])
    return Holds(
        step.candidates.scatter,
        np.concatenate([some.dofs[kept], some.dofs[sticks], some.dofs[sticks]]),
        rows,
        np.concatenate([force[kept], *stuck]),
        np.concatenate([-(part * some.gap)[kept], np.zeros(2 * np.count_nonzero(sticks))]),
    )
