"""Named materials: strain energies psi(C) with their usual parameters.

Everything is UFL. Stresses, moduli, damping and quadrature are inherited from `Hyperelastic`, and
all classes take its options.
"""

from typing import Any

import ufl

from dolfinx_nts.common.arguments import positive, real
from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.materials.volume_increment import VolumeIncrement

__all__ = ["MooneyRivlin", "NeoHookean", "SaintVenantKirchhoff", "Yeoh"]


class SaintVenantKirchhoff(Hyperelastic):
    r"""Saint Venant-Kirchhoff material, for large rotations and small strains. Local.

    :math:`\psi = \lambda/2\, (\mathrm{tr}\, \varepsilon)^2 + \mu\, \varepsilon : \varepsilon`,
    so that :math:`S = \lambda\, \mathrm{tr}(\varepsilon)\, 1 + 2 \mu\, \varepsilon`, with the
    Green-Lagrange strain :math:`\varepsilon = (C - 1)/2`. The energy stays finite where the volume
    vanishes.

    Args:
        E: Young's modulus [Pa].
        nu: Poisson's ratio [-].
        rho: Reference density [kg/m^3].
        **options: Damping and quadrature, as for `Hyperelastic`.

    Raises:
        ValueError: ``E`` or ``rho`` is not positive, or ``nu`` is not in (-1, 0.5).

    Example:
        >>> nts.SaintVenantKirchhoff(E=1.0e5, nu=0.4, rho=1.0e3)  # Pa, -, kg/m^3
        SaintVenantKirchhoff(E=100000, nu=0.4, rho=1000)
    """

    def __init__(self, E: float, nu: float, rho: float, **options: Any) -> None:
        super().__init__(_saint_venant_kirchhoff, rho=rho, **(_lame(E, nu) | options))

    def _volumetric_parameters(self) -> frozenset[str]:
        return frozenset(["lmbda"])

    def _described(self) -> dict[str, Any]:
        return _young(**self.parameters)

    def stress(self, C: Any, **parameters: Any) -> Any:
        E_GL = (C - ufl.Identity(3)) / 2
        numbers = self.parameters | parameters
        lmbda, mu = numbers["lmbda"], numbers["mu"]
        return lmbda * ufl.tr(E_GL) * ufl.Identity(3) + 2 * mu * E_GL

    def free_thickness(self, C: Any, **parameters: Any) -> Any:
        numbers = self.parameters | parameters
        lmbda, mu = numbers["lmbda"], numbers["mu"]
        return 1 - lmbda / (lmbda + 2 * mu) * (C[0, 0] + C[1, 1] - 2)

    def conserving_stress(self, C_n: Any, C: Any, **parameters: Any) -> Any:
        """Stress at the mean of both tensors; it conserves the energy, as psi is quadratic in C."""
        return self.stress((C_n + C) / 2, **parameters)


