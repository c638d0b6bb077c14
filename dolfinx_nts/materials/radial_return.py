r"""Radial return: plastic flow in a step.

With the isochoric part :math:`\bar C = J^{-2/3} C` of the deformation and the metric G, which is
:math:`C_p^{-1}` of the plastic deformation, the product :math:`M = \bar C G` has the invariants of
the elastic left Cauchy-Green tensor, and :math:`q = \sqrt{3/2}\, \mu\, |\mathrm{dev}\, M|` is the
von Mises stress (Kirchhoff). If the trial state, with the metric at the start of the step, has
:math:`q > \sigma_y(\alpha_n)`, the deviator is scaled by :math:`t = 1 - 3 \mu s \Delta\alpha/q`,
with the increment of the equivalent plastic strain of :math:`t q = \sigma_y(\alpha_n +
\Delta\alpha)` (Simo and Hughes 1998, box 9.1). s is the mean along the return of the rate :math:`I
+ 3 \det \mathrm{dev}\, M/|\mathrm{dev}\, M|^2`, :math:`I = \mathrm{tr}\, M/3`, by which the
deviator of :math:`\dot G = -2 \dot\gamma\, G N` falls, N its direction. The trace follows from the
condition that det G is constant:

.. math:: G_{n+1} = t\, G_n + (I' - t I)\, \bar C^{-1}, \qquad
   I'^3 - \tfrac12 t^2 |\mathrm{dev}\, M|^2\, I' + t^3 \det \mathrm{dev}\, M = \det M,

where :math:`|\mathrm{dev}\, M|^2 = \mathrm{dev}\, M : \mathrm{dev}\, M^T`.
"""

from functools import cached_property
from typing import Any

import ufl

from dolfinx_nts.materials.hardening import Hardening

__all__ = ["RadialReturn"]

# Numbers of Newton iterations [-] after which the equations at a point are solved to round-off. The
# equation of the increment is linear without saturation; the initial error of the trace is of the
# order of the squared elastic strain.
_OF_INCREMENT, _OF_TRACE = 5, 5


class RadialReturn:
    """Plastic flow at a point, from the metric and the plastic strain at the start. Local.

    Args:
        C: Right Cauchy-Green tensor at which plastic flow is evaluated, UFL (3, 3).
        metric: Inverse of the plastic right Cauchy-Green tensor at the start, UFL (3, 3).
        alpha: Equivalent plastic strain at the start [-], UFL.
        mu: Shear modulus [Pa], UFL.
        hardening: Yield stress by plastic strain, with constants of UFL.

    Attributes:
        increment: Increment of the equivalent plastic strain [-], 0 in elastic steps.
        factor: Ratio of the deviatoric stress to the trial stress [-].
    """

    def __init__(self, C: Any, metric: Any, alpha: Any, mu: Any, hardening: Hardening) -> None:
        self._C, self._metric = ufl.det(C) ** (-1 / 3) * C, metric
        self._product = self._C * metric
        self._mean = ufl.tr(self._product) / 3
        self._deviator = self._product - self._mean * ufl.Identity(3)
        self._square = ufl.inner(self._deviator, self._deviator.T)
        self._volume = ufl.det(self._product)
        self._root = self._volume ** (1 / 3)
        square, least = 1.5 * mu**2 * self._square, hardening.stress(alpha)
        # In elastic steps the root is 0, and the argument of the square root is kept positive.
        q = ufl.sqrt(ufl.conditional(ufl.gt(square, least**2), square, least**2))
        # Starting value: the trace without elastic strain.
        skew = 3 * ufl.det(self._deviator) * 1.5 * mu**2 / q**2
        rates = self._mean + self._root, skew * (1 + least / q)
        slope = 1.5 * mu * sum(rates)
        x = (q - least) / (slope + hardening.slope(alpha))
        for _ in range(_OF_INCREMENT if hardening.saturates else 0):
            rest = q - slope * x - hardening.stress(alpha + x)
            x += rest / (slope + hardening.slope(alpha + x))
        self.increment, self.factor = x, 1 - slope * x / q

    @cached_property
    def metric(self) -> Any:
        """Metric at the end of the step, UFL (3, 3)."""
        t, mean = self.factor, self._root
        square, rest = t**2 * self._square, t**3 * ufl.det(self._deviator) - self._volume
        for _ in range(_OF_TRACE):
            mean -= (mean**3 - square * mean / 2 + rest) / (3 * mean**2 - square / 2)
        shift = ufl.conditional(ufl.gt(self.increment, 0), mean - t * self._mean, 0)
        return t * self._metric + shift * ufl.inv(self._C)
