"""Runs to a given time, in steps of equal length or with step control."""

import logging
import math
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

from mpi4py import MPI

import numpy as np
from dolfinx import fem
from tqdm import tqdm

from dolfinx_nts.common.archive import Archive, Snapshot
from dolfinx_nts.common.arguments import kind_of
from dolfinx_nts.common.arrays import Flags
from dolfinx_nts.common.declaration import SetOnce
from dolfinx_nts.contact.nodes_with_gap import nodes_with_gap
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.node_numbering import listed
from dolfinx_nts.integrators.conditions import Conditions, Until, split
from dolfinx_nts.integrators.inelastic.memory import Memory
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.integrators.stagnation import IneffectiveCuts, LimitPoint, ShortSteps
from dolfinx_nts.integrators.state import State
from dolfinx_nts.integrators.statics.relaxation import IF_IT_MOVES
from dolfinx_nts.integrators.step_control import ROUND_OFF, EvenSteps, StepControl, StepLength
from dolfinx_nts.integrators.step_failure import SHORTER_STEP_HELPS
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.loads.load import Load
from dolfinx_nts.parallel.collective_calls import meet
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.solvers.newton_report import ConvergenceError

__all__ = ["StepLoop", "TimeLoop"]

_logger = logging.getLogger("dolfinx_nts")

# Format of a progress bar that counts simulated seconds instead of steps.
_BAR = "{l_bar}{bar}| {n:.4g}/{total:.4g} s [{elapsed}<{remaining}]"


class StepLoop(Iterator[StepReport]):
    """Iterator over step reports, which warns if no step was taken. Collective, except on deletion.

    Args:
        steps: Generator that takes a step for each report.
        comm: Communicator, whose first rank warns.
    """

    def __init__(self, steps: Iterator[StepReport], comm: MPI.Comm) -> None:
        self._steps = steps
        self._is_silent = comm.rank > 0

    def __next__(self) -> StepReport:
        """Take the next step and return its report."""
        self._is_silent = True
        return next(self._steps)

    def __del__(self) -> None:
        """Warn if no step was requested."""
        if not self._is_silent:
            _logger.warning(
                "run() was called without a loop, so that no step was taken: write "
                '"for step in stepper.run(...)", or list(stepper.run(...))'
            )


