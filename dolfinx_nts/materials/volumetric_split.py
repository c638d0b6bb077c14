"""Parts of a strain energy that are integrated with different quadratures.

Hexahedra of degree 1 lock in nearly incompressible materials: with 2 x 2 x 2 points they can
hardly deform without change of volume. With one point for what resists that change they can
(Malkus and Hughes, 1978), while all points for the rest leave no deformation without energy. The
point has the mean deformation gradient of the cell, see `with_mean_gradients`.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import ufl

from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.materials.strain_energy import StrainEnergy

__all__ = ["Part", "parts"]


class Part(NamedTuple):
    """Some of the terms of a strain energy.

    Attributes:
        law: A material that has them.
        left_out: Names of its parameters that are zero in their place.
    """

    law: Hyperelastic
    left_out: Iterable[str]


class _PartOfEnergy(Hyperelastic):
    """Damping of a material and an energy that is a part of its own. Local.

    Args:
        material: The material, which has been checked.
        psi: Strain energy density of the part, see `Hyperelastic`.
    """

    def __init__(self, material: Hyperelastic, psi: Callable[..., Any]) -> None:
        """Take over all numbers."""
        StrainEnergy.__init__(self, psi, material.parameters)
        self.rho = material.rho
        self.one_point, self.splits_volume, self._has_default = frozenset(), False, True
        self.mass_damping = material.mass_damping
        self.stiffness_damping = material.stiffness_damping


def parts(material: Hyperelastic, locks: bool) -> tuple[Part, Part | None]:
    """Divide the energy of a material by the quadratures of its terms. Local.

    Args:
        material: The material.
        locks: Whether elements lock with all points of the quadrature.

    Returns:
        What is integrated with all points of a cell; and with one, None without such terms.
    """
    names = material.one_point if locks or not material.splits_volume else frozenset()
    elsewhere = material.remembered_terms
    if names:
        return Part(material, names | elsewhere), Part(material, material.parameters.keys() - names)
    if locks and material.splits_volume:
        return Part(_isochoric(material), ()), Part(_volumetric(material), ())
    return Part(material, elsewhere), None


def _at_equal_volume(C: Any) -> Any:
    """The tensor of an equal volume without change of shape, UFL (3, 3)."""
    return ufl.det(C) ** (1 / 3) * ufl.Identity(3)


def _volumetric(material: Hyperelastic) -> Hyperelastic:
    """Material with the energy that an equal change of volume alone has."""
    return _PartOfEnergy(
        material, lambda C, **numbers: material.psi(_at_equal_volume(C), **numbers)
    )


def _isochoric(material: Hyperelastic) -> Hyperelastic:
    """Material with all the other energy."""

    def psi(C: Any, **numbers: Any) -> Any:
        return material.psi(C, **numbers) - material.psi(_at_equal_volume(C), **numbers)

    return _PartOfEnergy(material, psi)
