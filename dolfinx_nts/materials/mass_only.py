"""Materials with inertia and without stress."""

import math
from typing import Any

import ufl

from dolfinx_nts.materials.hyperelastic import Hyperelastic

__all__ = ["MassOnly", "Rigid"]


class MassOnly(Hyperelastic):
    """Inertia and mass damping, without a stress. Local.

    It is used for the inertia terms if inertia and energy have different quadratures.

    Args:
        rho: Reference density [kg/m^3].
        mass_damping: Coefficient alpha [1/s], see `Hyperelastic`.

    Raises:
        ValueError: The density is not positive and finite.
    """

    def __init__(self, rho: float, mass_damping: float = 0.0) -> None:
        super().__init__(_no_energy, rho=rho, mass_damping=mass_damping, one_point=())

    def stress(self, *strains: Any, **parameters: Any) -> Any:
        """Zero stress, UFL (3, 3)."""
        return ufl.zero(3, 3)

    conserving_stress = linear_stress = stress


class Rigid(MassOnly):
    """Material of rigid bodies, with inertia and without deformation. Local.

    Args:
        rho: Reference density [kg/m^3].
    """

    # Moduli and flags as of a material that is stiffer than any other and cannot collapse.
    least_modulus = math.inf
    resists_collapse = True

    def __init__(self, rho: float) -> None:
        super().__init__(rho)
        self.has_default_rule = True

    def _described(self) -> dict[str, Any]:
        return {}


def _no_energy(C: Any, **parameters: Any) -> Any:
    return ufl.zero()
