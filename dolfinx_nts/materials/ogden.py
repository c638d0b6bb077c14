"""Ogden material, with powers of the principal stretches.

The isochoric part of the conserving stress is the average of `Hyperelastic`, as a discrete gradient
of functions of eigenvalues has no closed form. The volumetric part, which is much stiffer in
rubber, has a closed form.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import ufl

from dolfinx_nts.common.arguments import finite, positive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.materials.principal_stretches import PrincipalStretches
from dolfinx_nts.materials.strain_energy import strain_basis
from dolfinx_nts.materials.volume_increment import VolumeIncrement

__all__ = ["Ogden"]


class Ogden(Hyperelastic):
    r"""Ogden material for rubber, with powers of the isochoric principal stretches. Local.

    :math:`\psi = \sum_p \mu_p/\alpha_p\, (\bar\lambda_1^{\alpha_p} + \bar\lambda_2^{\alpha_p} +
    \bar\lambda_3^{\alpha_p} - 3) + \kappa/2\, (J - 1)^2` with :math:`\bar\lambda_k = J^{-1/3}
    \lambda_k` (Ogden 1972). The shear modulus of small strains is
    :math:`\mu = \sum_p \mu_p \alpha_p/2`. In codes with the prefactor :math:`2 \mu_p/\alpha_p^2`,
    the parameter is :math:`\mu_p \alpha_p/2` of this class.

    Args:
        mu: Coefficients of the terms [Pa].
        alpha: Exponents of the terms [-], the same number.
        kappa: Bulk modulus [Pa]. A Poisson's ratio nu of small strains needs
            2 mu (1 + nu)/(3 (1 - 2 nu)).
        rho: Reference density [kg/m^3].
        **options: Damping, quadrature and branches, as for `Hyperelastic`.

    Attributes:
        mu, alpha: As given, tuples.

    Raises:
        TypeError: ``mu`` or ``alpha`` is not a sequence of numbers.
        ValueError: There are no terms, or not as many of both; a number is not finite, an
            exponent zero; the shear modulus, ``kappa`` or ``rho`` is not positive.

    Example:
        >>> rubber = nts.Ogden(  # Treloar's rubber, Ogden (1972), nearly incompressible
        ...     mu=(6.3e5, 1.2e3, -1.0e4), alpha=(1.3, 5.0, -2.0), kappa=2.1e8, rho=1.0e3
        ... )
        >>> round(rubber.least_modulus), round(rubber.poisson_ratio, 3)  # twice the shear modulus
        (845000, 0.499)
    """

    def __init__(
        self,
        mu: Sequence[float],
        alpha: Sequence[float],
        kappa: float,
        rho: float,
        **options: Any,
    ) -> None:
        self.mu, self.alpha = _numbers("mu", mu), _numbers("alpha", alpha)
        if not len(self.mu) == len(self.alpha) > 0:
            raise ValueError(
                "expected as many mu as alpha, at least one, given "
                f"{len(self.mu)} and {len(self.alpha)}"
            )
        if 0.0 in self.alpha:
            raise ValueError(f"expected exponents alpha other than 0, given {self.alpha}")
        terms = list(zip(self.mu, self.alpha, strict=True))
        positive("the shear modulus sum(mu * alpha) / 2", _shear_modulus(terms))
        positive("kappa", kappa)
        numbers = {"kappa": kappa}
        for p, term in enumerate(terms, start=1):
            numbers |= zip(_names(p), term, strict=True)
        super().__init__(self._energy, rho=rho, **(numbers | options))

    def _described(self) -> dict[str, Any]:
        return {"mu": self.mu, "alpha": self.alpha, "kappa": self.parameters["kappa"]}

    def _volumetric_parameters(self) -> frozenset[str]:
        return frozenset(["kappa"])

    def check(self) -> None:
        """Do nothing: all Ogden energies have moduli and no stress at C = 1."""

    @property
    def moduli(self) -> Floats:
        mu, kappa = _shear_modulus(self._terms(self.parameters)), self.parameters["kappa"]
        volume = np.einsum("aii->a", strain_basis())
        moduli: Floats = 2 * mu * np.eye(6) + (kappa - 2 * mu / 3) * np.outer(volume, volume)
        return moduli

    @property
    def resists_collapse(self) -> bool:
        """False, as the energy of a vanishing volume is finite."""
        return False

    def stress(self, C: Any, **parameters: Any) -> Any:
        numbers = self.parameters | parameters
        S = numbers["kappa"] * (1 - 1 / ufl.sqrt(ufl.det(C))) * ufl.cofac(C)
        if terms := self._terms(numbers):
            stretches = PrincipalStretches(C, self.alpha)
            S += 2 * stretches.gradient(_isochoric(stretches, terms))
        return S

    def linear_stress(self, E_GL: Any, **parameters: Any) -> Any:
        numbers = self.parameters | parameters
        mu = _shear_modulus(self._terms(numbers))
        return numbers["kappa"] * ufl.tr(E_GL) * ufl.Identity(3) + 2 * mu * ufl.dev(E_GL)

    def conserving_stress(self, C_n: Any, C: Any, **parameters: Any) -> Any:
        numbers = self.parameters | parameters
        volume = VolumeIncrement(C_n, C)
        S = numbers["kappa"] * (1 - 2 / volume.sum) * volume.gradient
        if self._terms(numbers):
            S += super().conserving_stress(C_n, C, **(parameters | {"kappa": 0.0}))
        return S

    def _check_parts(self) -> None:
        """Raise unless the energy is linear in the parameters of one-point terms."""
        exponents = {name for p in range(len(self.alpha)) for name in _names(p + 1)[1:]}
        if given := sorted(self.one_point & exponents):
            raise ValueError(
                "expected an energy that is linear in its parameters for one_point, given "
                f"exponents, {given}"
            )

    def _energy(self, C: Any, **numbers: Any) -> Any:
        psi = numbers["kappa"] / 2 * (ufl.sqrt(ufl.det(C)) - 1) ** 2
        if terms := self._terms(numbers):
            psi += _isochoric(PrincipalStretches(C, self.alpha), terms)
        return psi

    def _terms(self, numbers: Any) -> list[tuple[Any, Any]]:
        """Coefficient and exponent of each term that is not omitted."""
        terms = [[numbers[name] for name in _names(p)] for p in range(1, len(self.mu) + 1)]
        # Python zeros mark omitted terms.
        return [(mu, alpha) for mu, alpha in terms if not _is_zero(mu) and not _is_zero(alpha)]


def _names(p: int) -> tuple[str, str]:
    """Parameter names of the coefficient and exponent of a term."""
    return f"mu_{p}", f"alpha_{p}"


def _numbers(name: str, values: Any) -> tuple[float, ...]:
    if isinstance(values, str) or not isinstance(values, Sequence | np.ndarray):
        raise TypeError(f"expected {name} as a sequence of numbers, given {values!r}")
    return tuple(finite(name, value) for value in values)


def _is_zero(number: Any) -> bool:
    return isinstance(number, float) and number == 0.0


def _shear_modulus(terms: Iterable[tuple[Any, Any]]) -> Any:
    """Shear modulus of small strains [Pa]."""
    return sum(mu * alpha for mu, alpha in terms) / 2


def _isochoric(stretches: PrincipalStretches, terms: list[tuple[Any, Any]]) -> Any:
    """Isochoric energy [J/m^3], UFL."""
    return sum(mu / alpha * (stretches.powers(alpha) - 3) for mu, alpha in terms)
