"""Strain energies psi(C), and their properties in the undeformed state."""

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property, lru_cache, partial
from itertools import combinations_with_replacement
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives
from ufl.domain import extract_domains

from dolfinx_nts.common.arguments import is_of_package
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.materials.energy_curve import EnergyCurve, energy_of_symbols
from dolfinx_nts.materials.evaluation import Evaluation

__all__ = ["STRETCHES", "StrainEnergy", "are_pressures", "poisson_ratios", "strain_basis"]

# Positions of the strains 11, 22 and 33 in `strain_basis`, and in `StrainEnergy.moduli`.
STRETCHES = [0, 3, 5]

# Relative round-off of eigenvalues of moduli [-].
_ROUND_OFF = 1e-10
# Largest stress in the undeformed state, relative to the moduli [-], that rounded parameters may
# cause.
_NO_STRESS = 1e-6
# Values s [-] for a test whether a material resists collapse, by its energy at C = s 1: from the
# first to the second value ln J doubles, and a bounded energy hardly changes.
_COLLAPSED, _GROWTH = (1e-8, 1e-4), 1.5


class StrainEnergy(Declaration):
    """A strain energy and its parameters. Local.

    Args:
        psi: Strain energy density ``psi(C, **parameters)`` [J/m^3] of the right Cauchy-Green
            tensor, a UFL scalar.
        parameters: Keyword arguments of ``psi``, numbers.

    Attributes:
        parameters: Numbers by name, read-only.
        remembered_terms: Names of parameters whose terms depend on history variables, which
            steppers integrate separately.
    """

    remembered_terms: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, psi: Callable[..., Any], parameters: Mapping[str, float]) -> None:
        self.parameters = MappingProxyType({name: float(x) for name, x in parameters.items()})
        self._psi = psi

    def psi(self, C: Any, **parameters: Any) -> Any:
        """Strain energy per reference volume.

        Args:
            C: Right Cauchy-Green tensor, UFL (3, 3).
            **parameters: Parameters of the energy by name, in place of those of the material.

        Returns:
            Energy [J/m^3], a UFL scalar.
        """
        return self._psi(C, **self.parameters | parameters)

    def value(self, C: Any, without: Iterable[str] = ()) -> float:
        """Energy [J/m^3] of a constant tensor, UFL (3, 3), with some parameters set to zero."""
        parameters = dict(self.parameters) | dict.fromkeys(without, 0.0)
        value: Callable[..., float] = _known_value if self._is_of_package else _value
        return value(self._psi if self._is_of_package else self.psi, C, *parameters.items())

    @cached_property
    def has_fields(self) -> bool:
        """Whether the energy contains Functions or coordinates, and thus varies in space."""
        # A variable, as entries of the identity are numbers, which may cancel a field.
        return bool(extract_domains(ufl.as_ufl(self.psi(ufl.variable(ufl.Identity(3))))))

    def check(self) -> None:
        """Check the energy in the undeformed state.

        Raises:
            TypeError: The energy is not a UFL expression of C, or converts C to numbers.
            ValueError: The energy is not a scalar; or, without fields, is not twice differentiable,
                has a stress or no minimum there, or does not resist a change of volume.
        """
        if (shape := energy_of_symbols(self.psi).ufl_shape) != ():
            raise ValueError(f"expected a scalar strain energy psi(C), given shape {shape}")
        if self.has_fields:
            return
        try:
            self._curve.check()
        except (ArithmeticError, TypeError, ValueError) as error:
            raise ValueError(
                f"expected psi(C) twice differentiable at C = 1, given {error}"
            ) from error
        basis = strain_basis()
        S = sum(2 * self._curve.slope(D) * D for D in basis)
        moduli = [4 * self._curve.curvature(D) for D in basis]
        if np.abs(S).max() > _NO_STRESS * np.abs(moduli).max():
            rows = [[float(f"{value:.4g}") for value in row] for row in S]
            raise ValueError(
                f"expected psi(C) without stress at C = 1, given S = {rows} Pa: an undeformed body "
                "would deform without loads; add a term that cancels this stress, as - mu ln J "
                "does for mu/2 tr C"
            )
        if not self._is_stable:
            raise ValueError(
                "expected psi(C) with a minimum at C = 1, given moduli with a negative eigenvalue, "
                f"{np.linalg.eigvalsh(self.moduli)[0]:g} Pa: an undeformed body would collapse; "
                "check the signs of its terms"
            )
        volume = np.einsum("aii->a", basis)
        if volume @ self.moduli @ volume < _ROUND_OFF * np.trace(self.moduli):
            raise ValueError(
                "expected psi(C) that resists a change of volume, given a bulk modulus of 0: a "
                "body would be compressed without resistance; add a term such as "
                "kappa / 8 * ufl.ln(ufl.det(C)) ** 2"
            )

    @cached_property
    def moduli(self) -> Floats:
        """Moduli 4 psi''(1) of strains 11, 12, 13, 22, 23, 33, shape ``(6, 6)`` [Pa].

        The basis is orthonormal: strains 12, 13 and 23 have a factor of sqrt(2). Only for energies
        without fields.
        """
        basis = strain_basis()
        curvature = np.zeros((6, 6))
        for i, j in combinations_with_replacement(range(6), 2):
            curvature[i, j] = curvature[j, i] = self._curve.curvature(basis[i] + basis[j])
        diagonal = np.diag(curvature) / 4
        moduli: Floats = 2 * (curvature - diagonal[:, None] - diagonal)
        return moduli

    @cached_property
    def least_modulus(self) -> float:
        """Smallest eigenvalue of `moduli`, at least 0; NaN for energies with fields [Pa].

        For an isotropic material it is twice the shear modulus.
        """
        if self.has_fields:
            return np.nan
        return max(float(np.linalg.eigvalsh(self.moduli)[0]), 0.0)

    @property
    def _is_stable(self) -> bool:
        """Whether no small strain has a negative energy. Only for energies without fields."""
        least, most = np.linalg.eigvalsh(self.moduli)[[0, -1]]
        return bool(least >= -_ROUND_OFF * max(most, -least))

    @property
    def poisson_ratio(self) -> float:
        """Poisson's ratio of small strains [-]; NaN for energies with fields.

        For an anisotropic material it is the value of the nearest isotropic material.
        """
        if self.has_fields:
            return np.nan
        return float(poisson_ratios(self.moduli))

    @property
    def resists_collapse(self) -> bool:
        """Whether the energy grows without bound as the volume vanishes.

        True for energies with fields, which are not evaluated.
        """
        if self.has_fields:
            return True
        at = [ufl.as_matrix((scale * np.eye(3)).tolist()) for scale in _COLLAPSED]
        smaller, small = map(self.value, at)
        return smaller > _GROWTH * small

    @cached_property
    def _curve(self) -> EnergyCurve:
        curve: Callable[..., EnergyCurve] = _known_curve if self._is_of_package else _curve
        return curve(self._psi if self._is_of_package else self.psi, *self.parameters.items())

    @property
    def _is_of_package(self) -> bool:
        """Whether psi is a function of the package, which depends only on its arguments.

        Its properties are then cached for materials with the same parameters. User-defined energies
        may depend on other data.
        """
        return is_of_package(self._psi) and type(self).psi is StrainEnergy.psi


