r"""Hyperelastic materials: strain energy psi(C), stress, conserving stress.

Pure UFL. ``C`` is the right Cauchy-Green tensor and ``psi`` the strain
energy per reference volume; bodies turn both into forms. A material's
numbers reach the forms as constants, so a change of a number compiles
nothing.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import ufl

__all__ = ["Hyperelastic", "SaintVenantKirchhoff"]

# Gauss points and weights of the average over [0, 1].
_POINTS = 0.5 + 0.5 * np.sqrt(0.6) * np.array([-1.0, 0.0, 1.0])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18
# Above this |dC| the quadrature of the average leaves a defect, which is
# corrected; below it the correction would be round-off divided by |dC|.
_SMALL_STRAIN_INCREMENT = 1e-2


class Hyperelastic:
    """A material given by its strain energy.

    Args:
        psi: Strain energy density ``psi(C, **parameters)`` [J/m^3] of the
            right Cauchy-Green tensor, a UFL scalar, twice
            differentiable.
        rho: Reference density [kg/m^3].
        **parameters: Numbers that ``psi`` takes by keyword.

    Raises:
        ValueError: ``rho`` or a parameter is not a finite number, ``rho``
            is not positive, or ``psi`` is not scalar.
    """

    def __init__(self, psi: Callable[..., Any], *, rho: float, **parameters: float) -> None:
        """Check the numbers and that the energy is a scalar."""
        for name, value in (("rho", rho), *parameters.items()):
            if not np.isfinite(value):
                raise ValueError(f"expected a finite number for {name}, given {value}")
        if rho <= 0:
            raise ValueError(f"expected a density rho > 0, given {rho}")
        self.rho = float(rho)
        self.parameters = {name: float(value) for name, value in parameters.items()}
        self._psi = psi
        shape = ufl.as_ufl(psi(ufl.Identity(3), **self.parameters)).ufl_shape
        if shape != ():
            raise ValueError(f"expected a scalar strain energy psi(C), given shape {shape}")

    def psi(self, C: Any, **parameters: Any) -> Any:
        """Strain energy per reference volume [J/m^3], a UFL scalar."""
        return self._psi(C, **parameters)

    def stress(self, C: Any, **parameters: Any) -> Any:
        """Second Piola-Kirchhoff stress S = 2 d psi/d C [Pa], UFL (3, 3)."""
        C = ufl.variable(C)
        return 2 * ufl.diff(self.psi(C, **parameters), C)

    def conserving_stress(self, C_n: Any, C: Any, **parameters: Any) -> Any:
        r"""Stress whose work in a step is the change of the strain energy.

        :math:`S : (C_{n+1} - C_n)/2 = \psi_{n+1} - \psi_n`. The average of
        the stress on the straight path, by three Gauss points, plus the
        correction along dC of Gonzalez (2000) where dC is large enough
        to need it (there is no 0/0 where C rests).

        Args:
            C_n: Right Cauchy-Green tensor at t_n, UFL (3, 3).
            C: The same at t_{n+1}.
            **parameters: Numbers of the energy.

        Returns:
            Stress [Pa], UFL (3, 3).
        """
        dC = C - C_n
        S = sum(
            w * self.stress(C_n + s * dC, **parameters)
            for s, w in zip(_POINTS, _WEIGHTS, strict=True)
        )
        square = ufl.inner(dC, dC)
        defect = self.psi(C, **parameters) - self.psi(C_n, **parameters) - ufl.inner(S, dC) / 2
        large = ufl.gt(square, _SMALL_STRAIN_INCREMENT**2)
        safe = ufl.conditional(large, square, 1.0)
        return S + ufl.conditional(large, 2 * defect / safe, 0.0) * dC


class SaintVenantKirchhoff(Hyperelastic):
    r"""St. Venant-Kirchhoff material, S = lambda tr(E) 1 + 2 mu E.

    Args:
        E: Young's modulus [Pa].
        nu: Poisson's ratio [-].
        rho: Reference density [kg/m^3].

    Raises:
        ValueError: ``E`` or ``rho`` is not positive, or ``nu`` is not in
            (-1, 0.5).
    """

    def __init__(self, E: float, nu: float, rho: float) -> None:
        """Check the numbers and convert them to Lame's."""
        if not (np.isfinite(E) and E > 0):
            raise ValueError(f"expected Young's modulus E > 0, given {E}")
        if not -1 < nu < 0.5:
            raise ValueError(f"expected Poisson's ratio -1 < nu < 0.5, given {nu}")
        lmbda = E * nu / ((1 + nu) * (1 - 2 * nu))
        super().__init__(_saint_venant_kirchhoff, rho=rho, lmbda=lmbda, mu=E / (2 * (1 + nu)))

    def stress(self, C: Any, **parameters: Any) -> Any:
        """Second Piola-Kirchhoff stress [Pa], UFL (3, 3)."""
        E_GL = (C - ufl.Identity(3)) / 2
        lmbda, mu = parameters["lmbda"], parameters["mu"]
        return lmbda * ufl.tr(E_GL) * ufl.Identity(3) + 2 * mu * E_GL

    def conserving_stress(self, C_n: Any, C: Any, **parameters: Any) -> Any:
        """Stress at the mean of both tensors: exact, as psi is quadratic in C."""
        return self.stress((C_n + C) / 2, **parameters)


def _saint_venant_kirchhoff(C: Any, lmbda: Any, mu: Any) -> Any:
    E_GL = (C - ufl.Identity(3)) / 2
    return lmbda / 2 * ufl.tr(E_GL) ** 2 + mu * ufl.inner(E_GL, E_GL)
