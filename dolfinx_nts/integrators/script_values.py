"""Constants and Functions of the script in the forms of loads."""

from collections.abc import Callable, Sequence
from typing import Any

import ufl
from dolfinx import fem

from dolfinx_nts.model.loads import Load

__all__ = ["ScriptValues"]


class ScriptValues:
    """Values in loads that ``update`` sets, evaluated at the time of the scheme. Local.

    Dirichlet conditions need the values at the end of a step, loads mostly those in its middle,
    and both may share a Constant. So the forms of loads contain copies.

    Args:
        loads: Loads of the stepper.
        state: Displacements at both ends of a step, which the script does not set.
        update: Function of the script that sets values for a time [s], if there is one.
    """

    def __init__(
        self,
        loads: Sequence[Load],
        state: tuple[fem.Function, fem.Function],
        update: Callable[[float], None] | None,
    ) -> None:
        self._state, self._update = state, update
        self._copies: dict[Any, Any] = {}
        self._constants = [(load.name, load.form(*state).constants()) for load in loads]

    @property
    def updates(self) -> bool:
        """Whether the script has an ``update``."""
        return self._update is not None

    def constants(self) -> list[tuple[str, Any]]:
        """Names of loads, and the present values of their constants."""
        return [(name, c.value) for name, constants in self._constants for c in constants]

    def with_copies(self, load: Load, form: ufl.Form) -> ufl.Form:
        """Replace the values of the script in the form of a load by copies."""
        given = [value for value in load.given(form) if not any(value is s for s in self._state)]
        for value in given:
            if value not in self._copies:
                self._copies[value] = value.copy() if _is_function(value) else _copy(value)
        return ufl.replace(form, {value: self._copies[value] for value in given})

    def update(self, end: float) -> None:
        """Let the script set its values for the end of the step [s], unless `take` does."""
        if self._update is not None and not self._copies:
            self._update(end)

    def take(self, t: float, end: float) -> None:
        """Copy the values in loads at a time, and leave those for the end of the step [s]."""
        if not self._copies:
            return
        if self._update is not None:
            self._update(t)
        for value, copy in self._copies.items():
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
