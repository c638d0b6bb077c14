"""The strain energy of a material along lines of strain, evaluated by UFL."""

import warnings
from collections.abc import Callable
from typing import Any

import basix.ufl
import ufl
from ufl.algorithms import expand_derivatives
from ufl.utils.stacks import StackDict

from dolfinx_nts.common.arrays import Floats

__all__ = ["EnergyCurve"]


class EnergyCurve:
    r"""Derivatives of :math:`\psi(1 + s D)` by s, for any s and D.

    Local. They are expanded once: UFL does it at every evaluation, which takes
    longer than the rest of it.

    Args:
        psi: Strain energy density ``psi(C)`` [J/m^3], a UFL scalar without
            fields.

    Raises:
        ArithmeticError, TypeError, ValueError: UFL cannot differentiate psi.
    """

    def __init__(self, psi: Callable[[Any], Any]) -> None:
        """Differentiate twice."""
        # Constants need a mesh; none is there.
        mesh = ufl.Mesh(basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,)))
        self._s, self._D = ufl.Constant(mesh), ufl.Constant(mesh, shape=(3, 3))
        at = ufl.variable(self._s)
        first = ufl.diff(psi(ufl.Identity(3) + at * self._D), at)
        self._first, self._second = map(expand_derivatives, (first, ufl.diff(first, at)))

    def slope(self, D: Floats, s: float = 0.0) -> float:
        """First derivative at s in the direction D, shape ``(3, 3)`` [J/m^3]."""
        return self._value(self._first, D, s)

    def curvature(self, D: Floats, s: float = 0.0) -> float:
        """Second derivative, see `slope`."""
        return self._value(self._second, D, s)

    def _value(self, derivative: Any, D: Floats, s: float) -> float:
        with warnings.catch_warnings():
            # UFL warns before it raises.
            warnings.simplefilter("ignore")
            values = {self._s: s, self._D: D.tolist()}
            return float(derivative.evaluate((), values, (), StackDict()))
