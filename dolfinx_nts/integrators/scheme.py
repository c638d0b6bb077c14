"""Schemes: what is evaluated where within a step."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from dolfinx_nts.integrators.rates import Rates
from dolfinx_nts.materials.hyperelastic import Hyperelastic

__all__ = ["Scheme", "Stress"]

Stress = Callable[[Hyperelastic, Any, Any, Any], Any]


@dataclass(frozen=True)
class Scheme:
    """A time integration scheme as a value.

    Attributes:
        contact: Kernel of contact: ``"conserving"``, ``"midpoint"`` or ``"static"``.
        stress: ``stress(material, parameters, F_n, F)``: first Piola-Kirchhoff stress of a step
            [Pa], UFL (3, 3), from the numbers of the material, as constants, and the
            deformation gradients at both ends of the step, UFL (3, 3).
        rates: Makes what velocity and acceleration follow from.
        stress_share: Part of the stress that belongs to the end of the step: derivative by the
            strain there over that by all of it.
        load_point: Where in a step the time of the loads is, from 0 to 1.
        loads_at: Displacement at which loads act: the mean of the step or that at its end.
    """

    contact: Literal["conserving", "midpoint", "static"]
    stress: Stress
    rates: Callable[..., Rates]
    stress_share: float = 0.5
    load_point: float = 0.5
    loads_at: Literal["mean", "end"] = "mean"