class NeoHookean(Hyperelastic):
    r"""Compressible neo-Hookean material, for large strains. Local.

    :math:`\psi = \mu/2\, (\mathrm{tr}\, C - 3) - \mu \ln J + \lambda/2\, U^2` with
    :math:`U = \ln J` (``"log"``) or :math:`U = J - 1` (``"quadratic"``).

    Args:
        E: Young's modulus of small strains [Pa].
        nu: Poisson's ratio of small strains [-].
        rho: Reference density [kg/m^3].
        volumetric: ``"log"`` or ``"quadratic"``.
        **options: Damping and quadrature, as for `Hyperelastic`.

    Attributes:
        volumetric: As given.

    Raises:
        ValueError: ``E`` or ``rho`` is not positive, ``nu`` is not in (-1, 0.5), or
            ``volumetric`` is unknown.

    Example:
        >>> nts.NeoHookean(E=1.0e5, nu=0.49, rho=1.0e3, one_point=())
        NeoHookean(E=100000, nu=0.49, volumetric='log', rho=1000, one_point=())
    """

    def __init__(
        self, E: float, nu: float, rho: float, volumetric: str = "log", **options: Any
    ) -> None:
        energies = {"log": _neo_hookean_log, "quadratic": _neo_hookean_quadratic}
        if volumetric not in energies:
            raise ValueError(
                f"expected volumetric to be one of {list(energies)}, given {volumetric!r}"
            )
        super().__init__(energies[volumetric], rho=rho, **(_lame(E, nu) | options))
        self.volumetric = volumetric

    def _described(self) -> dict[str, Any]:
        return {**_young(**self.parameters), "volumetric": self.volumetric}

    def free_thickness(self, C: Any, **parameters: Any) -> Any:
        if self.volumetric == "log":
            return None
        numbers = self.parameters | parameters
        lmbda, mu = numbers["lmbda"], numbers["mu"]
        # The stress vanishes where (mu + lmbda j^2) t^2 - lmbda j t - mu = 0.
        j = ufl.sqrt(C[0, 0] * C[1, 1] - C[0, 1] * C[1, 0])
        a = mu + lmbda * j**2
        return ((lmbda * j + ufl.sqrt((lmbda * j) ** 2 + 4 * mu * a)) / (2 * a)) ** 2

    def conserving_stress(self, C_n: Any, C: Any, **parameters: Any) -> Any:
        numbers = self.parameters | parameters
        lmbda, mu = numbers["lmbda"], numbers["mu"]
        volume = VolumeIncrement(C_n, C)
        if self.volumetric == "log":
            ln_J_twice = ufl.ln(volume.square_n * volume.square) / 2
            quotient = volume.logarithm * (lmbda * ln_J_twice / 4 - mu / 2)
        else:
            quotient = lmbda * (1 - 2 / volume.sum) / 2 - mu / 2 * volume.logarithm
        return mu * ufl.Identity(3) + 2 * quotient * volume.gradient


class MooneyRivlin(Hyperelastic):
    r"""Mooney-Rivlin material for rubber, with both isochoric invariants. Local.

    :math:`\psi = c_{10} (\bar I_1 - 3) + c_{01} (\bar I_2 - 3) + \kappa/2\, (J - 1)^2`; the
    shear modulus of small strains is 2 (c10 + c01).

    Args:
        c10: Coefficient of the first invariant [Pa].
        c01: Coefficient of the second invariant [Pa].
        kappa: Bulk modulus [Pa].
        rho: Reference density [kg/m^3].
        **options: Damping and quadrature, as for `Hyperelastic`.

    Raises:
        ValueError: ``c10 + c01``, ``kappa`` or ``rho`` is not positive.

    Example:
        >>> rubber = nts.MooneyRivlin(c10=2.0e4, c01=5.0e3, kappa=1.0e6, rho=1.0e3)
        >>> round(rubber.least_modulus)  # twice the shear modulus [Pa]
        100000
    """

    def __init__(self, c10: float, c01: float, kappa: float, rho: float, **options: Any) -> None:
        positive("c10 + c01", c10 + c01)
        positive("kappa", kappa)
        super().__init__(_mooney_rivlin, rho=rho, c10=c10, c01=c01, kappa=kappa, **options)

    def _described(self) -> dict[str, Any]:
        return dict(self.parameters)

    def conserving_stress(self, C_n: Any, C: Any, **parameters: Any) -> Any:
        numbers = self.parameters | parameters
        volume, mean = VolumeIncrement(C_n, C), (C_n + C) / 2
        (a_n, a), one = volume.roots, ufl.Identity(3)
        first, first_slope = (a_n + a) / 2, volume.root * ufl.tr(mean)
        second = (a_n**2 + a**2) / 2
        second_slope = (a_n + a) * volume.root * (_second(C_n) + _second(C)) / 2
        quotient = (
            numbers["c10"] * first_slope
            + numbers["c01"] * second_slope
            + numbers["kappa"] / 2 * (1 - 2 / volume.sum)
        )
        S = numbers["c10"] * first * one
        S += numbers["c01"] * second * (ufl.tr(mean) * one - mean)
        return 2 * (S + quotient * volume.gradient)


