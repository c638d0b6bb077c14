"""The material of rigid bodies, which have inertia and no deformation."""

import math
from typing import Any

import ufl

from dolfinx_nts.materials.hyperelastic import Hyperelastic

__all__ = ["Rigid"]


def _none(C: Any, **parameters: Any) -> Any:
    """Strain energy of what does not deform."""
    return ufl.zero()


class Rigid(Hyperelastic):
    """Inertia without strain energy. Local.

    Args:
        rho: Reference density [kg/m^3].

    Raises:
        ValueError: The density is not positive and finite.
    """

    # It is stiffer than any other material, and cannot be squashed.
    least_modulus = math.inf
    resists_collapse = True

    def __init__(self, rho: float) -> None:
        """Check the density."""
        super().__init__(_none, rho=rho, one_point=())
        self._has_default = True

    def _described(self) -> dict[str, Any]:
        return {}

    def stress(self, *strains: Any, **parameters: Any) -> Any:
        """Zero in the place of any stress, UFL (3, 3)."""
        return ufl.zero(3, 3)

    conserving_stress = linear_stress = stress
