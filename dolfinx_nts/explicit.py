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

from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinx_nts.archive import Archive
from dolfinx_nts.bodies import Body
from dolfinx_nts.contact import ContactPair
from dolfinx_nts.contact_history import ContactWork
from dolfinx_nts.explicit_bulk import ExplicitBulk, Forces
from dolfinx_nts.loads import Load
from dolfinx_nts.materials import Hyperelastic, right_cauchy_green
from dolfinx_nts.newton import ConvergenceError
from dolfinx_nts.report import StepReport
from dolfinx_nts.springs import ContactSprings
from dolfinx_nts.stable_step import Cells, Damping, largest_step
from dolfinx_nts.stepper import Stepper
from dolfinx_nts.supports import Supports

__all__ = ["CentralDifference"]

Floats = npt.NDArray[np.float64]

# Parts of the estimate: the default step, and the longest step where springs
# are to be chosen, which need what is left.
_DEFAULT, _WITH_SPRINGS = 0.7, 0.9
_WATCH = 50  # steps after which sizes of cells and energy are looked at
_GROWTH = 0.25  # of the energy that is taken for an instability
_ROUNDING = 1e-20  # energy relative to that of one cell a step


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
        V = self.u.function_space
        self._supports = Supports(V, bcs)
        self._supports.check()
        self._bulk = ExplicitBulk(bodies, self.u, loads)
        self.mass, n = self._bulk.mass, self._num_owned
        self._inverse_mass: Floats = 1 / self.mass[:, None]
        self._total_mass = float(V.mesh.comm.allreduce(self.mass.sum()))
        self._supported = bool(bcs)
        self._given = np.zeros((n, 3), dtype=bool)
        self._given.ravel()[self._supports.fixed] = True
        self._springs = [ContactSprings(pair, self.mass) for pair in pairs]
        self._cells, self._damping_law = Cells(bodies), Damping.of(bodies)
        self._smallest = 0.0  # cell [m]
        self._settle(dt)
        self._old, self._new = Forces.none(n), Forces.none(n)
        self._known = False  # whether `_old` belongs to the present state
        # Since the state was set: energy then, work since, and its turnover.
        self._energy = self._worked = self._turnover = 0.0

    def exchange(self, archive: Archive) -> None:
        """Exchange the state, also the forces."""
        super().exchange(archive)
        old = self._old
        totals = archive.same(
            "watch",
            np.array(
                [self._energy, self._worked, self._turnover, self.stable_step, self._smallest]
            ),
        )
        self._energy, self._worked, self._turnover, self.stable_step, self._smallest = (
            float(value) for value in totals
        )
        self._known = archive.same("forces_are_known", self._known)
        if not self._known:
            if archive.giving:
                self._state_was_set()
            return
        for name in ("load", "damping", "total", "acceleration"):
            setattr(old, name, archive.nodal(f"force/{name}", self.node_ids, getattr(old, name)))
        states = old.springs or (None,) * len(self._springs)
        old.springs = tuple(
            springs.exchange(archive, f"springs_{number}", state, self.x)
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

    def _settle(self, dt: float | None) -> None:
        """Choose the step and the penalties that are open."""
        damping = self._damping_law
        given = self._squared_frequency()
        estimate, default = largest_step(given, damping), _DEFAULT
        if any(springs.is_open for springs in self._springs):
            estimate *= _WITH_SPRINGS
            default /= _WITH_SPRINGS
        self.stable_step = estimate
        self.dt = default * estimate if dt is None else dt
        for springs in self._springs:
            springs.settle((damping.highest(self.dt) - given) / 2)
        self.stable_step = largest_step(self._squared_frequency(), damping)

    def _squared_frequency(self) -> float:
        """Highest squared frequency of the present state [1/s^2]. Collective."""
        contact = max((springs.squared_frequency for springs in self._springs), default=0.0)
        bulk, self._smallest = self._cells.limits(self.x)
        return bulk + contact

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

    def _evaluate(self, forces: Forces, x_n: Floats, step: float) -> None:
        """Forces of the present u. Collective."""
        with self.timings.phase("assembly"):
            self._bulk.evaluate(forces)
        with self.timings.phase("contact"):
            x = self.x
            forces.springs = tuple(springs.evaluate(x_n, x, step) for springs in self._springs)
            for state in forces.springs:
                state.add_to(forces.total)
        np.multiply(self._inverse_mass, forces.total, out=forces.acceleration)
        if self._supported:
            forces.acceleration[self._given] = 0

    def _start(self) -> None:
        """Forces of a state that was set."""
        for load in self.loads:
            load.update(self.t)
        self._bulk.rate.x.array[:] = self.v.x.array
        self._evaluate(self._old, self.x, 0.0)
        for load in self.loads:
            load.update(self.t + self.dt)
        for pair, state in zip(self.pairs, self._old.springs, strict=True):
            pair.history = state.history
        v = self.v.x.array.reshape(-1, 3)[: self._num_owned]
        self._energy, self._worked, self._turnover = self._total_energy(v, self._old), 0.0, 0.0
        self._watch(v, self._old)
        self._known = True

    def _step(self) -> StepReport:
        """Move, evaluate the forces there, and complete the velocity."""
        if not self._known:
            self._start()
        dt, n, comm = self.dt, self._num_owned, self.u.function_space.mesh.comm
        old, new, given = self._old, self._new, self._given
        u_n, u, v, rate = (
            f.x.array.reshape(-1, 3)[:n] for f in (self.u_n, self.u, self.v, self._bulk.rate)
        )
        np.multiply(dt / 2, old.acceleration, out=rate)
        rate += v
        u += dt * rate
        if self._supported:
            self.u.x.array[:] = self._supports.applied(self.u.x.array)
            rate[given] = (u - u_n)[given] / dt
        self.u.x.scatter_forward()
        if self._bulk.damping:
            self._bulk.rate.x.scatter_forward()
        du = u - u_n
        moved = comm.allreduce(np.sqrt(3) * np.abs(du).max(initial=0.0), op=MPI.MAX)
        if not moved <= self._smallest:
            self._refuse(f"a node would move by {moved:.3g} m, more than the smallest cell")
        self._evaluate(new, self._X + self.u_n.x.array.reshape(-1, 3), moved)
        v_new = dt / 2 * new.acceleration
        v_new += rate

        contact_work = ContactWork()
        for springs, a, b in zip(self._springs, old.springs, new.springs, strict=True):
            contact_work = contact_work + springs.work(a, b, du)
        works = np.zeros(5)
        if self._bulk.loads:
            works[0] = np.vdot(old.load + new.load, du) / 2
        if self._bulk.damping:
            works[1] = np.vdot(old.damping + new.damping, du) / 2
        if self._supported:
            v_new[given] = (2 * rate - v)[given]
            reaction = self.mass[:, None] * (v_new - v) / dt - (old.total + new.total) / 2
            works[2] = reaction[given] @ du[given]
        change = np.vdot(new.total, new.acceleration) - np.vdot(old.total, old.acceleration)
        works[3] = dt**2 / 8 * change
        works[4] = sum(len(state.neighbourhood.size) for state in new.springs)
        load_work, damping_work, support_work, inertia_defect, in_reach = (
            float(work) for work in comm.allreduce(works)
        )
        self._worked += load_work + damping_work + support_work + contact_work.friction
        self._turnover += abs(load_work) + abs(support_work)
        if (self.step + 1) % _WATCH == 0:
            self._watch(v_new, new)
        v[:] = v_new
        self.v.x.scatter_forward()
        self.inertia_defect = inertia_defect
        for pair, state in zip(self.pairs, new.springs, strict=True):
            pair.history = state.history
        self._old, self._new = new, old
        return StepReport(
            step=self.step + 1,
            t=self.t + dt,
            dt=dt,
            newton_iterations=0,
            active_set_changes=0,
            residual_norms=(),
            num_active=sum(state.num_active for state in new.springs),
            num_segments=int(in_reach),
            num_resting=0,
            contact_work=contact_work,
            load_work=load_work,
            support_work=support_work,
            damping_work=damping_work,
            solver_work=0.0,
        )

    def _total_energy(self, v: Floats, forces: Forces) -> float:
        """Kinetic, strain and contact energy of the present u [J]. Collective."""
        energy = np.vdot(self.mass, np.einsum("ni,ni->n", v, v)) / 2
        energy += self._bulk.strain_energy()
        energy += sum(state.history.energy.sum() for state in forces.springs)
        return float(self.u.function_space.mesh.comm.allreduce(energy))

    def _watch(self, v: Floats, forces: Forces) -> None:
        """Refuse the step if it is too long for the cells, or energy grows."""
        self.stable_step = largest_step(self._squared_frequency(), self._damping_law)
        if self.dt > self.stable_step:
            self._refuse("cells have become too small")
        grown = self._total_energy(v, forces) - self._energy - self._worked
        # Round-off of a body at rest is no growth.
        whole = self._total_mass * (self._smallest / self.dt) ** 2
        if not grown <= _GROWTH * (self._energy + self._turnover) + _ROUNDING * whole:
            self._refuse(f"the energy has grown by {grown:.3g} J")

    def _refuse(self, reason: str) -> None:
        """Return to the last accepted state and raise on all ranks."""
        self.u.x.array[:] = self.u_n.x.array
        self._state_was_set()
        stable = largest_step(self._squared_frequency(), self._damping_law)
        raise ConvergenceError(
            f"step {self.step + 1} of {self.dt:g} s from t = {self.t:g} is not stable: {reason}; "
            f"the state is that of the last accepted step, the estimate of its largest stable "
            f"step is {stable:.4g} s: a smaller dt may help",
            [],
        )
