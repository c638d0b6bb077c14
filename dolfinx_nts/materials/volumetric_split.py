"""Volumetric and isochoric parts of a strain energy, integrated with different quadratures.

Hexahedra of degree 1 lock in nearly incompressible materials: with 2 x 2 x 2 points they can hardly
deform at constant volume. One point for volumetric terms prevents this (Malkus and Hughes, 1978),
and all points for the other terms prevent zero-energy modes. The single point uses the mean
deformation gradient of the cell, see `with_mean_gradients`.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import ufl

from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.materials.strain_energy import StrainEnergy

__all__ = ["Part", "parts"]


class Part(NamedTuple):
    """A subset of the terms of a strain energy.

    Attributes:
        law: A material with these terms.
        left_out: Names of its parameters that are set to zero.
    """

    law: Hyperelastic
    left_out: Iterable[str]


class _PartOfEnergy(Hyperelastic):
    """Material with a part of the energy of another one, and its damping. Local.

    Args:
        material: The material, which has been checked.
        psi: Strain energy density of the part, see `Hyperelastic`.
    """

    def __init__(self, material: Hyperelastic, psi: Callable[..., Any]) -> None:
        StrainEnergy.__init__(self, psi, material.parameters)
        self.rho = material.rho
        self.one_point, self.splits_volume, self.has_default_rule = frozenset(), False, True
        self.mass_damping = material.mass_damping
        self.stiffness_damping = material.stiffness_damping


def parts(material: Hyperelastic, splits: bool) -> tuple[Part, Part | None]:
    """Split the energy of a material into terms with different quadratures. Local.

    Args:
        material: The material.
        splits: Whether volumetric terms have one point, see `Body.splits_volume`.

    Returns:
        Terms with all quadrature points of a cell; terms with one point, or None.
    """
    names = material.one_point if splits or not material.splits_volume else frozenset()
    elsewhere = material.remembered_terms
    if names:
        return Part(material, names | elsewhere), Part(material, material.parameters.keys() - names)
    if splits:
        return Part(_isochoric(material), ()), Part(_volumetric(material), ())
    return Part(material, elsewhere), None


def _at_equal_volume(C: Any) -> Any:
    """Multiple of the identity with the same determinant, UFL (3, 3)."""
    return ufl.det(C) ** (1 / 3) * ufl.Identity(3)


def _volumetric(material: Hyperelastic) -> Hyperelastic:
    """Material with the energy of a uniform change of volume alone."""
    return _PartOfEnergy(
        material, lambda C, **numbers: material.psi(_at_equal_volume(C), **numbers)
    )


def _isochoric(material: Hyperelastic) -> Hyperelastic:
    """Material with the energy minus the energy of the volume change alone."""

    def psi(C: Any, **numbers: Any) -> Any:
        return material.psi(C, **numbers) - material.psi(_at_equal_volume(C), **numbers)

    return _PartOfEnergy(material, psi)
