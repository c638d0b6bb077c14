"""Runs: step by step to a time, in equal steps or in steps that are cut and grow."""

import logging
import math
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Any, Protocol

from mpi4py import MPI

import numpy as np
from dolfinx import fem
from tqdm import tqdm

from dolfinx_nts.common.archive import Archive, Snapshot
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.node_numbering import listed
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.step_control import Pace, StepControl
from dolfinx_nts.solvers.newton import ConvergenceError

__all__ = ["Steps", "progress", "run_controlled", "run_evenly"]


_logger = logging.getLogger("dolfinx_nts")

# Of a bar in seconds of the run.
_BAR = "{l_bar}{bar}| {n:.4g}/{total:.4g} s [{elapsed}<{remaining}]"


class Steps(Protocol):
    """What can be run: a stepper, see there."""

    t: float
    step: int
    u: fem.Function
    pace: Pace
    contacts: tuple[PairState, ...]

    @property
    def dt(self) -> float:
        """Length of a step that is not cut [s]."""

    @property
    def x(self) -> Floats:
        """Positions of the local nodes [m]."""

    def longest_step(self) -> float:
        """Length that a step must not exceed [s]."""

    def steps_of(self, dt: float) -> AbstractContextManager[None]:
        """Context in which a step has another length."""

    def advance(self) -> StepReport:
        """Advance by one step."""

    def serialize(self, archive: Archive) -> None:
        """Serialize the accepted state."""


def run_evenly(stepper: Steps, until: float) -> Iterator[StepReport]:
    """Advance in equal steps; the last ends at a given time. Collective.

    Args:
        stepper: What is run.
        until: Time at the end [s].

    Yields:
        The report of each step, after it has been accepted.

    Raises:
        ConvergenceError: A step failed. The state is that of the last accepted step.
    """
    dt, even = stepper.dt, stepper.pace.even
    even.go_on(stepper.t, stepper.step, dt)
    num_steps = math.ceil((until - stepper.t) / dt - 1e-6)
    with progress(stepper.u.function_space.mesh.comm, num_steps, unit="step") as bar:
        for i in range(num_steps):
            end = even.end(stepper.step + 1, dt)
            if i == num_steps - 1 and end != until:
                yield _advance_to(stepper, until, until - stepper.t)
            else:
                yield _advance_to(stepper, end, dt)
            bar.update()


def run_controlled(stepper: Steps, until: float, control: StepControl) -> Iterator[StepReport]:
    """Advance step by step, each as long as it can be. Collective.

    Args:
        stepper: What is run.
        until: Time at the end [s].
        control: Says how long a step may be.

    Yields:
        The report of each step, after it has been accepted.

    Raises:
        ConvergenceError: A step failed at its smallest length. The state is that of the last
            accepted step.
    """
    comm: MPI.Comm = stepper.u.function_space.mesh.comm
    smallest = 2.0**-20 * stepper.dt if control.smallest is None else control.smallest
    apart = None if control.gap_tol is None else _held_apart(stepper, control.gap_tol)
    rejected = 0
    with progress(comm, until, initial=stepper.t, bar_format=_BAR) as bar:
        while until - stepper.t > 1e-6 * smallest:
            longest = min(stepper.dt * 0.5**stepper.pace.length.cuts, stepper.longest_step())
            dt, end = control.next_step(stepper.t, longest, until)
            before = Snapshot()
            stepper.serialize(before)
            try:
                report = _advance_to(stepper, end, dt)
                if apart is not None and control.gap_tol is not None:
                    apart = _checked(stepper, apart, control.gap_tol)
            except ConvergenceError as error:
                stepper.serialize(before.rewind())
                if dt / 2 < smallest:
                    raise ConvergenceError(
                        f"{error}; dt has been cut to {dt:.3g} s, half of which is "
                        f"less than the smallest step of {smallest:.3g} s",
                        error.reports,
                    ) from None
                if comm.rank == 0:
                    number, t = stepper.step + 1, stepper.t
                    _logger.info("step %d from t = %g is cut: %s", number, t, error)
                stepper.pace.length.cut()
                rejected += 1
                continue
            stepper.pace.length.accept()
            yield report._replace(rejected=rejected)
            bar.update(dt)
            rejected = 0


def _advance_to(stepper: Steps, end: float, dt: float) -> StepReport:
    """Advance by one step that ends exactly at a time.

    Args:
        stepper: What is run.
        end: Time at its end [s].
        dt: Its length [s], the difference of the times but for round-off.
    """
    with stepper.steps_of(dt):
        report = stepper.advance()
    stepper.t = end
    return report._replace(t=end)


def _held_apart(stepper: Steps, gap_tol: float) -> list[Flags]:
    """Nodes of each pair that are held, or inside, beyond the tolerance."""
    x = stepper.x
    return [pair.held_apart(x, gap_tol) for pair in stepper.contacts]


def _checked(stepper: Steps, before: list[Flags], gap_tol: float) -> list[Flags]:
    """Such nodes after the step just done; raises if there are new ones."""
    after = _held_apart(stepper, gap_tol)
    comm = stepper.u.function_space.mesh.comm
    new = [
        pair.nodes.node_ids[now & ~then]
        for pair, now, then in zip(stepper.contacts, after, before, strict=True)
    ]
    none = np.empty(0, dtype=np.int64)
    nodes = np.unique(np.concatenate(comm.allgather(np.concatenate([none, *new]))))
    if len(nodes):
        raise ConvergenceError(
            f"step {stepper.step} to t = {stepper.t:g} brings {len(nodes)} nodes more than "
            f"gap_tol = {gap_tol:g} m from the surface that catches them: {listed(nodes)}; the "
            "state is that of the last accepted step",
            [],
        )
    return after


def progress(comm: MPI.Comm, total: float, **options: Any) -> Any:
    """Bar on the terminal of rank 0, if it takes longer than a second. Local.

    Args:
        comm: Communicator of the run.
        total: What is to be done.
        options: Those of tqdm: the unit, for instance.

    Returns:
        The bar, a context; its method ``update`` takes what has been done.
    """
    # None: where there is a terminal.
    silent = None if comm.rank == 0 else True
    return tqdm(total=total, delay=1, leave=False, disable=silent, **options)
