r"""Central differences: explicit steps with lumped mass.

Velocity Verlet form, with the velocity at the same time as the positions,

.. math:: v_{n+1/2} = v_n + \frac{\Delta t}{2} a_n, \quad
   u_{n+1} = u_n + \Delta t\, v_{n+1/2}, \quad
   v_{n+1} = v_{n+1/2} + \frac{\Delta t}{2} a_{n+1}, \quad
   M a = f(u).

The kinetic energy changes in a step by the work of the mean of the forces at
both ends plus :math:`\Delta t^2/8\, [a \cdot M a]_n^{n+1}`, the
`Stepper.inertia_defect`.
"""

import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.explicit.penalty import ContactSprings, SpringForces
from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.integrators.explicit_forms import ExplicitBulk
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.stability import Stability
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.dirichlet import Supports
from dolfinx_nts.model.loads import Load
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.newton import ConvergenceError

__all__ = ["CentralDifference"]


_WATCH = 50  # steps after which sizes of cells and energy are looked at


class CentralDifference(Stepper):
    r"""Explicit central differences (velocity Verlet) with lumped mass.

    Conserves linear and angular momentum to round-off; the energy error is
    of second order in the step and bounded. Contact is by `Penalty` and
    friction by its spring. One assembly of the internal forces and no
    linear system per step, which must be shorter than `stable_step`:
    about the time in which a wave crosses the smallest cell.

    Damping lags half a step behind, which makes it accurate to first order.
    Collective, as all its methods.

    Args:
        bodies: Bodies of one space, which fill the mesh.
        pairs: Contact pairs of these bodies, all with `Penalty`. A penalty
            that is left open gets half of the room that ``dt`` leaves for
            it: the smaller the step, the stiffer.
        dt: Length of a step [s]; None: 0.7 of the estimate.
        bcs: Dirichlet conditions on the displacement at the end of a
            step. Nodes of a moving support should start with its
            velocity: as of any node, it follows from the displacements.
        loads: Loads on the bodies.
        update: Called before each step with the time at its end [s], to
            set the functions and constants in ``bcs`` and ``loads``.

    Attributes:
        stable_step: Estimate of the largest stable step [s], from the
            sizes of the cells, the materials at C = 1, damping and the
            penalty; renewed every 50 steps.
        mass: Lumped mass of the owned nodes, shape ``(n,)`` [kg].

    Raises:
        TypeError: An argument has the wrong type.
        ValueError: As of `EnergyMomentum`; ``dt`` is above the estimate;
            a pair is enforced by multipliers.
    """

    _contact = "static"
    _load_point = 1.0

    def __init__(
        self,
        bodies: Sequence[Body],
        pairs: Sequence[ContactPair] = (),
        *,
        dt: float | None = None,
        bcs: Sequence[fem.DirichletBC] = (),
        loads: Sequence[Load] = (),
        update: Callable[[float], None] | None = None,
    ) -> None:
        """Compile the forms; the bodies are at rest and undeformed."""
        self.stable_step = np.inf
        super().__init__(bodies, pairs, dt=1.0 if dt is None else dt, loads=loads, update=update)
        V, n = self.u.function_space, self._num_owned
        self._comm: MPI.Comm = V.mesh.comm
        self._supports = Supports(V, bcs)
        self._supports.check()
        self._supported = bool(bcs)
        self._given = np.zeros((n, 3), dtype=bool)
        self._given.ravel()[self._supports.fixed] = True
        self._bulk = ExplicitBulk(bodies, self.u, loads)
        self.mass = self._bulk.mass
        self._mobility: Floats = np.where(self._given, 0.0, 1 / self.mass[:, None])
        self._springs = [ContactSprings(contact, self.mass) for contact in self.contacts]
        mass = float(reductions.total(self._comm, self.mass.sum()))
        self._stability = Stability(bodies, self._springs, mass)
        self.stable_step, default = self._stability.room(self.x)
        self.dt = default if dt is None else dt
        self.stable_step = self._stability.choose_penalties(self.x, self.dt)
        # Forces of the present state: what they accelerate, those of springs, and
        # f . a; whether they are known.
        self._acceleration: Floats = np.zeros((n, 3))
        self._contact_forces: tuple[SpringForces, ...] = ()
        self._power, self._known = 0.0, False
        # Values of the owned nodes, and room for more.
        functions = (self.u_n, self.u, self.v, self._bulk.rate)
        self._owned = [f.x.array.reshape(-1, 3)[:n] for f in functions]
        self._displacement = self._u.reshape(-1, 3)
        # What the forces need of other ranks.
        moving = (self.u, self._bulk.rate) if self._bulk.damping else (self.u,)
        self._ghosts = [f.x for f in moving] if self._comm.size > 1 else []
        self._du, self._x = np.empty((n, 3)), np.empty_like(self._X)
        self._rough = any(pair.friction is not None for pair in self.pairs)

    def serialize(self, archive: Archive) -> None:
        """Serialize the state, also the forces."""
        super().serialize(archive)
        self._stability.serialize(archive)
        self.stable_step = archive.same("stable_step", self.stable_step)
        self._known = archive.same("forces_are_known", self._known)
        if not self._known:
            if archive.giving:
                self._state_was_set()
            return
        for number, force in enumerate((self._acceleration, *self._bulk.forces)):
            force[:] = archive.nodal(f"force/{number}", self.node_ids, force)
        # Summed anew, in another order than by the step, its last digit would differ.
        kept = archive.local("power", None if archive.giving else [np.array(self._power)])
        power = np.vdot(self._bulk.total, self._acceleration) if kept is None else kept[0]
        self._power = float(power)
        states = self._contact_forces or (None,) * len(self._springs)
        self._contact_forces = tuple(
            springs.serialize(archive, f"springs_{number}", state, self.x)
            for number, (springs, state) in enumerate(
                zip(self._springs, states, strict=True), start=1
            )
        )

    def first_piola(self, material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
        """Mean of the stresses at both ends, see `Stepper.first_piola`."""
        stresses = (G * material.stress(right_cauchy_green(G), **parameters) for G in (F_n, F))
        return sum(stresses) / 2

    def nodal_momentum(self) -> Floats:
        """Momentum of the owned nodes, shape ``(n, 3)`` [kg m/s]."""
        v = self.v.x.array.reshape(-1, 3)[: self._num_owned]
        momentum: Floats = self.mass[:, None] * v
        return momentum

    def longest_step(self) -> float:
        """Length that a step must not exceed [s]."""
        return self.stable_step / (1 + 1e-5)

    def _check_dt(self, dt: float) -> None:
        super()._check_dt(dt)
        if dt > self.stable_step:
            raise ValueError(
                f"expected a step dt <= {self.stable_step:.4g} s, the estimate of the largest "
                f"stable one, given {dt}"
            )

    def _state_was_set(self) -> None:
        self._known = False
        for springs in self._springs:
            springs.forget()

    def _check_state(self) -> None:
        # Of forces that are known, the first motion tells.
        if not self._known:
            super()._check_state()

    def _evaluate(self, step: float) -> None:
        """Forces of the present u, where no node is farther than a step from the last. Collective.

        Args:
            step: The greatest displacement [m].
        """
        with self.timings.phase("assembly"):
            self._bulk.evaluate()
        with self.timings.phase("contact"):
            x = np.add(self._X, self._displacement, out=self._x)
            x_n = self._X + self._u_n.reshape(-1, 3) if self._rough else x
            self._contact_forces = tuple(s.evaluate(x_n, x, step) for s in self._springs)
            for state in self._contact_forces:
                state.add_to(self._bulk.total)

    def _start(self) -> None:
        """Forces of a state that was set."""
        for load in self.loads:
            load.update(self.t)
        self._bulk.rate.x.array[:] = self.v.x.array
        self._evaluate(0.0)
        for load in self.loads:
            load.update(self.t + self.dt)
        for contact, state in zip(self.contacts, self._contact_forces, strict=True):
            contact.accept(state.history)
        np.multiply(self._mobility, self._bulk.total, out=self._acceleration)
        self._power = float(np.vdot(self._bulk.total, self._acceleration))
        v = self._owned[2]
        self._stability.start(self._total_energy(v))
        self._watch(v)
        self._known = True

    def _step(self) -> StepReport:
        """Move, evaluate the forces there, and complete the velocity."""
        if not self._known:
            self._start()
        dt, bulk, a, du, given = self.dt, self._bulk, self._acceleration, self._du, self._given
        u_n, u, v, rate = self._owned
        moved = _kernels.drift(dt, v, a, rate, u, du)
        if self._supported:
            self._u[:] = self._supports.applied(self._u)
            np.subtract(u, u_n, out=du)
            rate[given] = du[given] / dt
            moved = np.abs(du).max(initial=0.0) if math.isfinite(moved) else moved
        for ghosts in self._ghosts:
            ghosts.scatter_forward()
        # A maximum may pass over NaN.
        moved = math.sqrt(3) * moved if math.isfinite(moved) else math.inf
        moved = reductions.largest(self._comm, moved)
        if not moved <= self._stability.smallest:
            self._u[:] = self._u_n
            super()._check_state()
            self._refuse(f"a node would move by {moved:.3g} m, more than the smallest cell")
        # Work of loads, damping and supports, defect; nodes in reach, active, work of contact.
        sums, before, power = [0.0] * 11, self._contact_forces, self._power
        bulk.add_work(sums, du)
        force = bulk.total[given] if self._supported else np.empty(0)
        self._evaluate(moved)
        bulk.add_work(sums, du)
        self._power = _kernels.kick(dt, self._mobility, bulk.total, a, rate)
        if self._supported:
            rate[given] = (2 * rate - v)[given]
            inertia = (self.mass[:, None] * (rate - v))[given] / dt
            sums[2] = (inertia - (force + bulk.total[given]) / 2) @ du[given]
        sums[3] = dt**2 / 8 * (self._power - power)
        for springs, old, new in zip(self._springs, before, self._contact_forces, strict=True):
            counts = springs.num_segments, len(new.springs.node), *springs.work(old, new, du)
            sums[4:] = map(operator.add, sums[4:], counts)
        sums = reductions.total(self._comm, sums)
        load, damping, support, defect, in_reach, active, *works = sums
        contact_work = ContactWork(*works)
        self._stability.count((load, support), damping + contact_work.friction)
        if (self.step + 1) % _WATCH == 0:
            self._watch(rate)
        v[:] = rate
        if self._ghosts:
            self.v.x.scatter_forward()
        self.inertia_defect = defect
        for contact, state in zip(self.contacts, self._contact_forces, strict=True):
            contact.accept(state.history)
        return StepReport(
            step=self.step + 1,
            t=self.t + dt,
            dt=dt,
            newton_iterations=0,
            active_set_changes=0,
            residual_norms=(),
            num_active=int(active),
            num_segments=int(in_reach),
            num_sleeping=0,
            contact_work=contact_work,
            load_work=load,
            support_work=support,
            damping_work=damping,
            solver_work=0.0,
        )

    def _total_energy(self, v: Floats) -> float:
        """Kinetic, strain and contact energy of the present u [J]. Collective."""
        energy = np.vdot(self.mass[:, None] * v, v) / 2
        energy += self._bulk.strain_energy()
        energy += sum(state.stored for state in self._contact_forces)
        return float(reductions.total(self._comm, energy))

    def _watch(self, v: Floats) -> None:
        """Refuse the step if it is too long for the cells, or energy grows."""
        self.stable_step = self._stability.longest_step(self.x)
        if self.dt > self.stable_step:
            self._refuse("cells have become too small")
        if growth := self._stability.growth(self._total_energy(v), self.dt):
            self._refuse(growth)

    def _refuse(self, reason: str) -> None:
        """Return to the last accepted state and raise on all ranks."""
        self._u[:] = self._u_n
        self._state_was_set()
        stable = self._stability.longest_step(self.x)
        raise ConvergenceError(
            f"step {self.step + 1} of {self.dt:g} s from t = {self.t:g} is not stable: {reason}; "
            f"the state is that of the last accepted step, the estimate of its largest stable "
            f"step is {stable:.4g} s: a smaller dt may help",
            [],
        )
