"""Which steppers have derivatives."""

from typing import Any

from dolfinx_nts.common.arguments import kind_of
from dolfinx_nts.integrators.implicit.implicit_stepper import ImplicitStepper

__all__ = ["check_supported"]


def check_supported(stepper: Any) -> None:
    """Check that all parts of a stepper have derivatives. Local.

    Raises:
        TypeError: It is not an implicit stepper.
        ValueError: A part has no derivative.
    """
    if not isinstance(stepper, ImplicitStepper):
        raise TypeError(
            "expected an implicit stepper for gradients, such as EnergyMomentum, given "
            f"{kind_of(stepper)}"
        )
    for body in stepper.bodies:
        if body.is_rigid:
            raise ValueError(
                f"expected deformable bodies for gradients, given the rigid {body.name}: a body "
                "that is a hundred times as stiff as the others acts nearly the same"
            )
        if body.material.remembers:
            raise ValueError(
                "expected materials without internal variables for gradients, given "
                f"{body.material!r} of {body.name}: its energy without branches or plastic flow "
                "has derivatives"
            )
