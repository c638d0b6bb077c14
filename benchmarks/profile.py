"""Wall time by phase, each second counted once."""

import functools
import time
from collections.abc import Callable
from typing import Any

from dolfinx_nts.integrators.implicit import implicit_stepper
from dolfinx_nts.solvers import bulk, newton
from dolfinx_nts.solvers.linear import active_sets, elimination, krylov, saddle_point
from dolfinx_nts.solvers.precond import contact_schwarz, preconditioner

__all__ = ["CONTACT", "Profile"]

# Phases that exist only with contact.
CONTACT = ("search and projection", "elimination", "contact Schwarz")

_LABELS = {"assembly": "residual", "contact": "search and projection", "solve": "Krylov"}


class Profile:
    """Replaces the timings of a stepper, and also times parts of a step that have no phase.

    A phase within a phase interrupts the outer one. Some phases are so short
    that the clock of CPU time, a system call, would count more than they do.

    Attributes:
        seconds: Wall time by phase [s].
    """

    def __init__(self) -> None:
        """Wrap the parts of an implicit step that have no phase."""
        self.seconds: dict[str, float] = {}
        self._open: list[str] = []
        self._since = 0.0
        for owner, name, phase in (
            (implicit_stepper, "contact_history", "contact"),
            (implicit_stepper, "contact_work", "contact"),
            (bulk.Bulk, "action", "action"),
            (bulk.Bulk, "rounded_action", "action"),
            (bulk.Bulk, "forces", "assembly"),
            (saddle_point.SaddlePointSystem, "solve", "direct"),
            (preconditioner.BulkPreconditioner, "build", "factors"),
            (krylov, "active_pairs", "elimination"),
            (active_sets.ActiveSets, "number", "elimination"),
            (active_sets.ActiveSets, "are_coupled", "elimination"),
            (elimination.Elimination, "particular", "elimination"),
            (elimination.Elimination, "constrain", "elimination"),
            (elimination.Elimination, "act", "elimination"),
            (contact_schwarz.ContactSchwarz, "update", "contact Schwarz"),
            (contact_schwarz.ContactSchwarz, "correct", "contact Schwarz"),
            (newton, "contact_residual", "contact"),
        ):
            setattr(owner, name, self._watched(getattr(owner, name), phase))

    @staticmethod
    def label(name: str) -> str:
        """Name in the tables of a phase of the stepper."""
        return _LABELS.get(name, name)

    def phase(self, name: str) -> "_Phase":
        """Count the time of a ``with`` block."""
        return _Phase(self, self.label(name))

    def enter(self, name: str) -> None:
        """Start a phase and interrupt the current one."""
        self._switch()
        self._open.append(name)

    def leave(self) -> None:
        """End the phase that was started last."""
        self._switch()
        self._open.pop()

    def _switch(self) -> None:
        now = time.perf_counter()
        if self._open:
            name = self._open[-1]
            self.seconds[name] = self.seconds.get(name, 0.0) + now - self._since
        self._since = now

    def _watched(self, function: Callable[..., Any], phase: str) -> Callable[..., Any]:
        name = self.label(phase)

        # Some calls take microseconds, so that a context manager would be too slow.
        @functools.wraps(function, updated=())
        def call(*args: Any, **kwargs: Any) -> Any:
            self.enter(name)
            try:
                return function(*args, **kwargs)
            finally:
                self.leave()

        return call


class _Phase:
    """A phase of a profile."""

    __slots__ = ("_name", "_profile")

    def __init__(self, profile: Profile, name: str) -> None:
        self._profile, self._name = profile, name

    def __enter__(self) -> None:
        self._profile.enter(self._name)

    def __exit__(self, *error: object) -> None:
        self._profile.leave()
