"""Base class of steppers: state of bodies and their contact, and its advance in time.

The base class defines the checks, the order of operations in a step, and the public interface.
`ImplicitStepper` and `CentralDifference` implement the solution of a step.
"""

import logging
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arguments import as_call, check_call, instances
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.declaration import SetOnce
from dolfinx_nts.common.timing import Timings
from dolfinx_nts.contact.checks.repeated_pairs import check_repeated
from dolfinx_nts.contact.checks.round_fits import warn_of_round_fits
from dolfinx_nts.contact.checks.start import check_start, warn_of_bodies_without_pair
from dolfinx_nts.contact.checks.watch import ContactWatch
from dolfinx_nts.contact.history import reloaded
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.passes import Passes
from dolfinx_nts.contact.seams import without_seams
from dolfinx_nts.contact.symmetry_planes import without_symmetry_planes
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.rigid import check_rigid_bodies
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.integrators.state import current_positions
from dolfinx_nts.integrators.statistics import StepperStatistics
from dolfinx_nts.integrators.time_loop import TimeLoop
from dolfinx_nts.model.bodies import Body, body_of_nodes, check_bodies, check_member, common_space
from dolfinx_nts.model.checks.flat_cells import check_volumes
from dolfinx_nts.model.checks.inverted_cells import VolumeRatio
from dolfinx_nts.model.checks.locking import warn_of_locking
from dolfinx_nts.model.dirichlet import Supports
from dolfinx_nts.model.loads.load import Load
from dolfinx_nts.model.rigid_body import guided
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.collective_calls import meet
from dolfinx_nts.parallel.errors import agreed
from dolfinx_nts.solvers.linear.statistics import SolverStatistics
from dolfinx_nts.solvers.newton_report import ConvergenceError

__all__ = ["ScriptValues", "Stepper"]

_logger = logging.getLogger("dolfinx_nts")

# Largest rotation of an obstacle in a step [rad], the same as for a normal, see
# `ContactKinematics.turn`.
_MOST_TURN = np.pi / 2


class ScriptValues:
    """Values set by ``update`` that loads use, evaluated at the time of the loads. Local.

    Dirichlet conditions need values at the end of a step, loads usually in the middle, and both may
    share a Constant. The forms of loads therefore contain copies.

    Args:
        loads: Loads of the stepper.
        state: Displacements at both ends of a step, which are not copied.
        update: Function of the user that sets values for a time [s], or None.

    Attributes:
        copies: Copies by the Constant or Function of the user.
    """

    def __init__(
        self,
        loads: Sequence[Load],
        state: tuple[fem.Function, fem.Function],
        update: Callable[[float], None] | None,
    ) -> None:
        self._state, self._update = state, update
        self.copies: dict[Any, Any] = {}
        self._constants = [(load.name, load.form(*state).constants()) for load in loads]

    @property
    def updates(self) -> bool:
        """Whether an ``update`` function was given."""
        return self._update is not None

    def constants(self) -> list[tuple[str, Any]]:
        """Names of loads, and the current values of their constants."""
        return [(name, c.value) for name, constants in self._constants for c in constants]

    def with_copies(self, load: Load, form: ufl.Form) -> ufl.Form:
        """Replace the user's constants and functions in the form of a load by copies."""
        given = [value for value in load.given(form) if not any(value is s for s in self._state)]
        for value in given:
            if value not in self.copies:
                self.copies[value] = value.copy() if _is_function(value) else _copy(value)
        return ufl.replace(form, {value: self.copies[value] for value in given})

    def update(self, end: float) -> None:
        """Call ``update`` for the time at the end of the step [s], unless `take` will call it."""
        if self._update is not None and not self.copies:
            self._update(end)

    def take(self, t: float, end: float) -> None:
        """Copy the values at the time t of the loads, then set those at the end of the step [s]."""
        if not self.copies:
            return
        if self._update is not None:
            self._update(t)
        for value, copy in self.copies.items():
            if _is_function(value):
                copy.x.array[:] = value.x.array
            else:
                copy.value[...] = value.value
        if self._update is not None:
            self._update(end)


def _is_function(value: Any) -> bool:
    return isinstance(value, fem.Function)


def _copy(constant: fem.Constant) -> fem.Constant:
    return fem.Constant(constant.ufl_domain(), constant.value.copy())


