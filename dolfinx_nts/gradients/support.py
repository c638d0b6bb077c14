"""Which steppers have derivatives."""

from collections.abc import Sequence
from typing import Any

from dolfinx_nts.common.arguments import kind_of
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.friction.limits import coefficients_of
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.joint_state import members
from dolfinx_nts.contact.method import NODES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.vertices import VertexState
from dolfinx_nts.integrators.implicit.implicit_stepper import ImplicitStepper
from dolfinx_nts.integrators.rates import NoRates
from dolfinx_nts.parallel import reductions

__all__ = ["check_laws", "check_supported", "has_adjoint", "has_exact_derivative"]


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
    if stepper.pairs and stepper.scheme.rates is NoRates:
        raise ValueError(
            "expected a stepper with inertia for gradients through contact, given "
            f"{type(stepper).__name__} with {stepper.pairs[0].between}: EnergyMomentum with "
            "mass_damping comes to rest in the same state"
        )
    for pair in stepper.pairs:
        if not isinstance(pair.enforcement, Penalty):
            raise ValueError(
                f"expected contact by springs for gradients, given {pair.describe()} of "
                f"{pair.between}: active sets of multipliers jump, and slopes between jumps "
                "mislead; enforcement=Penalty() has derivatives"
            )
        if pair.is_convective:
            raise ValueError(
                f"expected friction without convective coordinates for gradients, given it of "
                f"{pair.between}: the default law of slip has derivatives"
            )
    for contact in stepper.contacts:
        if contact.search.may_move:
            raise ValueError(
                "expected fixed obstacles for gradients, given the moving "
                f"{contact.segments.name}: the surface of a stiff body that its supports move has "
                "derivatives"
            )


def check_laws(stepper: Any, controls: Sequence[Any]) -> None:
    """Check that no law of friction, which is not differentiated, has a control. Collective.

    Args:
        stepper: The stepper.
        controls: Functions and Constants.

    Raises:
        ValueError: A law depends on one.
    """
    for pair in stepper.pairs:
        if pair.friction is None:
            continue
        read = coefficients_of(pair.friction, pair.nodes)
        for control in controls:
            if reductions.anywhere(stepper.u.function_space.mesh.comm, control in read):
                raise ValueError(
                    "expected controls on which friction does not depend, given a "
                    f"{type(control).__name__} in {pair.friction!r} of {pair.between}: use a copy "
                    "with fixed values in the law of friction"
                )


def has_adjoint(pair: ContactPair) -> bool:
    """Whether the contact of a pair has derivatives in closed form, and thus an adjoint. Local.

    It has for springs of nodes on segments, without friction. All other contact is differentiated
    along one direction at a time.
    """
    return pair.method == NODES and pair.friction is None


def has_exact_derivative(step: ContactStep, last: ContactContribution) -> bool:
    """Whether a step of contact has derivatives in closed form. Collective.

    Springs that return energy as an impulse, and those of vertices, have none.

    Args:
        step: The accepted attempt, before its pairs accept their histories.
        last: Its last evaluation.
    """
    if not has_adjoint(step.state.pair):
        return False
    if step.num_active and isinstance(members(step.state)[0], VertexState):
        return False
    normal, node = step.normal, last.pairs.node
    returns = [normal.surplus_energy(last.pairs), normal.released_energy(node)]
    own = any(bool((energy > 0).any()) for energy in returns)
    return not reductions.anywhere(step.state.nodes.V.mesh.comm, own)
