r"""Metal plasticity at finite strain: von Mises yield stress and isotropic hardening.

The multiplicative split of the deformation is :math:`F = F_e F_p`. The history variable is the
metric :math:`G = C_p^{-1}` with a constant determinant: plastic flow is isochoric. The elastic
energy is :math:`\psi = \mu/2\, (J^{-2/3} C : G - 3) + \kappa/4\, (J^2 - 1 - 2 \ln J)`. The flow of
G in a step is described in `radial_return`.
"""

from typing import Any, ClassVar

import ufl

from dolfinx_nts.common.arguments import positive, real
from dolfinx_nts.materials.hardening import checked_hardening
from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.materials.volume_increment import VolumeIncrement

__all__ = ["J2Plasticity"]


class J2Plasticity(Hyperelastic):
    r"""Elastic-plastic metal at finite strain, by von Mises' yield condition. Local.

    The elastic energy is :math:`\mu/2\, (J^{-2/3} C : C_p^{-1} - 3) + \kappa/4\, (J^2 - 1 - 2 \ln
    J)`. The von Mises stress of the Kirchhoff stress does not exceed :math:`\sigma_y = \sigma_0 + H
    \alpha + \Delta\sigma\, (1 - e^{-\delta \alpha})` with the equivalent plastic strain alpha. All
    plastic work is dissipated. Volumetric terms have one quadrature point per cell in hexahedra and
    quadrilaterals of degree 1, which prevents locking. For `EnergyMomentum`, `Midpoint`,
    `GeneralizedAlpha` and `QuasiStatic`, at degree 1.

    Args:
        E: Young's modulus [Pa].
        nu: Poisson's ratio [-].
        rho: Reference density [kg/m^3].
        yield_stress: Yield stress sigma_0 of the undeformed material [Pa].
        hardening: Hardening modulus H [Pa].
        saturation: Pair of the increase of the yield stress, Delta sigma [Pa], and the exponent
            delta [-]; None: no saturation.
        mass_damping: Coefficient alpha of Rayleigh damping, see `Hyperelastic` [1/s].

    Attributes:
        hardening: A named tuple with ``yield_stress``, ``modulus``, ``increase`` and ``rate``.

    Raises:
        TypeError: An argument is not a real number, or the saturation not a pair of these.
        ValueError: ``E``, ``rho``, the yield stress or a number of the saturation is not
            positive, the hardening modulus or damping is negative, or ``nu`` is not in (-1, 0.5).

    Example:
        >>> nts.J2Plasticity(117e9, 0.35, 8930, yield_stress=400e6)  # copper
        J2Plasticity(E=117000000000, nu=0.35, yield_stress=400000000, hardening=0, rho=8930)
    """

    remembered_terms: ClassVar[frozenset[str]] = frozenset(["mu"])

    def __init__(
        self,
        E: float,
        nu: float,
        rho: float,
        *,
        yield_stress: float,
        hardening: float = 0.0,
        saturation: tuple[float, float] | None = None,
        mass_damping: float = 0.0,
    ) -> None:
        positive("Young's modulus E", E)
        if not -1 < real("nu", nu) < 0.5:
            raise ValueError(f"expected Poisson's ratio -1 < nu < 0.5, given {nu}")
        self.hardening = checked_hardening(yield_stress, hardening, saturation)
        super().__init__(
            _elastic,
            rho=rho,
            mass_damping=mass_damping,
            one_point="volumetric",
            mu=E / (2 * (1 + nu)),
            kappa=E / (3 * (1 - 2 * nu)),
        )
        self.has_default_rule = True

    @property
    def remembers(self) -> bool:
        return True

    def _volumetric_parameters(self) -> frozenset[str]:
        return frozenset(["kappa"])

    def _described(self) -> dict[str, Any]:
        mu, kappa = self.parameters["mu"], self.parameters["kappa"]
        E, nu = 9 * kappa * mu / (3 * kappa + mu), (3 * kappa - 2 * mu) / (6 * kappa + 2 * mu)
        law = self.hardening
        arguments = {"E": E, "nu": nu, "yield_stress": law.yield_stress, "hardening": law.modulus}
        return arguments | ({"saturation": (law.increase, law.rate)} if law.saturates else {})

    def conserving_stress(self, C_n: Any, C: Any, **parameters: Any) -> Any:
        """Conserving stress in closed form; ``metric`` is the plastic metric."""
        numbers = self.parameters | parameters
        G, mu, kappa = numbers.get("metric", ufl.Identity(3)), numbers["mu"], numbers["kappa"]
        volume = VolumeIncrement(C_n, C)
        a_n, a = volume.roots
        slope = mu / 2 * volume.root * ufl.inner(C_n + C, G)
        slope += kappa / 2 * (1 - volume.logarithm)
        return mu * (a_n + a) / 2 * G + slope * volume.gradient


def _elastic(C: Any, mu: Any, kappa: Any, metric: Any = None) -> Any:
    """Elastic energy, with the identity as the metric by default."""
    J2 = ufl.det(C)
    trace = ufl.tr(C) if metric is None else ufl.inner(C, metric)
    return mu / 2 * (J2 ** (-1 / 3) * trace - 3) + kappa / 4 * (J2 - 1 - ufl.ln(J2))
