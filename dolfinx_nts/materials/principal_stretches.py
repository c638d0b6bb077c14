r"""Sums of powers of principal stretches, safe where some or all of them are equal.

The roots of the characteristic equation of C have no derivative where two are equal, as they are at
C = 1; sums over all of them do. With the mean :math:`q = \mathrm{tr}\, C/3` and the deviator
:math:`D`, the squared stretches are :math:`q\,(1 + \eta_k)`, where :math:`\eta_k` are the roots of
:math:`\eta^3 - a\, \eta - b = 0` with :math:`a = D : D/(2 q^2)` and :math:`b = \det D/q^3`. Sums
are analytic functions of a and b:

- Where all stretches are close, by the binomial series in :math:`\eta`, whose power sums
  :math:`s_n = a\, s_{n-2} + b\, s_{n-3}` need no root.
- Elsewhere by the isolated root, :math:`2\, \sqrt{a/3}\, t` times the sign of b, with
  :math:`4 t^3 - 3 t = |b|/2\, (3/a)^{3/2}` and :math:`t \ge \sqrt{3}/2`, where the cubic is
  steep; and by the mean m of the other two, and the square of their difference over their sum,
  :math:`w^2`, as
  :math:`(1 + w)^\beta + (1 - w)^\beta` is even in w: a series where they are close.

No branch has a pole where another one is used, so UFL can differentiate all of them.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
import ufl

__all__ = ["PrincipalStretches"]

# Largest eta [-] for the series about three equal stretches, and largest w^2 [-] for the series
# about two equal ones. Elsewhere the root is used; near these limits its derivatives lose a digit
# to cancellation.
_CLOSE, _PAIR = 0.02, 1e-3
# Starting value t(c) [-] on [0, 1], a cubic with exact values and slopes at both ends (error 4e-4),
# and number of Newton steps after which value and derivatives are exact to round-off.
_START, _NEWTON = (0.00983, -0.04253, 1 / 6, 0.75**0.5), 3
# Relative size of a term in a second derivative [-] that counts as round-off.
_ROUND_OFF = np.finfo(float).eps


class PrincipalStretches:
    """Sums of powers of the isochoric principal stretches of C. Local.

    Args:
        C: Right Cauchy-Green tensor, UFL (3, 3).
        exponents: Exponents for `powers`, which determine the length of the series.
    """

    def __init__(self, C: Any, exponents: Iterable[float]) -> None:
        halves = [alpha / 2 for alpha in exponents]
        self._num_close = max(_num_terms(beta, 1, _CLOSE) for beta in halves)
        self._num_pair = max(_num_terms(beta, 2, _PAIR) for beta in halves)
        q, D = ufl.tr(C) / 3, ufl.dev(C)
        self._a, self._b, self._volume = map(
            ufl.variable,
            (ufl.inner(D, D) / (2 * q**2), ufl.det(D) / q**3, ufl.det(C) / q**3),
        )
        self._C = C
        a, b = self._a, self._b
        # The largest |eta| is at most 2 sqrt(a/3).
        self._are_close = ufl.lt(a, 0.75 * _CLOSE**2)
        close_a, close_b = (ufl.conditional(self._are_close, x, 0.0) for x in (a, b))
        self._sums = [3.0, 0.0, 2 * close_a]
        for n in range(3, self._num_close + 1):
            self._sums.append(close_a * self._sums[n - 2] + close_b * self._sums[n - 3])
        a, b = ufl.conditional(self._are_close, 1.0, a), ufl.conditional(self._are_close, 0.0, b)
        cosine = b / 2 * (3 / a) ** 1.5
        sign = ufl.conditional(ufl.lt(cosine, 0), -1.0, 1.0)
        eta = 2 * sign * ufl.sqrt(a / 3) * _trisected(sign * cosine)
        mean = 1 - eta / 2
        square = (a - 0.75 * eta**2) / mean**2
        self._are_pair = ufl.lt(square, _PAIR)
        self._pair_square = ufl.conditional(self._are_pair, square, 0.0)
        apart = ufl.sqrt(ufl.conditional(self._are_pair, 0.25, square))
        # Exponentials of logarithms are cheaper to differentiate than powers.
        numbers = (self._volume, 1 + eta, mean, 1 + apart, 1 - apart)
        self._logarithms = [ufl.ln(x) for x in numbers]

    def powers(self, alpha: Any) -> Any:
        r"""Sum :math:`\sum_k \bar\lambda_k^\alpha`, UFL.

        Args:
            alpha: One of the exponents, a number or a UFL constant.
        """
        beta = alpha / 2
        factor, close = beta, 3.0
        for n in range(2, self._num_close + 1):
            factor = factor * (beta - (n - 1)) / n
            close = close + factor * self._sums[n]
        series = 1.0
        for n in reversed(range(2, self._num_pair * 2 + 1, 2)):
            ratio = (beta - (n - 2)) * (beta - (n - 1)) / (n * (n - 1))
            series = 1 + ratio * self._pair_square * series
        volume, alone, mean, *both = self._logarithms
        apart = sum(ufl.exp(beta * x) for x in both)
        pair = ufl.exp(beta * mean) * ufl.conditional(self._are_pair, 2 * series, apart)
        total = ufl.conditional(self._are_close, close, ufl.exp(beta * alone) + pair)
        return ufl.exp(-beta / 3 * volume) * total

    def gradient(self, value: Any) -> Any:
        """Derivative with respect to C of a function of `powers`, UFL (3, 3).

        Args:
            value: The function, UFL scalar.
        """
        q, D, one = ufl.tr(self._C) / 3, ufl.dev(self._C), ufl.Identity(3)
        a, b, volume = self._a, self._b, self._volume
        by_a = D / q**2 - 2 * a / (3 * q) * one
        by_b = D * D / q**3 - (2 * a / 3 + b) / q * one
        by_volume = ufl.cofac(self._C) / q**3 - volume / q * one
        slopes = (ufl.diff(value, x) for x in (a, b, volume))
        return sum(s * by for s, by in zip(slopes, (by_a, by_b, by_volume), strict=True))


def _trisected(cosine: Any) -> Any:
    """Cosine of a third of an angle, from the cosine of the angle between 0 and 1, UFL."""
    t = 0.0
    for coefficient in _START:
        t = t * cosine + coefficient
    for _ in range(_NEWTON):
        t = (8 * t**3 + cosine) / (12 * t**2 - 3)
    return t


def _num_terms(beta: float, step: int, argument: float) -> int:
    """Number of terms of the binomial series, for accurate second derivatives.

    Args:
        beta: Exponent.
        step: 1 for all terms, from the second on; 2 for even ones.
        argument: Largest number [-] whose powers the coefficients multiply.
    """
    n, size = 2 // step, 1.0
    while True:
        for k in range(n * step + 1, (n + 1) * step + 1):
            size *= abs(beta - k + 1) / k
        n += 1
        size *= argument
        if n * (n - 1) * size <= _ROUND_OFF:
            return n
