"""Values of UFL expressions, in which nothing is evaluated twice.

UFL evaluates an expression as a tree: what occurs in several places, as an invariant of C does in
all its derivatives, is evaluated in each of them, and what occurs in that again.
"""

from collections.abc import Mapping
from typing import Any

from ufl.core.multiindex import Index
from ufl.corealg.traversal import unique_post_traversal
from ufl.utils.stacks import StackDict

__all__ = ["Evaluation"]


class Evaluation:
    """Evaluates a scalar expression, for any numbers of its constants. Local.

    Args:
        expression: UFL scalar without fields, whose derivatives are expanded.
    """

    def __init__(self, expression: Any) -> None:
        """Let every part remember its values."""
        parts: dict[Any, Any] = {}
        for part in unique_post_traversal(expression):
            operands = tuple(parts[operand] for operand in part.ufl_operands)
            parts[part] = _Part(part, operands) if operands else part
        self._whole = parts[expression]

    def value(self, numbers: Mapping[Any, Any]) -> float:
        """The value for numbers of the constants, by constant.

        Raises:
            ArithmeticError, TypeError, ValueError: There is none.
        """
        return float(self._whole.evaluate((), dict(numbers), (), StackDict()))


class _Part:
    """An operator of UFL, whose operands and values are remembered.

    Args:
        operator: The operator.
        operands: Its operands, of which operators are parts, too.
    """

    def __init__(self, operator: Any, operands: tuple[Any, ...]) -> None:
        self.ufl_operands = operands
        self._operator, self._evaluate = operator, type(operator).evaluate
        self._indices = [Index(count) for count in operator.ufl_free_indices]

    def __getattr__(self, name: str) -> Any:
        """What UFL asks of the operator."""
        return getattr(self._operator, name)

    def evaluate(
        self, x: Any, known: dict[Any, Any], component: Any, index_values: dict[Any, int]
    ) -> Any:
        """Evaluate as UFL does, with values of constants and of parts among what is known."""
        key = (self, component, *(index_values[i] for i in self._indices))
        if key not in known:
            known[key] = self._evaluate(self, x, known, component, index_values)
        return known[key]
