r"""Isotropic hardening: the yield stress as a function of the equivalent plastic strain."""

from typing import Any, NamedTuple

import ufl

from dolfinx_nts.common.arguments import nonnegative, positive

__all__ = ["Hardening", "checked_hardening"]


class Hardening(NamedTuple):
    r"""Linear hardening and saturation.

    :math:`\sigma_y = \sigma_0 + H \alpha + \Delta\sigma\, (1 - e^{-\delta \alpha})`.

    Attributes:
        yield_stress: Yield stress without plastic strain [Pa].
        modulus: Hardening modulus H [Pa].
        increase: Increase of the yield stress by saturation [Pa].
        rate: Exponent delta of saturation [-].
    """

    yield_stress: Any
    modulus: Any
    increase: Any
    rate: Any

    @property
    def saturates(self) -> bool:
        """Whether hardening is nonlinear."""
        return not isinstance(self.rate, float) or self.rate > 0

    def stress(self, alpha: Any) -> Any:
        """Yield stress at a plastic strain [Pa]."""
        linear = self.yield_stress + self.modulus * alpha
        if not self.saturates:
            return linear
        return linear + self.increase * (1 - ufl.exp(-self.rate * alpha))

    def slope(self, alpha: Any) -> Any:
        """Derivative of the yield stress with respect to the plastic strain [Pa]."""
        if not self.saturates:
            return self.modulus
        return self.modulus + self.increase * self.rate * ufl.exp(-self.rate * alpha)


def checked_hardening(yield_stress: Any, modulus: Any, saturation: Any) -> Hardening:
    """Check parameters given by a user. Local.

    Args:
        yield_stress: Yield stress without plastic strain [Pa].
        modulus: Hardening modulus [Pa].
        saturation: Increase of the yield stress [Pa] and exponent [-], or None.

    Returns:
        The hardening.

    Raises:
        TypeError: An argument is not a real number, or the saturation not a pair of these.
        ValueError: A number is not finite, or has the wrong sign.
    """
    positive("a yield stress", yield_stress)
    nonnegative("a hardening modulus", modulus)
    increase, rate = 0.0, 0.0
    if saturation is not None:
        try:
            increase, rate = saturation
        except (TypeError, ValueError):
            raise TypeError(
                "expected saturation as a pair (gain of yield stress [Pa], exponent [-]), "
                f"given {saturation!r}"
            ) from None
        positive("the gain of a saturation", increase)
        positive("the exponent of a saturation", rate)
    return Hardening(float(yield_stress), float(modulus), float(increase), float(rate))