class Yeoh(Hyperelastic):
    r"""Yeoh material for rubber that stiffens, with the first isochoric invariant. Local.

    :math:`\psi = \sum_{i=1}^3 c_{i0} (\bar I_1 - 3)^i + \kappa/2\, (J - 1)^2`; the shear
    modulus of small strains is 2 c10.

    Args:
        c10: Linear coefficient [Pa].
        c20: Quadratic coefficient [Pa].
        c30: Cubic coefficient [Pa].
        kappa: Bulk modulus [Pa].
        rho: Reference density [kg/m^3].
        **options: Damping and quadrature, as for `Hyperelastic`.

    Raises:
        ValueError: ``c10``, ``kappa`` or ``rho`` is not positive.

    Example:
        >>> nts.Yeoh(c10=2.0e4, c20=-2.0e3, c30=1.0e2, kappa=1.0e6, rho=1.0e3)
        Yeoh(c10=20000, c20=-2000, c30=100, kappa=1000000, rho=1000)
    """

    def __init__(
        self, c10: float, c20: float, c30: float, kappa: float, rho: float, **options: Any
    ) -> None:
        positive("c10", c10)
        positive("kappa", kappa)
        super().__init__(_yeoh, rho=rho, c10=c10, c20=c20, c30=c30, kappa=kappa, **options)

    def _described(self) -> dict[str, Any]:
        return dict(self.parameters)

    def conserving_stress(self, C_n: Any, C: Any, **parameters: Any) -> Any:
        numbers = self.parameters | parameters
        volume = VolumeIncrement(C_n, C)
        a_n, a = volume.roots
        x_n, x = a_n * ufl.tr(C_n) - 3, a * ufl.tr(C) - 3
        slope = numbers["c10"] + numbers["c20"] * (x_n + x)
        slope += numbers["c30"] * (x_n**2 + x_n * x + x**2)
        quotient = slope * volume.root * ufl.tr(C_n + C) / 2
        quotient += numbers["kappa"] / 2 * (1 - 2 / volume.sum)
        return 2 * (slope * (a_n + a) / 2 * ufl.Identity(3) + quotient * volume.gradient)


def _lame(E: float, nu: float) -> dict[str, float]:
    """Lame parameters [Pa] from Young's modulus [Pa] and Poisson's ratio [-]."""
    positive("Young's modulus E", E)
    if not -1 < real("nu", nu) < 0.5:
        raise ValueError(f"expected Poisson's ratio -1 < nu < 0.5, given {nu}")
    return {"lmbda": E * nu / ((1 + nu) * (1 - 2 * nu)), "mu": E / (2 * (1 + nu))}


def _young(lmbda: float, mu: float) -> dict[str, float]:
    """Young's modulus [Pa] and Poisson's ratio [-] from Lame parameters [Pa]."""
    return {"E": mu * (3 * lmbda + 2 * mu) / (lmbda + mu), "nu": lmbda / (2 * (lmbda + mu))}


def _saint_venant_kirchhoff(C: Any, lmbda: Any, mu: Any) -> Any:
    E_GL = (C - ufl.Identity(3)) / 2
    return lmbda / 2 * ufl.tr(E_GL) ** 2 + mu * ufl.inner(E_GL, E_GL)


def _neo_hookean_log(C: Any, lmbda: Any, mu: Any) -> Any:
    ln_J = ufl.ln(ufl.det(C)) / 2
    return mu / 2 * (ufl.tr(C) - 3) - mu * ln_J + lmbda / 2 * ln_J**2


def _neo_hookean_quadratic(C: Any, lmbda: Any, mu: Any) -> Any:
    J2 = ufl.det(C)
    return mu / 2 * (ufl.tr(C) - 3 - ufl.ln(J2)) + lmbda / 2 * (ufl.sqrt(J2) - 1) ** 2


def _mooney_rivlin(C: Any, c10: Any, c01: Any, kappa: Any) -> Any:
    J2 = ufl.det(C)
    I1 = J2 ** (-1 / 3) * ufl.tr(C)
    I2 = J2 ** (-2 / 3) * _second(C)
    return c10 * (I1 - 3) + c01 * (I2 - 3) + kappa / 2 * (ufl.sqrt(J2) - 1) ** 2


def _second(C: Any) -> Any:
    """Second invariant of C, UFL."""
    return (ufl.tr(C) ** 2 - ufl.tr(C * C)) / 2


def _yeoh(C: Any, c10: Any, c20: Any, c30: Any, kappa: Any) -> Any:
    J2 = ufl.det(C)
    x = J2 ** (-1 / 3) * ufl.tr(C) - 3
    return c10 * x + c20 * x**2 + c30 * x**3 + kappa / 2 * (ufl.sqrt(J2) - 1) ** 2
