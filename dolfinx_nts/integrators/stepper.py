"""Steppers, which own the state of bodies and their contact and advance it in time.

This module has what all of them share: checks, the order of things in a step, and the public
interface. How a step is solved is up to `ImplicitStepper` and `CentralDifference`.
"""

import logging
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arguments import as_call, check_call, instances
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.declaration import SetOnce
from dolfinx_nts.common.timing import Timings
from dolfinx_nts.contact.history import begun_anew
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.passes import Passes
from dolfinx_nts.contact.repeated_pairs import check_repeated
from dolfinx_nts.contact.start import check_start, warn_of_bodies_without_pair
from dolfinx_nts.contact.watch import ContactWatch
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.rigid import check_rigid_bodies
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.integrators.script_values import ScriptValues
from dolfinx_nts.integrators.state import current_positions
from dolfinx_nts.integrators.statistics import StepperStatistics
from dolfinx_nts.integrators.time_loop import TimeLoop
from dolfinx_nts.model.bodies import Body, check_bodies, check_member, common_space
from dolfinx_nts.model.dirichlet import Supports
from dolfinx_nts.model.flat_cells import check_volumes
from dolfinx_nts.model.inverted_cells import VolumeRatio
from dolfinx_nts.model.loads import Load
from dolfinx_nts.model.locking import warn_of_locking
from dolfinx_nts.model.rigid_body import guided
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.errors import agreed
from dolfinx_nts.parallel.meeting import meet
from dolfinx_nts.solvers.newton_report import ConvergenceError
from dolfinx_nts.solvers.statistics import SolverStatistics

__all__ = ["Stepper"]

_logger = logging.getLogger("dolfinx_nts")

# Greatest turn of an obstacle in a step [rad]: that of a normal, see `ContactKinematics.turn`.
_MOST_TURN = np.pi / 2