class Stepper(TimeLoop):
    """Base class of all time integrators. Collective, as are all its methods.

    Derived classes set ``scheme`` before they call ``__init__``. Arguments, further attributes and
    errors as for `EnergyMomentum`.

    Attributes:
        scheme: The time integration scheme.
        supports: The Dirichlet conditions.
        cell_energies: Strain energy of the current state, and `Diagnostics.bulk_defect` of the
            last step without ``inertia_defect`` [J]; None if the step does not compute them.
        watch: Checks of overlaps, vertices that pass through surfaces, and soft springs.
    """

    scheme: Scheme
    cell_energies: tuple[float, float] | None = None
    bodies = SetOnce[tuple[Body, ...]]()
    pairs = SetOnce[tuple[ContactPair, ...]]()

    @abstractmethod
    def _with_defaults(self, pair: ContactPair) -> ContactPair:
        """Pair with the defaults of this stepper for laws that were not given. Collective."""

    def __new__(cls, *arguments: Any, **options: Any) -> Any:
        """Check the arguments, with an error that names the class and its arguments."""
        hint = ", bodies and pairs first and all others by name (dt=, the length of a step [s])"
        check_call(cls, arguments, options, hint)
        return super().__new__(cls)

    def __init__(
        self,
        bodies: Sequence[Body],
        pairs: Sequence[ContactPair],
        *,
        dt: float,
        bcs: Sequence[fem.DirichletBC],
        loads: Sequence[Load],
        update: Callable[[float], None] | None,
    ) -> None:
        comm = common_space(bodies).mesh.comm
        meet(comm, f"make {type(self).__name__} of {len(bodies)} bodies with dt = {dt!r} s")
        V = check_bodies(bodies)
        warn_of_locking(bodies)
        check_volumes(bodies)
        self.bodies = tuple(bodies)
        given = tuple(map(self._with_defaults, instances(ContactPair, pairs)))
        for pair in given:
            if pair.nodes.V != V:
                raise ValueError("expected bodies and pairs in one function space, given two")
        self.supports = Supports(V, bcs)
        seamless = without_seams(self.bodies, given)
        self.pairs = without_symmetry_planes(seamless, self.supports.fixed)
        self.loads = instances(Load, loads)
        for pair in self.pairs:
            if pair.is_convective and self.scheme.contact != "midpoint":
                raise ValueError(
                    f"expected Midpoint with convective friction, given {type(self).__name__}"
                )
            if is_resolved(pair) and not self.scheme.resolves_impact:
                raise ValueError(
                    "expected EnergyMomentum with impact 'resolved', given "
                    f"{type(self).__name__}: use Penalty() or impact 'plastic'"
                )
            if pair.has_defaults and comm.rank == 0:
                _logger.info("%s, as none was given: %s", pair.between, pair.describe())
        for load in self.loads:
            if load.V != V:
                raise ValueError("expected bodies and loads in one function space, given two")
        if not (update is None or callable(update)):
            raise TypeError(f"expected a function of the time as update, given {update!r}")
        check_repeated(self.pairs)
        check_rigid_bodies(self.bodies, self.pairs)
        warn_of_bodies_without_pair(self.bodies, self.pairs)
        warn_of_round_fits(self.pairs, self.bodies)
        super().__init__(V, dt, self.bodies, self.scheme)
        body = body_of_nodes(self.bodies)[: V.dofmap.index_map.size_local]
        passes = Passes(partial(current_positions, self._X, self.u), self._now.item, body)
        self.contacts = tuple(PairState(pair, passes) for pair in self.pairs)
        self.watch = ContactWatch(self.bodies, self.contacts)
        # Bound on the displacement increments of all nodes in the last step [m].
        self._was_displaced, self._increment = True, 0.0
        self.timings = Timings()
        self._script = ScriptValues(self.loads, (self.u_n, self.u), update)
        # Positions before the user displaced bodies; None if they were not displaced since the last
        # step.
        self._x_before: Floats | None = None
        # Cached, since access to the array of a Function is slow.
        self._u, self._u_n = self.u.x.array, self.u_n.x.array
        self._volume_ratio = VolumeRatio(self.u)

    @abstractmethod
    def nodal_momentum(self) -> Floats:
        """Momentum of the owned nodes at t, shape ``(n, 3)`` [kg m/s]."""

    def carried(self, forces: Floats) -> Floats:
        """Forces at the owned nodes, ``(n, 3)`` [N], transferred to the nodes with mass."""
        return forces

    @abstractmethod
    def _step(self) -> StepReport:
        """Solve a step from u_n, v to u, v, and accept the contact at its end."""

    @property
    def statistics(self) -> StepperStatistics:
        """Counts of solver work so far. Local."""
        return StepperStatistics(
            tuple(map(str, self.contacts)),
            tuple(contact.search.num_searches for contact in self.contacts),
            *self._work_of_solvers(),
        )

    @abstractmethod
    def _work_of_solvers(self) -> tuple[int, SolverStatistics | None]:
        """Number of evaluations of internal forces, and statistics of the linear solver."""

    def __repr__(self) -> str:
        """Time, number of steps, and numbers of bodies, pairs and loads. Local."""
        counts = {name: len(getattr(self, name)) for name in ("bodies", "pairs", "loads")}
        return as_call(self, t=self.t, dt=self.dt, step=self.step, **counts)

    def serialize(self, archive: Archive) -> None:
        """Serialize all data on which the next step depends, including contact."""
        super().serialize(archive)
        for number, contact in enumerate(self.contacts, start=1):
            contact.serialize(archive, f"pair_{number}")
            contact.search.serialize(archive, f"pair_{number}/search")
            for i, vertices in enumerate(contact.vertices, start=1):
                vertices.search.serialize(archive, f"pair_{number}/vertices_{i}/search")
        self.watch.serialize(archive)
        # Overlaps of a restored run are not initial overlaps.
        self._was_displaced &= not archive.restores

    def copy_state(
        self,
        archive: Archive,
        contacts: Mapping[int, str],
        *,
        same_scheme: bool,
        same_bodies: bool,
    ) -> None:
        """Copy time, motion, internal variables and contact of another scene on the same mesh.

        Args:
            archive: Archive stored by `serialize` of the other stepper.
            contacts: Name of the contact in the archive by the number of a pair, from 0.
            same_scheme: Whether the other stepper has the same scheme.
            same_bodies: Whether it has the same bodies and materials. If not, internal variables
                keep their initial values.
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
            ValueError: The state, a load, a motion or a condition is not finite; conditions
                conflict; bodies are initially inside a rigid obstacle, or were placed there between
                steps; or ranks have different ``dt``. The state is as before the call.
        """
        self._check_state()
        self._dt.value[...] = self.dt  # faster than assignment to `.value`
        if self._was_displaced:
            self._check_start()
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
        moved = self._increment
        for contact in moving:
            moved = contact.search.displacement_bound(self.x, moved)
        if moved and self.watch.overlaps.moved_far(moved):
            with self.timings.phase("overlap"):
                self.watch.overlaps.follow(self.x, self.t)
        if self._comm.rank == 0:
            numbers = report.step, report.t, report.newton_iterations, report.num_active
            _logger.info("step %d, t = %g s: %d Newton iterations, %d nodes in contact", *numbers)
        return report

    def known_gaps(self) -> list[Floats] | None:
        """Gaps of the nodes of each pair at the current state, or None if not computed. Local.

        They may be NaN at nodes that do not penetrate.

        Returns:
            Arrays of shape ``(n,)`` [m], or None.
        """
        return None

    def check_overlaps(self) -> None:
        """Log overlaps of bodies that have not been reported before.

        A run checks this whenever bodies could have passed through each other, and at its end.
        """
        with self.timings.phase("overlap"):
            self.watch.check_overlaps(self.x, self.t)

    def _check_start(self) -> None:
        """Check a displacement that the user has set."""
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
                contact.accept(reloaded(contact.history))
                contact.search.was_displaced = True
        self._x_before = self._x_before if before is None else before

    def _load_at(self, point: float) -> None:
        """Set the time of the loads, as a fraction of the next step from 0 to 1. Local."""
        t = self.t + point * self.dt
        self._script.take(t, self.t + self.dt)
        for load in self.loads:
            load.update(t)

    def _begin(self, t_n: float, t: float) -> None:
        """Set the prescribed motions for a step from t_n to t [s]. Local."""
        for contact in self.contacts:
            contact.search.begin(t_n, t)

    def _values(self) -> list[str]:
        """Prescribed values of the step as text, for comparison between ranks. Local."""
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
        """Names of guided bodies and their prescribed motions in the step. Local."""
        return []

    def _turns(self) -> list[tuple[str, float]]:
        """Names of moving obstacles and guides, and their rotations in the step [rad]. Local."""
        return [(c.segments.name, c.search.frame.angle) for c in self.contacts]

    def _check_turns(self) -> None:
        """Raise if an obstacle or a guide turns too far in the step."""
        for name, angle in self._turns():
            if angle > _MOST_TURN:
                raise ConvergenceError(
                    f"{self._next()} failed: {name} rotates by {np.degrees(angle):.3g} degrees in "
                    f"it, more than {np.degrees(_MOST_TURN):.3g}; a smaller dt may help, unless "
                    "the rotation of its motion jumps",
                    [],
                )

    def _next(self) -> str:
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
