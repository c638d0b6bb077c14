r"""Thin sheets: materials without stress through their thickness.

The stretch t along z follows from :math:`S_{33} = 0`. The energy then depends on the in-plane part
of C alone, :math:`\psi^*(C) = \min_t \psi(C, t^2)`, and its derivative is the in-plane stress.
Conserving stresses follow as for any energy.
"""

from typing import Any

import ufl

from dolfinx_nts.materials.hyperelastic import Hyperelastic

__all__ = ["PlaneStress"]


class PlaneStress(Hyperelastic):
    r"""Material of a sheet in plane stress, in two dimensions. Local.

    Only materials with a closed-form thickness stretch are accepted. Another material can be given
    as a `Hyperelastic` energy of the in-plane entries of C, which has no stress along z either.
    Forces (also of a `Pressure`), masses and energies are per metre of undeformed thickness.

    Args:
        material: `SaintVenantKirchhoff`, or `NeoHookean` with ``volumetric="quadratic"``. All terms
            use all quadrature points, as sheets do not lock.

    Raises:
        TypeError: ``material`` is not a Hyperelastic.
        ValueError: The material has no closed form of the thickness, or has viscous branches.

    Example:
        >>> nts.PlaneStress(nts.SaintVenantKirchhoff(E=1.0e5, nu=0.4, rho=1.0e3))
        PlaneStress(material=SaintVenantKirchhoff(E=100000, nu=0.4, rho=1000), rho=1000)
    """

    is_sheet = True

    def __init__(self, material: Hyperelastic) -> None:
        if not isinstance(material, Hyperelastic):
            raise TypeError(f"expected a material, given {type(material).__name__}")
        if material.branches:
            raise ValueError(
                f"expected a material without branches in PlaneStress, given {material!r}: the "
                "thickness would also relax; use a body in space or plane strain"
            )
        if material.free_thickness(ufl.Identity(3)) is None:
            raise ValueError(
                "expected SaintVenantKirchhoff, or NeoHookean with volumetric='quadratic', in "
                "PlaneStress, whose thickness has a closed form, given "
                f"{material!r}: Hyperelastic takes an energy of the entries of C in the plane"
            )
        self._material = material
        super().__init__(
            self._psi_of_sheet,
            rho=material.rho,
            mass_damping=material.mass_damping,
            stiffness_damping=material.stiffness_damping,
            one_point=(),
            branches=(),
            **material.parameters,
        )
        self.has_default_rule = True

    def _described(self) -> dict[str, Any]:
        return {"material": self._material}

    @property
    def least_modulus(self) -> float:
        return self._material.least_modulus

    def thickness_stretch(self, C: Any, **parameters: Any) -> Any:
        """Ratio of the current to the undeformed thickness, UFL."""
        return ufl.sqrt(self._material.free_thickness(C, **parameters))

    def _psi_of_sheet(self, C: Any, **parameters: Any) -> Any:
        square = self._material.free_thickness(C, **parameters)
        rows = [[C[0, 0], C[0, 1], 0], [C[1, 0], C[1, 1], 0], [0, 0, square]]
        return self._material.psi(ufl.as_matrix(rows), **parameters)
