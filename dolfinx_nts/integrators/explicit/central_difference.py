r"""Explicit stepper: central differences with lumped mass.

A step has the velocity Verlet form, in which the velocity belongs to the same time as the
positions:

.. math:: v_{n+1/2} = v_n + \frac{\Delta t}{2} a_n, \quad
   u_{n+1} = u_n + \Delta t\, v_{n+1/2}, \quad
   v_{n+1} = v_{n+1/2} + \frac{\Delta t}{2} a_{n+1}, \quad
   M a = f(u).

The kinetic energy changes in a step by the work of the mean of the forces at both ends plus
:math:`\Delta t^2/8\, [a \cdot M a]_n^{n+1}`, which is the `State.inertia_defect`.
"""

import logging
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_nts import compat
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arguments import instances
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.explicit.all_springs import AllSprings
from dolfinx_nts.contact.explicit.compliance import NodalProperties
from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.contact.method import EDGES, NODES, has_patches
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.vertices import add_vertices
from dolfinx_nts.fem.components import in_space, nodal
from dolfinx_nts.fem.node_numbering import geometry_unchanged
from dolfinx_nts.integrators.explicit.explicit_forms import ExplicitBulk, PresentForces
from dolfinx_nts.integrators.explicit.leapfrog import Drift
from dolfinx_nts.integrators.explicit.stability import Stability
from dolfinx_nts.integrators.rates import NoRates
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.rigid import rigid_leapfrog
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.integrators.step_failure import SHORTER_STEP_HELPS
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.layers import nodal_densities, nodal_moduli
from dolfinx_nts.model.loads.load import Load
from dolfinx_nts.model.reaction import Reaction
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.collective_calls import meet
from dolfinx_nts.solvers.newton_report import ConvergenceError

__all__ = ["CentralDifference", "check_scope"]

_logger = logging.getLogger("dolfinx_nts")

# Number of steps between checks of energy and cell sizes [-]. Larger (twice): cells can collapse
# between checks; smaller: checks take more time.
_CHECK_INTERVAL = 50
# Relative margin to the stable step in controlled runs [-], as they lengthen steps by up to
# `ROUND_OFF` to end at a given time.
_MARGIN = 1e-5


def check_scope(bodies: Sequence[Body], pairs: Sequence[ContactPair]) -> None:
    """Check that explicit steps support all bodies and pairs. Local.

    Raises:
        TypeError: An argument has the wrong type.
        ValueError: A contact method, smooth segments or a material needs an implicit stepper.
    """
    methods = {pair.method for pair in pairs}
    if others := sorted(methods - {NODES, EDGES}):
        raise _out_of_scope(
            f"pairs of method {NODES!r} or {EDGES!r}", " and ".join(map(repr, others))
        )
    if smooth := [pair.segments.name for pair in pairs if has_patches(pair)]:
        raise _out_of_scope("segments without smooth=True", " and ".join(smooth))
    if names := [body.name for body in instances(Body, bodies) if body.material.remembers]:
        raise _out_of_scope("materials without branches or plasticity", str(names))


def _out_of_scope(expected: str, given: str) -> ValueError:
    return ValueError(
        f"expected {expected} with CentralDifference, given {given}, which the implicit steppers "
        "support"
    )


