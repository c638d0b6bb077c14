"""What groups of bodies pay for the equilibrium of nodes without mass."""

from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.integrators.recoil import Recoil
from dolfinx_nts.integrators.vibration import Vibration

__all__ = ["Payment"]

# Energy that was not paid, relative to what was wanted [-], that is round-off.
_ROUND_OFF = 1e-12


class Payment(NamedTuple):
    """Energy that groups get, negative where they pay, by recoil and by vibration.

    Attributes:
        wanted: What each group should get, shape ``(g,)`` [J].
        given: What it gets, which is that, or as much of it as it can give or take [J].
        recoils: Factors of the velocities of `Recoil` by which it gets it [-].
        factors: Factors of those of `Vibration` [-].
    """

    wanted: Floats
    given: Floats
    recoils: Floats
    factors: Floats

    @classmethod
    def of(cls, vibration: Vibration, recoil: Recoil, wanted: Floats) -> "Payment":
        """Let both give in proportion to the energy that they have. Local."""
        whole = vibration.energy + recoil.energy
        share = np.divide(recoil.energy, whole, out=np.zeros_like(whole), where=whole > 0)
        recoils, by_recoil = recoil.factors(share * wanted)
        factors, by_vibration = vibration.factors(wanted - by_recoil)
        return cls(wanted, by_recoil + by_vibration, recoils, factors)

    @property
    def is_whole(self) -> Flags:
        """Whether a group gets all that is wanted, shape ``(g,)``."""
        whole: Flags = np.abs(self.wanted - self.given) <= _ROUND_OFF * np.abs(self.wanted)
        return whole
