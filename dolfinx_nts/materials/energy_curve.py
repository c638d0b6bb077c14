"""Derivatives of a strain energy along lines of strain, evaluated by UFL.

No form is compiled. First derivatives are used in the check of an energy, second derivatives give
its moduli.
"""

import warnings
from collections.abc import Callable
from typing import Any

import basix.ufl
import numpy as np
import ufl
from ufl.algorithms import expand_derivatives

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.symbols import Symbol, call_with_symbols
from dolfinx_nts.materials.evaluation import Evaluation

__all__ = ["GENERIC_STRAIN", "EnergyCurve", "energy_of_symbols"]

# Direction D [-] in which no usual invariant is stationary at C = 1.
GENERIC_STRAIN = np.array([[1.0, 0.3, -0.2], [0.3, -0.7, 0.5], [-0.2, 0.5, 0.4]])
# Step in s [-] of the difference of first derivatives: near the cube root of the machine epsilon,
# where round-off and truncation errors are equal.
_STEP = 1e-5
# Tolerances of the difference, relative to first and to second derivatives [-]: upper bounds of its
# round-off and of its truncation error.
_ROUND_OFF, _TRUNCATION = 1e-6, 1e-3


class EnergyCurve:
    r"""Derivatives of :math:`\psi(1 + s D)` with respect to s, for any s and D. Local.

    They are expanded once, as expansion takes longer than evaluation. Values are cached, as the
    check and the moduli of all materials with this energy use the same ones.

    Args:
        psi: Strain energy density ``psi(C)`` [J/m^3], a UFL scalar without fields.

    Raises:
        ArithmeticError, TypeError, ValueError: UFL cannot differentiate psi.
    """

    def __init__(self, psi: Callable[[Any], Any]) -> None:
        mesh = _mesh()
        self._s, self._D = ufl.Constant(mesh), ufl.Constant(mesh, shape=(3, 3))
        at = ufl.variable(self._s)
        first = ufl.diff(psi(ufl.Identity(3) + at * self._D), at)
        self._first, self._second = (
            Evaluation(expand_derivatives(derivative))
            for derivative in (first, ufl.diff(first, at))
        )
        self._values: dict[tuple[bool, bytes, float], float] = {}

    def slope(self, D: Floats, s: float = 0.0) -> float:
        """First derivative in the direction D, shape ``(3, 3)``, at s [J/m^3]."""
        return self._value(False, D, s)

    def curvature(self, D: Floats, s: float = 0.0) -> float:
        """Second derivative in the direction D, shape ``(3, 3)``, at s [J/m^3]."""
        return self._value(True, D, s)

    def check(self) -> None:
        """Compare the curvature at C = 1 with a difference of slopes.

        Raises:
            ArithmeticError, TypeError: A derivative cannot be evaluated.
            ValueError: The derivatives are not finite or do not agree.
        """
        at = (-_STEP, 0.0, _STEP)
        slopes = [self.slope(GENERIC_STRAIN, s) for s in at]
        curvatures = [self.curvature(GENERIC_STRAIN, s) for s in at]
        difference = (slopes[2] - slopes[0]) / (2 * _STEP)
        allowed = _ROUND_OFF * np.abs(slopes).sum() + _TRUNCATION * np.abs(curvatures).sum()
        if not abs(difference - curvatures[1]) <= allowed < np.inf:
            raise ValueError(
                f"derivatives {slopes[1], curvatures[1]}, of which the second one is {difference} "
                "by differences"
            )

    def _value(self, is_second: bool, D: Floats, s: float) -> float:
        key = is_second, D.tobytes(), s
        if key not in self._values:
            derivative = self._second if is_second else self._first
            with warnings.catch_warnings():
                # UFL logs a warning before it raises.
                warnings.simplefilter("ignore")
                self._values[key] = derivative.value({self._s: s, self._D: D.tolist()})
        return self._values[key]


class _Stretch(ufl.Constant, Symbol):  # type: ignore[misc]
    __float__ = Symbol.__float__


def energy_of_symbols(psi: Callable[[Any], Any]) -> Any:
    """Evaluate an energy psi(C) at a tensor C of UFL constants, as a UFL scalar. Local.

    Raises:
        TypeError, ValueError: The energy fails, or converts the strain to numbers.
    """
    stretch = _Stretch(_mesh())
    C = (1 + stretch) * ufl.Identity(3)
    return call_with_symbols("a strain energy", lambda: ufl.as_ufl(psi(C)), symbol=stretch)


def _mesh() -> ufl.Mesh:
    """Some mesh, which UFL constants need."""
    return ufl.Mesh(basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,)))