class TimeLoop(State):
    """A state that is advanced step by step. Collective, as are all its methods.

    Args:
        V, dt: See `State`.
        bodies: The bodies.
        scheme: Gives the stress of a step.

    Attributes:
        contacts: State of each contact pair.
        loads: The loads.
        memory: Internal variables of the materials, such as viscous strains.
    """

    contacts: tuple[PairState, ...]
    loads = SetOnce[tuple[Load, ...]]()
    # Whether a step tries Newton's method, and then the last resort (`_has_last_resort`).
    _tries, _relaxes = True, True
    # Whether equal steps that fail are halved, which requires a copy of the state in each step.
    _halves_equal_steps: ClassVar[bool] = True

    def __init__(
        self, V: fem.FunctionSpace, dt: float, bodies: Sequence[Body], scheme: Scheme
    ) -> None:
        super().__init__(V, dt)
        self.memory = Memory(bodies, self.u_n, self.u, self._dt, scheme)
        self._even, self._length = EvenSteps(), StepLength()

    @abstractmethod
    def advance(self) -> StepReport:
        """Advance by one step of length ``dt``."""

    @abstractmethod
    def check_overlaps(self) -> None:
        """Log overlaps that have not been reported before."""

    def _static_increment(self) -> float | None:
        """Largest displacement increment of a node in the last step [m]; None with inertia."""
        return None

    def _has_last_resort(self) -> bool:
        """Whether another solution method remains for a step that fails at any length."""
        return self._static_increment() is not None

    def _longest_step(self) -> float:
        """Upper bound on the length of a step [s]."""
        return math.inf

    def serialize(self, archive: Archive) -> None:
        """Serialize the state and the step control."""
        super().serialize(archive)
        self.memory.serialize(archive)
        self._even.serialize(archive)
        self._length.serialize(archive)

    def run(self, until: Until, control: StepControl | None = None) -> Iterator[StepReport]:
        """Advance step by step; the last step ends exactly at the time ``until``.

        Args:
            until: Time at the end [s]; a `ContactForce`; or a function of the `StepReport` that
                returns whether the run ends. The run ends with the first step for which a condition
                holds. A list of conditions ends it as soon as one of them holds: include a time if
                a condition may never hold.
            control: Lengths of steps. With None every step has the length ``dt``, except the last
                one. Implicit steps that fail are halved, with one warning;
                ``StepControl(smallest=dt)`` prevents this.

        Returns:
            Iterator over the reports of the steps. Each iteration takes one step, so that ``dt``
            may be set between two steps.

        Raises:
            TypeError: ``until`` is neither a number nor a condition, or ``control`` not a
                `StepControl`.
            ValueError: ``until`` is negative or not finite, or the force of a pair that this
                stepper does not have.
            ConvergenceError: A step failed at its smallest length. The stepper keeps the last
                accepted state.
        """
        end, conditions = split(until, self._comm)
        if not (control is None or isinstance(control, StepControl)):
            raise TypeError(f"expected a StepControl() as control, given {kind_of(control)}")
        if end < self.t - ROUND_OFF * self.dt and self._comm.rank == 0:
            _logger.warning(
                "run(until=%g) has no steps to take, as the time is %g: harmless if a resumed "
                "run has already reached it; otherwise note that until is a time, not a duration",
                end,
                self.t,
            )
        return StepLoop(self._steps(end, conditions, control), self._comm)

    def _steps(
        self, until: float, conditions: Conditions, control: StepControl | None
    ) -> Iterator[StepReport]:
        meet(self._comm, f"run from t = {self.t!r} s until {until!r} s")
        steps = self._run(until, control)
        try:
            for report in steps:
                ends = conditions.hold(report, self.contacts)
                yield report
                if ends:
                    break
        except ConvergenceError:
            self.check_overlaps()  # overlaps may have caused the failure
            raise
        self.check_overlaps()

    def _run(self, until: float, given: StepControl | None) -> Iterator[StepReport]:
        """Advance in equal steps, or in steps as long as the control and the scheme permit."""
        control, statics = given or StepControl(), self._static_increment() is not None
        halves = given is not None or self._halves_equal_steps
        smallest, gap_tol = control.shortest(self.dt), control.gap_tol
        apart = None if gap_tol is None else self._nodes_with_gap(gap_tol)
        rejected, first, limit, short = 0, "", LimitPoint(), ShortSteps()
        ineffective, is_reported = IneffectiveCuts(inertia=not statics), given is not None
        final: ConvergenceError | None = None  # raised if the last resort fails as well
        with self._progress(until, initial=self.t, bar_format=_BAR) as bar:
            while until - self.t > ROUND_OFF * (smallest if given else self.dt):
                dt, end = self._next_step(until, given)
                snapshot = Snapshot() if halves else None
                if snapshot is not None:
                    self.serialize(snapshot)
                try:
                    report = self._advance_to(end, dt, far=final is not None)
                    if apart is not None and gap_tol is not None:
                        apart = self._checked(apart, gap_tol)
                except ConvergenceError as error:
                    if snapshot is None:
                        raise
                    self.serialize(snapshot.rewind())
                    if final is not None:
                        raise (
                            _error_after_relaxation(final, error) if statics else final
                        ) from None
                    hopeless = any(each.is_hopeless for each in error.reports)
                    if hopeless and given is None:
                        raise
                    first = first or f"with dt = {dt:.3g} s it failed first: {error.cause}"
                    ineffective.fail(error.reports, dt, self._length.cuts)
                    before = after = ""
                    if limit.is_near and control.smallest is None:
                        before = limit.message(self.t, end, len(self.loads) > 0)
                    elif ineffective.are_certain and control.smallest is None:
                        before = ineffective.message()
                    elif dt / 2 < smallest:
                        was = "has been cut to" if self._length.cuts else "is"
                        after = f"dt {was} {dt:.3g} s, half of which is less than the smallest "
                        after += f"step of {smallest:.3g} s{f'; {first}' if rejected else ''}"
                    if before or after:
                        final = _extended(error, before, after)
                        if hopeless or not self._has_last_resort():
                            raise final from None
                        # The last resort starts from the length before the cuts.
                        self._length.uncut(rejected)
                        rejected += 1
                        continue
                    if self._comm.rank == 0:
                        level = logging.INFO if is_reported else logging.WARNING
                        number, half = self.step + 1, dt / 2
                        text = "step %d from t = %g s is cut to %.3g s: %s"
                        _logger.log(level, text, number, self.t, half, error.cause)
                    is_reported = True
                    short.fail(error.cause)
                    self._length.cut()
                    rejected += 1
                    continue
                if final is not None:
                    # After a jump to another state, the history of cuts is irrelevant.
                    limit, short, self._length = LimitPoint(), ShortSteps(), StepLength()
                warning = short.accept(self._length.cuts)
                if warning and self._comm.rank == 0:
                    _logger.warning("at t = %g %s", self.t, warning)
                self._length.accept()
                ineffective.accept()
                if (increment := self._static_increment()) is not None:
                    limit.accept(increment / dt, rejected)
                yield report._replace(rejected=rejected)
                bar.update(dt)
                rejected, first, final = 0, "", None

    def _next_step(self, until: float, control: StepControl | None) -> tuple[float, float]:
        """Length and end of the next step, both [s]."""
        dt = self.dt * 0.5**self._length.cuts
        if control is not None:
            return control.next_step(self.t, min(dt, self._longest_step()), until)
        even, is_last = self._even, (until - self.t) / self.dt <= 1 + ROUND_OFF
        if even.goes_on(self.t, self.dt):
            # The remainder of a halved step.
            return StepControl().next_step(self.t, dt, min(even.target, until))
        end = even.next(self.t, self.step, self.dt)
        end = until if is_last else end
        if self._length.cuts:
            return StepControl().next_step(self.t, dt, end)
        return self.dt if end == even.target else end - self.t, end

    def _advance_to(self, end: float, dt: float, *, far: bool) -> StepReport:
        """Advance by one step of length dt [s], and set the time to its end [s] exactly.

        ``far`` selects the last resort: relaxation in statics; with inertia, Newton's method and
        then a step without contact of vertices. If it is false, only Newton's method is tried.
        """
        statics = self._static_increment() is not None
        self._tries, self._relaxes = not (far and statics), far
        try:
            with self._steps_of(dt):
                report = self.advance()
        finally:
            self._tries, self._relaxes = True, True
        self.t = end
        return report._replace(t=end)

    def _nodes_with_gap(self, gap_tol: float) -> list[Flags]:
        """Flags of active nodes of each pair whose gap exceeds gap_tol in magnitude."""
        x = self.x
        return [nodes_with_gap(pair, x, gap_tol) for pair in self.contacts]

    def _checked(self, before: list[Flags], gap_tol: float) -> list[Flags]:
        """Flags of active nodes with a large gap after the step; raises if there are new ones."""
        after = self._nodes_with_gap(gap_tol)
        new = [
            pair.nodes.node_ids[now & ~then]
            for pair, now, then in zip(self.contacts, after, before, strict=True)
        ]
        none = np.empty(0, dtype=np.int64)
        nodes = np.unique(joined(self._comm, np.concatenate([none, *new])))
        if len(nodes):
            raise ConvergenceError(
                f"step {self.step} to t = {self.t:g} keeps {len(nodes)} nodes in contact at gaps "
                f"above gap_tol = {gap_tol:g} m: {listed(nodes)}; the state is that of the last "
                "accepted step",
                [],
            )
        return after

    def _progress(self, total: float, **options: Any) -> Any:
        """Progress bar on rank 0, if a terminal exists and the run lasts over a second."""
        silent = None if self._comm.rank == 0 else True  # None: silent without a terminal
        # Without an end time the bar only counts.
        end = total if math.isfinite(total) else None
        if end is None:
            options.pop("bar_format", None)
        return tqdm(total=end, delay=1, leave=False, disable=silent, **options)


def _extended(error: ConvergenceError, before: str, after: str) -> ConvergenceError:
    """Copy of an error with texts before its message and after its cause. Local."""
    cause = "; ".join(filter(None, [error.cause, after]))
    # Relaxation is the last resort: shorter steps have failed before.
    message = error.args[0].replace(error.cause, cause, 1).removesuffix(f": {SHORTER_STEP_HELPS}")
    return ConvergenceError("; ".join(filter(None, [before, message])), error.reports, cause)


def _error_after_relaxation(final: ConvergenceError, error: ConvergenceError) -> ConvergenceError:
    """Error of a run in which pseudo-transient continuation has failed, too. Local."""
    return ConvergenceError(
        f"{final.args[0]}; relaxation with a viscous resistance has not found another one either: "
        f"{error.reports[-1].reason if error.reports else error.cause}; {IF_IT_MOVES}",
        final.reports,
        final.cause,
    )