def _curve(psi: Callable[..., Any], *parameters: tuple[str, float]) -> EnergyCurve:
    return EnergyCurve(partial(psi, **dict(parameters)))


def _value(psi: Callable[..., Any], C: Any, *parameters: tuple[str, float]) -> float:
    energy = ufl.as_ufl(psi(C, **dict(parameters)))
    return Evaluation(expand_derivatives(energy)).value({})


_known_curve = lru_cache(maxsize=256)(_curve)
_known_value = lru_cache(maxsize=256)(_value)


def poisson_ratios(moduli: Floats) -> Floats:
    """Poisson's ratios [-] of the nearest isotropic moduli, for moduli ``(..., 6, 6)``. Local."""
    bulk = _of_volume(moduli) @ np.einsum("aii->a", strain_basis()) / 9
    shear = (np.trace(moduli, axis1=-2, axis2=-1) - 3 * bulk) / 10
    ratios: Floats = (3 * bulk - 2 * shear) / (2 * (3 * bulk + shear))
    return ratios


def are_pressures(moduli: Floats) -> Flags:
    """Whether a small volume change causes only a pressure, for moduli ``(..., 6, 6)``. Local."""
    volume, stress = np.einsum("aii->a", strain_basis()), _of_volume(moduli)
    rest = stress - (stress @ volume / 3)[..., None] * volume
    flags: Flags = np.abs(rest).max(axis=-1) <= _NO_STRESS * np.abs(moduli).max(axis=(-2, -1))
    return flags


def _of_volume(moduli: Floats) -> Floats:
    """Stress of a small uniform change of volume, ``(..., 6)`` [Pa]."""
    stress: Floats = moduli @ np.einsum("aii->a", strain_basis())
    return stress


def strain_basis() -> Floats:
    """Orthonormal basis of the symmetric tensors, shape ``(6, 3, 3)``. Local."""
    basis = np.zeros((6, 3, 3))
    for D, (i, j) in zip(basis, combinations_with_replacement(range(3), 2), strict=True):
        D[i, j] = D[j, i] = 1.0 if i == j else np.sqrt(0.5)
    return basis