class Stepper(TimeLoop):
    """Base class of all time integrators. Collective, as are all its methods.

    A class sets ``scheme`` before it calls ``__init__``. Arguments, further attributes and
    errors are those of `EnergyMomentum`.

    Attributes:
        scheme: What is evaluated at which state of a step.
        supports: The Dirichlet conditions.
        cell_energies: Strain energy of the present state, and what `Diagnostics.bulk_defect` has
            of the last step without ``inertia_defect``, where the step knows them [J].
        watch: Watches over overlaps, vertices that pass, and soft springs, and tells them.
    """

    scheme: Scheme
    supports: Supports
    cell_energies: tuple[float, float] | None = None
    bodies = SetOnce[tuple[Body, ...]]()
    pairs = SetOnce[tuple[ContactPair, ...]]()

    def __new__(cls, *arguments: Any, **options: Any) -> Any:
        """Name the class, and the arguments it takes, if others are given."""
        hint = ", bodies and pairs first and all others by name (dt=, the length of a step [s])"
        check_call(cls, arguments, options, hint)
        return super().__new__(cls)

    def __init__(
        self,
        bodies: Sequence[Body],
        pairs: Sequence[ContactPair],
        *,
        dt: float,
        loads: Sequence[Load],
        update: Callable[[float], None] | None,
    ) -> None:
        comm = common_space(bodies).mesh.comm
        meet(comm, f"make {type(self).__name__} of {len(bodies)} bodies with dt = {dt!r} s")
        V = check_bodies(bodies)
        warn_of_locking(bodies)
        check_volumes(bodies)
        self.bodies = tuple(bodies)
        self.pairs = instances(ContactPair, pairs)
        self.loads = instances(Load, loads)
        for pair in self.pairs:
            if pair.nodes.V != V:
                raise ValueError("expected bodies and pairs in one function space, given two")
            if pair.is_convective and self.scheme.contact != "midpoint":
                raise ValueError(
                    f"expected Midpoint with convective friction, given {type(self).__name__}"
                )
            if is_resolved(pair) and not self.scheme.resolves_impact:
                raise ValueError(
                    "expected EnergyMomentum with impact 'resolved', given "
                    f"{type(self).__name__}: impact 'elastic' or 'plastic' can do this"
                )
        for load in self.loads:
            if load.V != V:
                raise ValueError("expected bodies and loads in one function space, given two")
        if not (update is None or callable(update)):
            raise TypeError(f"expected a function of the time as update, given {update!r}")
        check_repeated(self.pairs)
        check_rigid_bodies(self.bodies, self.pairs)
        warn_of_bodies_without_pair(self.bodies, self.pairs)
        super().__init__(V, dt, self.bodies, self.scheme)
        passes = Passes(partial(current_positions, self._X, self.u), self._now.item)
        self.contacts = tuple(PairState(pair, passes) for pair in self.pairs)
        self.watch = ContactWatch(self.bodies, self.contacts)
        # Bound on the way of all nodes in the last step [m].
        self._was_displaced, self._way = True, 0.0
        self.timings = Timings()
        self._script = ScriptValues(self.loads, (self.u_n, self.u), update)
        # Positions from which the user has displaced bodies since the last step.
        self._x_before: Floats | None = None
        # Asking a Function for its values takes as long as copying those of a small mesh.
        self._u, self._u_n = self.u.x.array, self.u_n.x.array
        self._volume_ratio = VolumeRatio(self.u)

    @abstractmethod
    def nodal_momentum(self) -> Floats:
        """Momentum of the owned nodes at t, shape ``(n, 3)`` [kg m/s]."""

    def carried(self, forces: Floats) -> Floats:
        """Take forces at the owned nodes, ``(n, 3)`` [N], to those that carry mass."""
        return forces

    @abstractmethod
    def _step(self) -> StepReport:
        """Solve a step from u_n, v to u, v, and accept the contact at its end."""

    @property
    def statistics(self) -> StepperStatistics:
        """Counts of the work that has been done so far. Local."""
        return StepperStatistics(
            tuple(map(str, self.contacts)),
            tuple(contact.search.num_searches for contact in self.contacts),
            *self._work_of_solvers(),
        )

    @abstractmethod
    def _work_of_solvers(self) -> tuple[int, SolverStatistics | None]:
        """Number of evaluations of internal forces, and the linear solver's work."""

    def __repr__(self) -> str:
        """Time, number of steps, and what is advanced, in one line. Local."""
        counts = {name: len(getattr(self, name)) for name in ("bodies", "pairs", "loads")}
        return as_call(self, t=self.t, dt=self.dt, step=self.step, **counts)

    def serialize(self, archive: Archive) -> None:
        """Serialize the state, the contact, and all else on which the next step depends."""
        super().serialize(archive)
        for number, contact in enumerate(self.contacts, start=1):
            contact.serialize(archive, f"pair_{number}")
            contact.search.serialize(archive, f"pair_{number}/search")
        self.watch.serialize(archive)
        # What a run has led to is no start, however deep bodies are in each other.
        self._was_displaced &= not archive.giving

    def adopt(
        self,
        archive: Archive,
        contacts: Mapping[int, str],
        *,
        same_scheme: bool,
        same_bodies: bool,
    ) -> None:
        """Take over time, motion, memory and contact of another scene on the same mesh.

        Args:
            archive: Gives what `serialize` of the other stepper has stored.
            contacts: Name of the contact in the archive by the number of a pair, from 0.
            same_scheme: Whether the other stepper has the same scheme.
            same_bodies: Whether it has the same bodies and materials. Else the memory begins anew.
        """
        self._serialize_motion(archive)
        for function in (self.u, self.v):
            self._keep_axis(function)
        if same_bodies:
            self.memory.serialize(archive)
        for number, name in contacts.items():
            self.contacts[number].serialize(archive, name)
        self._was_displaced = True
        self._state_was_set()

    def _check_body(self, body: Body) -> None:
        check_member(body, self.bodies)

    def advance(self) -> StepReport:
        """Advance by one step of length ``dt``.

        Returns:
            Report of the step.

        Raises:
            ConvergenceError: The step could not be solved, or an obstacle turns by more than 90
                degrees. The state is as before the call.
            ValueError: The state, a load, a motion or a condition is not finite, conditions
                conflict, or bodies start inside a rigid obstacle, or were put there between
                steps, or ranks have different ``dt``. The state is as before the call.
        """
        self._check_state()
        self._dt.value[...] = self.dt  # which is quicker than to set the value
        if self._was_displaced:
            self._look_at_start()
        moving = [contact for contact in self.contacts if contact.search.may_move]
        anything_moves = moving or guided(self.bodies)
        if self._script.updates or self.loads or anything_moves:
            call = f"update, loads and motions of {self._next()}"
            with agreed(self._comm, call) as values, self._step_of_one_length():
                self._script.update(self.t + self.dt)
                self._load_at(self.scheme.load_point)
                self._begin(self.t, self.t + self.dt)
                values.extend(self._values())
        if anything_moves:
            self._check_turns()
        self.supports.check()
        self._u_n[:] = self._u
        self.memory.begin()
        report = self._step()
        self.t_n, self.t, self.step, self._x_before = self.t, report.t, report.step, None
        way = self._way
        for contact in moving:
            way = contact.search.way(self.x, way)
        if way and self.watch.overlaps.moved_far(way):
            with self.timings.phase("overlap"):
                self.watch.overlaps.follow(self.x, self.t)
        if self._comm.rank == 0:
            numbers = report.step, report.t, report.newton_iterations, report.num_active
            _logger.info("step %d, t = %g: %d iterations, %d active", *numbers)
        return report

    def known_gaps(self) -> list[Floats] | None:
        """Gaps of the nodes of each pair at the present state, if the last step has found them.

        Local. Those of nodes that are not inside may be missing, as NaN.

        Returns:
            Arrays of shape ``(n,)`` [m]; None where they are not known.
        """
        return None

    def look_for_overlaps(self) -> None:
        """Tell, in the log, what overlaps now and was not told before.

        Runs do that by themselves whenever bodies could have come through each other, and at their
        end.
        """
        with self.timings.phase("overlap"):
            self.watch.look(self.x, self.t)

    def _look_at_start(self) -> None:
        """Look at a displacement that was set, before the first step or between steps."""
        if self.step == 0 or self._x_before is not None:
            for contact in self.contacts:
                check_start(contact, self.t, self.x, self._x_before)
        with self.timings.phase("overlap"):
            self.watch.overlaps.start(self.x, self.t)
        self._was_displaced = False

    def _set(self, function: fem.Function, body: Body, value: Any) -> None:
        displaced = function is self.u
        before = self.x if displaced and self.step > 0 and self._x_before is None else None
        super()._set(function, body, value)
        self._was_displaced |= displaced
        if displaced:
            for contact in self.contacts:
                contact.accept(begun_anew(contact.history))
        self._x_before = self._x_before if before is None else before

    def _load_at(self, point: float) -> None:
        """Set the time of the loads to a point of the next step, from 0 to 1. Local."""
        t = self.t + point * self.dt
        self._script.take(t, self.t + self.dt)
        for load in self.loads:
            load.update(t)

    def _begin(self, t_n: float, t: float) -> None:
        """Tell what has a motion of its own that a step goes from t_n to t [s]. Local."""
        for contact in self.contacts:
            contact.search.begin(t_n, t)

    def _values(self) -> list[str]:
        """Values of the script in the step, equal on all ranks, as text. Local."""
        if self._comm.size == 1:
            return []
        frames = [(contact.segments.name, contact.search.frame) for contact in self.contacts]
        given = [
            *self._script.constants(),
            *self.supports.constants(),
            *((name, [*frame.end.centre, frame.angle]) for name, frame in frames if frame.moves),
            *self._prescribed(),
        ]
        return [
            f"{name} = {' '.join(f'{v:.12g}' for v in np.ravel(value))}" for name, value in given
        ]

    def _prescribed(self) -> list[tuple[str, Any]]:
        """Names of guided bodies, and their prescribed motions in the step. Local."""
        return []

    def _turns(self) -> list[tuple[str, float]]:
        """Names of what is moved in the step, and by which angles it turns [rad]. Local."""
        return [(c.segments.name, c.search.frame.angle) for c in self.contacts]

    def _check_turns(self) -> None:
        """Raise if an obstacle or a guide turns too far in the step."""
        for name, angle in self._turns():
            if angle > _MOST_TURN:
                raise ConvergenceError(
                    f"{self._next()} failed: {name} turns by "
                    f"{np.degrees(angle):.3g} degrees in it, more than "
                    f"{np.degrees(_MOST_TURN):.3g}; a smaller dt may help, unless the rotation "
                    "of its motion jumps",
                    [],
                )

    def _next(self) -> str:
        """What all ranks do together now."""
        return f"step {self.step + 1} from t = {self.t!r} s by dt = {self.dt!r} s"

    def _check_state(self) -> None:
        n = dimension(self.u.function_space) * len(self.node_ids)
        bad = [np.count_nonzero(~np.isfinite(u[:n])) for u in (self._u, self.v.x.array)]
        if not any(meet(self._comm, self._next(), *bad)):
            return
        counts = reductions.total(self._comm, bad)
        for name, count in zip(("displacement", "velocity"), counts, strict=True):
            if count:
                raise ValueError(f"expected a finite {name}, given {count} dofs that are not")
