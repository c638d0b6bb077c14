"""Time integration schemes: which term is evaluated at which state of a step."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

from dolfinx_nts.common.arguments import finite, kind_of
from dolfinx_nts.integrators.rates import Rates
from dolfinx_nts.materials.hyperelastic import Hyperelastic

__all__ = ["HINT", "Scheme"]

Gradient = Literal["conserving", "midpoint", "static"]
LoadState = Literal["mean", "end"]

_GRADIENTS, _LOADS = get_args(Gradient), get_args(LoadState)
# Advice in messages on the arguments of a scheme.
HINT = "see the page on extending, rates=partial(NewmarkRates, Newmark(...))"


@dataclass(frozen=True)
class Scheme:
    """Time integration scheme of a stepper, at which state of a step each term is evaluated.

    Attributes:
        contact: Direction of the contact force: ``"conserving"`` (discrete gradient of the gap over
            the step), ``"midpoint"`` (gradient at the mean state) or ``"static"`` (gradient at the
            end of the step). With the last one, steppers with inertia support `Penalty` and
            ``LagrangeMultiplier("plastic")`` only.
        stress: Function ``stress(material, parameters, F_n, F)`` that returns the first
            Piola-Kirchhoff stress of a step [Pa], UFL (3, 3). ``parameters`` are the arguments of
            ``material.stress`` by name, ``F_n`` and ``F`` the deformation gradients at the start
            and at the end of the step, UFL (3, 3).
        rates: Factory of the relation between velocities and displacements, called by the stepper:
            ``partial(NewmarkRates, Newmark(...))`` for methods of Newmark's family, or the
            ``rates`` of another scheme, such as ``Midpoint.scheme.rates``.
        stress_share: Weight of the end of the step in ``stress`` [-], also used by springs and
            tangents: 1/2 for midpoint-type schemes, 1 for implicit Euler. It must be the time of
            the forces in ``rates``: 1 - alpha_f of `Newmark`, 1/2 for ``Midpoint.scheme.rates``.
        load_point: Time of the loads and of the constraint forces of rigid bodies, from 0 at the
            start of a step to 1 at its end [-]. It must be the time of the stress, otherwise the
            scheme is of first order.
        loads_at: Displacement for which loads are evaluated: interpolated at ``load_point``
            (``"mean"``), or at the end of the step (``"end"``).
        resolves_impact: Whether ``LagrangeMultiplier("resolved")`` is allowed, only for schemes of
            the package.

    Raises:
        TypeError: ``stress`` or ``rates`` is not a function, or a share not a number.
        ValueError: ``contact`` or ``loads_at`` is unknown, or a share not between 0 and 1.

    Example:
        >>> scheme = nts.EnergyMomentum.scheme
        >>> scheme.contact, scheme.load_point
        ('conserving', 0.5)
    """

    contact: Gradient
    stress: Callable[[Hyperelastic, Any, Any, Any], Any]
    rates: Callable[..., Rates]
    stress_share: float = 0.5
    load_point: float = 0.5
    loads_at: LoadState = "mean"
    resolves_impact: bool = False

    def __post_init__(self) -> None:
        chosen = {"contact": self.contact, "loads_at": self.loads_at}
        for (name, value), allowed in zip(chosen.items(), (_GRADIENTS, _LOADS), strict=True):
            if value not in allowed:
                raise ValueError(
                    f"expected {name} of a Scheme to be one of {', '.join(map(repr, allowed))}, "
                    f"given {value!r}"
                )
        for name, function in ("stress", self.stress), ("rates", self.rates):
            if not callable(function):
                raise TypeError(
                    f"expected a function as {name} of a Scheme, given {kind_of(function)}: {HINT}"
                )
        for name, number in ("stress_share", self.stress_share), ("load_point", self.load_point):
            if not 0 <= finite(f"{name} of a Scheme", number) <= 1:
                raise ValueError(f"expected {name} of a Scheme from 0 to 1, given {number}")

    def ends_for_loads(self, u_n: Any, u: Any) -> tuple[Any, Any]:
        """Two displacements whose mean is the displacement of a load, Functions or UFL. Local.

        Loads must act at the positions of the bodies at the time of the load, or the scheme would
        be of first order.
        """
        if self.loads_at == "end":
            return u, u
        if self.load_point == 0.5:
            return u_n, u
        ahead = (self.load_point - 0.5) * (u - u_n)
        return u_n + ahead, u + ahead