def _mean_stress(material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
    stresses = (G * material.stress(right_cauchy_green(G), **parameters) for G in (F_n, F))
    return sum(stresses) / 2


class CentralDifference(Stepper):
    """Advances bodies by explicit central differences (velocity Verlet) with lumped mass.

    It conserves linear and angular momentum to round-off. The energy error is bounded and of
    second order in the step. A step has one assembly of the internal forces and no linear
    system, but must be shorter than ``stable_step``, about the time in which a wave crosses the
    smallest cell. Contact is enforced by `Penalty`, friction by tangential springs. Damping forces
    use the velocity half a step earlier, and are accurate to first order. Rigid bodies have their
    exact mass and inertia and conserve both momenta to round-off (Hairer, Lubich and Wanner 2006,
    section VII.1.4). If all bodies are rigid, only springs limit the step. Further attributes: see
    `EnergyMomentum`. Collective, as are all its methods.

    Args:
        bodies: Bodies of one space, which fill the mesh.
        pairs: Contact pairs of these bodies, all with `Penalty`, which is the default, and
            node-to-segment or edge-to-edge contact. Springs without a given stiffness are 3/5 as
            stiff as the cells on both sides in series, or softer where ``dt`` is close to the
            stable step. Between rigid bodies they are as stiff as ``dt`` allows.
        dt: Length of a step [s]; None for 0.7 of the estimate.
        bcs: See `EnergyMomentum`.
        loads: Loads on the bodies.
        update: See `EnergyMomentum`.

    Attributes:
        stable_step: Estimate of the largest stable step [s], from the sizes of the cells, the
            materials at C = 1, damping and given penalties. It does not depend on ``dt``, and is
            updated every 50 steps. Default penalties that are limited by the first ``dt`` hardly
            allow longer steps later.
        mass: Lumped mass of the owned nodes, shape ``(n,)`` [kg].

    Raises:
        TypeError: An argument has the wrong type, or a subclass has another ``scheme``.
        ValueError: As in `EnergyMomentum`; or ``dt`` is above the estimate, a pair is enforced
            by multipliers, or a material has viscous branches or plasticity.

    Example:
        >>> pair = nts.ContactPair(bottom, top)
        >>> stepper = nts.CentralDifference(bodies, [pair])
        >>> 0.5 * stepper.stable_step < stepper.dt < stepper.stable_step
        True
        >>> stepper.advance().newton_iterations
        0
    """

    # With lumped mass the velocity update needs no forms.
    scheme = Scheme(
        contact="static", stress=_mean_stress, rates=NoRates, load_point=1.0, loads_at="end"
    )
    # A copy of the state would take half the time of a step.
    _halves_equal_steps = False
    stable_step: float = math.inf

    @geometry_unchanged()
    @compat.quicker_ffcx()  # UFL derivatives query cells as often as FFCx does.
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
        if self.scheme is not CentralDifference.scheme:
            raise TypeError(
                f"expected no attribute scheme of {type(self).__name__}, which "
                "CentralDifference ignores: derive from ImplicitStepper for a scheme of your own"
            )
        pairs = tuple(map(self._with_defaults, instances(ContactPair, pairs)))
        check_scope(bodies, pairs)
        first = 1.0 if dt is None else dt
        super().__init__(bodies, pairs, dt=first, bcs=bcs, loads=loads, update=update)
        self.supports.warn_of_empty()
        self.supports.check()
        self._bulk = ExplicitBulk(bodies, self.u, loads)
        self.mass = self._bulk.mass
        self._rigid, resisting = rigid_leapfrog(bodies, self.v, self.mass, self.supports)
        # Vectors whose ghost values the forces need.
        moving = (self.u, self._bulk.rate) if self._bulk.damping else (self.u,)
        ghosts = [f.x for f in moving] if self._comm.size > 1 else []
        functions = self.u_n, self.u, self.v, self._bulk.rate
        self._drift = Drift(functions, self.supports, self._rigid, ghosts)
        mobility: Floats = np.where(self._drift.is_prescribed, 0.0, 1 / self.mass[:, None])
        mobility[self._rigid.nodes] = 0.0
        vertices = add_vertices(self.contacts, (), is_static=False)
        n, is_rigid = len(self.mass), np.zeros(len(self.mass), dtype=bool)
        is_rigid[self._rigid.nodes] = True
        cells = nodal_moduli(bodies, n), nodal_densities(bodies, n)
        at = NodalProperties(resisting, is_rigid, *cells)
        self._springs = AllSprings(self.contacts, vertices, at)
        mass = float(reductions.total(self._comm, self.mass.sum()))
        self._stability = Stability(bodies, self._springs.pairs, mass)
        self.stable_step, default = self._stability.longest_steps(self.x)
        if dt is None and math.isinf(default):
            raise ValueError(
                "expected a step dt if all bodies are rigid, given None: no cell size determines it"
            )
        self.dt = default if dt is None else dt
        self._stability.choose_penalties(self.x, self.dt)
        self._forces = PresentForces(self._bulk, self._springs, mobility)
        self._positions, self._nodal_u = np.empty_like(self._X), nodal(self.u)

    def _with_defaults(self, pair: ContactPair) -> ContactPair:
        return pair.with_defaults(Penalty(), nodal=True)

    def serialize(self, archive: Archive) -> None:
        """Serialize the state and the forces, which are then not evaluated again."""
        super().serialize(archive)
        if archive.restores:
            self.cell_energies = None
            self._begin(self.t, self.t)
            self._rigid.restored()
        self._stability.serialize(archive)
        self.stable_step = archive.same("stable_step", self.stable_step)
        self._forces.serialize(archive, self.node_ids, self.x)
        if archive.restores and not self._forces.known:
            self._state_was_set()

    def nodal_momentum(self) -> Floats:
        """Momentum of the owned nodes, with lumped mass, shape ``(n, 3)`` [kg m/s]."""
        momentum: Floats = self.mass[:, None] * self._drift.arrays[2]
        return momentum + self._rigid.more_momentum() if self._rigid.exists else momentum

    def known_gaps(self) -> list[Floats] | None:
        known = self._forces.known
        return [contact.history.gap for contact in self.contacts] if known else None

    def _work_of_solvers(self) -> tuple[int, None]:
        return self._bulk.internal.num_assemblies, None

    def _longest_step(self) -> float:
        return self._stability.limit / (1 + _MARGIN)

    def _check_dt(self, dt: float) -> None:
        super()._check_dt(dt)
        # The constructor sets the first step before the estimate is known.
        longest = self._stability.limit if hasattr(self, "_stability") else math.inf
        if dt > longest:
            softer = "; a new stepper with this dt has softer default penalties"
            raise ValueError(
                f"expected a step dt <= {longest:.4g} s, the estimate of the largest stable one, "
                f"given {dt}{softer if dt <= self.stable_step else ''}"
            )

    def _state_was_set(self) -> None:
        self._forces.known, self.cell_energies = False, None
        self.watch.forget()
        self._springs.forget()

    def _check_state(self) -> None:
        # If forces are known, `_move` already detects values that are not finite.
        if not self._forces.known:
            super()._check_state()
            _, u, v, *_ = self._drift.arrays
            self._rigid.check(u, v)

    def _set(self, function: fem.Function, body: Body, value: Any) -> None:
        super()._set(function, body, value)
        self._rigid.mark_set(body, function.name)

    def _begin(self, t_n: float, t: float) -> None:
        super()._begin(t_n, t)
        self._rigid.guides.prescribe(t_n, t)

    def _prescribed(self) -> list[tuple[str, Any]]:
        return self._rigid.guides.by_name()

    def _turns(self) -> list[tuple[str, float]]:
        return super()._turns() + self._rigid.guides.turns()

    def _evaluate(self, bounds: Sequence[float]) -> None:
        """Evaluate the forces at the current u; for ``bounds`` see `AllSprings.evaluate`."""
        with self.timings.phase("assembly"):
            self._bulk.evaluate()
        with self.timings.phase("contact"):
            x = np.add(self._X, in_space(self._nodal_u), out=self._positions)
            x_n = self._X + in_space(nodal(self.u_n)) if self._springs.has_friction else x
            self._springs.evaluate(x_n, x, bounds, self._bulk.total, self.dt)

    def _start(self) -> None:
        """Evaluate the forces of a state that the user set."""
        self._load_at(0.0)
        self._bulk.rate.x.array[:] = self.v.x.array
        self._begin(self.t, self.t)
        self._evaluate([0.0] * len(self._springs.pairs))
        self._begin(self.t, self.t + self.dt)
        self._load_at(self.scheme.load_point)
        self._forces.begin()
        v = self._drift.arrays[2]
        self._stability.start(self._total_energy(v))
        self._check_stability(v)
        self._forces.known = True

    def _step(self) -> StepReport:
        """Move, evaluate the forces at the new positions, and complete the velocity."""
        if not self._forces.known:
            self._start()
        dt, bulk, forces, rigid = self.dt, self._bulk, self._forces, self._rigid
        given = self._drift.is_prescribed
        _, _, v, rate, du = self._drift.arrays
        moved, bound = self._move()
        bounds = [bound] * len(self._springs.pairs)
        if self._springs.obstacles_move:
            bounds = self._springs.bounds(self.x, moved)
        skips_check = self.watch.skips_check(bound)
        # `Stepper.advance` needs the increment for the overlap check.
        self._increment = 0.0 if skips_check else moved
        if not skips_check:
            with self.timings.phase("passage"):
                self._check_passage(bound, bounds)
        strained, at_start = forces.strain_energy, bulk.work(du)
        held = bulk.total[given] if self.supports.exist else np.empty(0)
        self._evaluate(bounds)
        works = [a + b for a, b in zip(at_start, bulk.work(du), strict=True)]
        power = forces.kick(dt, rate)
        gained = rigid.kick(bulk.total, rate) if rigid.exists else 0.0
        reactions: tuple[Reaction, ...] = ()
        if self.supports.exist:
            rate[given] = (2 * rate - v)[given]
            inertia = (self.mass[:, None] * (rate - v))[given] / dt
            force = inertia - (held + bulk.total[given]) / 2
            reactions = self.supports.reactions(force, self.x, du[given])
        reactions += rigid.reactions()
        watch = self.watch.springs
        contact = self._springs.counted(self._positions[: len(du)], du, watch.watches)
        defect = dt**2 / 8 * power
        others = bulk.have_materials_changed(), self._springs.stored, defect, bulk.strain_energy
        sums = reductions.total(self._comm, [*contact, *others, *works])
        num_lost, num_deep, num_segments, num_active, *by_cause = sums[: len(contact)]
        changed, stored, defect, forces.strain_energy, internal, damping, *loads = sums[
            len(contact) :
        ]
        load, support = sum(loads), sum(reaction.work for reaction in reactions)
        if num_lost:
            self._refuse(self._springs.lost())
        contact_work = ContactWork(*by_cause)
        driven = load, support, contact_work.obstacles
        energies = {"stored": stored, "strain": forces.strain_energy}
        self._stability.count(driven, damping, contact_work, **energies, changes=bool(changed))
        if (self.step + 1) % _CHECK_INTERVAL == 0:
            self._check_stability(rate)
        v[:] = rate
        if self._comm.size > 1:
            self.v.x.scatter_forward()
        self.inertia_defect = defect + gained
        # A change of material data, such as swelling, changes the energy: the ledger lists it as
        # unaccounted, as in implicit steps.
        error = 0.0 if changed else forces.strain_energy - strained + internal
        self.cell_energies = forces.strain_energy, error
        self._springs.accept()
        if num_deep:
            watch.check()
        return StepReport(
            step=self.step + 1,
            t=self.t + dt,
            dt=dt,
            newton_iterations=0,
            active_set_changes=0,
            residual_norms=(),
            num_active=int(num_active),
            num_segments=int(num_segments),
            num_sleeping=0,
            contact_work=contact_work,
            damping_work=damping,
            solver_work=0.0,
            load_works=tuple(loads),
            reactions=reactions,
        )

    def _move(self) -> tuple[float, float]:
        """Move to the end of the step. Collective.

        Returns:
            Largest displacement increment of a node, and half a bound on the approach of any two
            nodes, or of a node and a fixed point; both the same on all ranks [m].
        """
        forces, about = self._bulk.total, self.watch.velocity
        moved, bound, refusal = self._drift.move(self.dt, self._forces.acceleration, forces, about)
        if refusal:
            self._refuse(refusal)
        if self._comm.size > 1:
            try:
                moved, bound = meet(self._comm, f"motion of {self._next()}", moved, bound)
            except ValueError:
                self._u[:] = self._u_n
                raise
        if not moved <= self._stability.smallest:
            self._u[:] = self._u_n
            super()._check_state()
            self._refuse(f"a node would move by {moved:.3g} m, more than the smallest cell")
        return moved, min(moved, max(bound, moved / 2))

    def _check_passage(self, moved: float, bounds: Sequence[float]) -> None:
        """Raise if nodes or vertices pass through a surface.

        Args:
            moved: Half the bound on the approach of any two nodes [m].
            bounds: Half the bound on the approach of both sides of each pair [m].
        """
        fast = self._springs.fast(bounds)
        if not fast and 2 * moved <= self.watch.vertices.clearance:
            self.watch.vertices.travel(2 * moved)
            return
        x_n, x = (self._X + in_space(nodal(u)) for u in (self.u_n, self.u))
        reasons = (springs.passing(x_n, x, bound, self.dt) for springs, bound in fast)
        reason = next(filter(None, reasons), "") or self.watch.vertices.check(x_n, x, moved)
        if reason:
            self._refuse(reason)
        self.watch.vertices.accept()

    def _total_energy(self, v: Floats) -> float:
        """Kinetic, strain and contact energy at the current u [J]. Collective."""
        energy = np.vdot(self.mass[:, None] * v, v) / 2
        energy += self._springs.stored
        if self._rigid.exists:
            energy += self._rigid.more_energy(self.mass, v)
        return float(reductions.total(self._comm, energy)) + self._forces.strain_energy

    def _check_stability(self, v: Floats) -> None:
        """Raise if springs are too soft, the step is unstable, or the energy has grown."""
        if pushed := self.watch.springs.pushed_through(self.x):
            self._refuse(f"{pushed}, which stiffer springs (eps_N) prevent")
        self.watch.measure_about(v)
        self.stable_step, _ = self._stability.longest_steps(self.x)
        if self.dt > self._stability.limit:
            self._refuse("cells have become too small")
        if (energy := self._stability.exchanged(self.dt)) and self._comm.rank == 0:
            _logger.warning(
                "until t = %g s contact springs have %s an energy of %.3g J by losing or changing "
                "their segments, as at rims, corners and between coarse facets: use finer facets, "
                "or EnergyMomentum, which conserves the energy",
                *(self.t, "given the bodies" if energy > 0 else "lost", abs(energy)),
            )
        if growth := self._stability.growth(self._total_energy(v), self.dt):
            self._refuse(growth)

    def check_overlaps(self) -> None:
        """Log overlaps, and springs that are too soft for the forces of prescribed motions."""
        super().check_overlaps()
        ratio = self._stability.compliance()
        if ratio and self._comm.rank == 0:
            _logger.warning(
                "contact springs held up to %.0f %% of the elastic energy: forces of supports and "
                "obstacles that press bodies together are too small by up to this fraction; finer "
                "cells or stiffer springs, Penalty(eps_N=), reduce it, and EnergyMomentum has "
                "stiffer default springs",
                100 * ratio / (1 + ratio),
            )

    def _refuse(self, reason: str) -> None:
        """Restore the last accepted state, and raise on all ranks."""
        self._u[:] = self._u_n
        self._state_was_set()
        self._stability.longest_steps(self.x)
        raise ConvergenceError(
            f"step {self.step + 1} of {self.dt:g} s from t = {self.t:g} is refused: {reason}; "
            f"the state is that of the last accepted step, the estimate of its largest stable "
            f"step is {self._stability.limit:.4g} s: {SHORTER_STEP_HELPS}",
            [],
        )
