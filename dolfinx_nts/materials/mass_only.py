"""The inertia of a material, for bodies that integrate it apart from the energy."""

from typing import Any

import ufl

from dolfinx_nts.materials.hyperelastic import Hyperelastic

__all__ = ["MassOnly"]


class MassOnly(Hyperelastic):
    """Inertia and mass damping of a material, without its stress. Local.

    Bodies need it where inertia and energy have quadratures of their own.

    Args:
        material: The material.
    """

    def __init__(self, material: Hyperelastic) -> None:
        """Take over density and mass damping; the energy is zero."""
        super().__init__(
            lambda C, **parameters: ufl.zero(),
            rho=material.rho,
            mass_damping=material.mass_damping,
            one_point=(),
        )

    def stress(self, *strains: Any, **parameters: Any) -> Any:
        """Zero in the place of any stress, UFL (3, 3)."""
        return ufl.zero(3, 3)

    conserving_stress = linear_stress = stress
