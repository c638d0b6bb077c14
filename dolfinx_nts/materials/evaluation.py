"""Evaluation of UFL expressions with cached subexpressions.

UFL evaluates an expression as a tree. A subexpression that occurs repeatedly, such as an invariant
of C in its derivatives, is evaluated at each occurrence.
"""

from collections.abc import Mapping
from typing import Any

from ufl import Coefficient
from ufl.core.multiindex import Index
from ufl.corealg.traversal import unique_post_traversal
from ufl.geometry import GeometricQuantity
from ufl.utils.stacks import StackDict

__all__ = ["Evaluation"]


class Evaluation:
    """Evaluates a scalar expression for given values of its constants. Local.

    Args:
        expression: UFL scalar, with expanded derivatives.

    Raises:
        ValueError: The expression has fields: Functions or coordinates, whose values vary in space.
    """

    def __init__(self, expression: Any) -> None:
        parts: dict[Any, Any] = {}
        for part in unique_post_traversal(expression):
            if isinstance(part, Coefficient | GeometricQuantity):
                # UFL would search endlessly for the value of a field.
                raise ValueError(f"expected an expression without fields, given one with {part}")
            operands = tuple(parts[operand] for operand in part.ufl_operands)
            parts[part] = _Part(part, operands) if operands else part
        self._whole = parts[expression]

    def value(self, numbers: Mapping[Any, Any]) -> float:
        """Value of the expression for given values of its constants.

        Raises:
            ArithmeticError, TypeError, ValueError: The expression has no value.
        """
        return float(self._whole.evaluate((), dict(numbers), (), StackDict()))


class _Part:
    """UFL operator with cached values.

    Args:
        operator: The operator.
        operands: Its operands; operators among them are also of this class.
    """

    def __init__(self, operator: Any, operands: tuple[Any, ...]) -> None:
        self.ufl_operands = operands
        self._operator, self._evaluate = operator, type(operator).evaluate
        self._indices = [Index(count) for count in operator.ufl_free_indices]

    def __getattr__(self, name: str) -> Any:
        """Attributes of the operator."""
        return getattr(self._operator, name)

    def evaluate(
        self, x: Any, known: dict[Any, Any], component: Any, index_values: dict[Any, int]
    ) -> Any:
        """Evaluate as UFL does, with cached values of constants and subexpressions."""
        key = (self, component, *(index_values[i] for i in self._indices))
        if key not in known:
            known[key] = self._evaluate(self, x, known, component, index_values)
        return known[key]
