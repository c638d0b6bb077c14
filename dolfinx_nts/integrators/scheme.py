"""Schemes, which say what is evaluated at which state of a step."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from dolfinx_nts.integrators.rates import Rates
from dolfinx_nts.materials.hyperelastic import Hyperelastic

__all__ = ["Scheme"]


@dataclass(frozen=True)
class Scheme:
    """A time integration scheme as a value, from which a stepper takes all that differs.

    Attributes:
        contact: Kernel of the contact force: ``"conserving"``, ``"midpoint"`` or ``"static"``.
        stress: Function ``stress(material, parameters, F_n, F)`` that returns the first
            Piola-Kirchhoff stress of a step [Pa], UFL (3, 3), from the numbers of the material,
            as constants, and the deformation gradients at both ends of the step, UFL (3, 3).
        rates: Makes the `Rates` by which velocity and acceleration follow from displacements.
        stress_share: Derivative of the stress by the strain at the end of the step, as a part
            of that by a strain that is the same at both ends; forces of springs have the same [-].
        load_point: Time of the loads, and of what keeps bodies rigid, from 0 at the start of a
            step to 1 at its end [-].
        loads_at: Displacement at which loads act: that at their time on a straight way, or that
            at the end of the step.
        resolves_impact: Whether nodes may be without mass, see `ResolvedImpact`.
    """

    contact: Literal["conserving", "midpoint", "static"]
    stress: Callable[[Hyperelastic, Any, Any, Any], Any]
    rates: Callable[..., Rates]
    stress_share: float = 0.5
    load_point: float = 0.5
    loads_at: Literal["mean", "end"] = "mean"
    resolves_impact: bool = False

    def ends_for_loads(self, u_n: Any, u: Any) -> tuple[Any, Any]:
        """Displacements between which a load takes the mean, Functions or UFL. Local.

        Loads act where bodies are at the time of the load, or schemes are of first order.
        """
        if self.loads_at == "end":
            return u, u
        if self.load_point == 0.5:
            return u_n, u
        ahead = (self.load_point - 0.5) * (u - u_n)
        return u_n + ahead, u + ahead
