r"""Change of volume in a step, for conserving stresses of energies in det C.

With :math:`A = (\mathrm{cof}\, C_n + 4\, \mathrm{cof}\, C_m + \mathrm{cof}\, C_{n+1})/6` and the
mean :math:`C_m`, :math:`A : (C_{n+1} - C_n) = \det C_{n+1} - \det C_n` exactly, as the determinant
is cubic (Betsch, Janz, Hesch 2018). A function of det C then needs only its own difference
quotient, in a form without 0/0.
"""

from functools import cached_property
from typing import Any

import ufl

__all__ = ["VolumeIncrement"]

# Square of z [-] below which atanh(z)/z is evaluated as a series, and number of its terms; the next
# one is round-off.
_SERIES, _TERMS = 0.01, 9


class VolumeIncrement:
    """Volumes at both ends of a step, and difference quotients with respect to det C. Local.

    Args:
        C_n: Right Cauchy-Green tensor at t_n, UFL (3, 3).
        C: Right Cauchy-Green tensor at t_{n+1}, UFL (3, 3).

    Attributes:
        gradient: A tensor A with A : (C - C_n) = det C - det C_n, UFL (3, 3).
        square_n, square: det C at both ends, the square of the volume ratio J.
        sum: J_n + J.
    """

    def __init__(self, C_n: Any, C: Any) -> None:
        self._dC = C - C_n
        mean = (C_n + C) / 2
        self.gradient = (ufl.cofac(C_n) + ufl.cofac(C) + 4 * ufl.cofac(mean)) / 6
        self.square_n, self.square = ufl.det(C_n), ufl.det(C)

    @cached_property
    def sum(self) -> Any:
        """J_n + J."""
        return ufl.sqrt(self.square_n) + ufl.sqrt(self.square)

    @cached_property
    def logarithm(self) -> Any:
        r"""Difference quotient of ln det C, :math:`2\, \mathrm{artanh}(z)/z / (I_n + I)`."""
        total = self.square_n + self.square
        z = ufl.inner(self.gradient, self._dC) / total
        square, series = z * z, 0.0
        for k in reversed(range(_TERMS)):
            series = 1 / (2 * k + 1) + square * series
        is_small = ufl.lt(square, _SERIES)
        safe = ufl.conditional(is_small, 0.5, z)
        whole = ufl.ln((1 + safe) / (1 - safe)) / (2 * safe)
        return 2 * ufl.conditional(is_small, series, whole) / total

    @cached_property
    def roots(self) -> tuple[Any, Any]:
        """J^(-2/3) at both ends."""
        return self.square_n ** (-1 / 3), self.square ** (-1 / 3)

    @cached_property
    def root(self) -> Any:
        """Difference quotient of J^(-2/3)."""
        # a^3 = 1/I, so that the difference of a is the difference of 1/I over this sum of products.
        a_n, a = self.roots
        return -1 / (self.square_n * self.square * (a_n**2 + a_n * a + a**2))
