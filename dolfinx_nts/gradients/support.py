"""Checks that a stepper has derivatives."""

from collections.abc import Sequence
from typing import Any

from dolfinx_nts.common.arguments import kind_of
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.joint_state import members
from dolfinx_nts.contact.method import NODES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.vertices import VertexState
from dolfinx_nts.integrators.implicit.implicit_stepper import ImplicitStepper
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.statics.inertia_relief import InertiaRelief

__all__ = ["check_open", "check_resisted", "check_supported", "has_adjoint", "has_exact_derivative"]


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
    for pair in stepper.pairs:
        if not isinstance(pair.enforcement, Penalty):
            raise ValueError(
                f"expected contact by springs for gradients, given {pair.describe()} of "
                f"{pair.between}: active sets of multipliers jump, and slopes between jumps "
                "mislead; enforcement=Penalty() has derivatives"
            )
        if pair.is_convective:
            raise ValueError(
                "expected friction without convective coordinates for gradients, given convective "
                f"friction of {pair.between}: the default law of slip has derivatives"
            )
    for contact in stepper.contacts:
        if contact.search.may_move:
            raise ValueError(
                "expected fixed obstacles for gradients, given the moving "
                f"{contact.segments.name}: the surface of a stiff body that its supports move has "
                "derivatives"
            )


def check_open(steps: Sequence[ContactStep]) -> None:
    """Check that springs have no force at the start of a step. Collective.

    Raises:
        ValueError: A node penetrates, so that the acceleration at the start depends on springs.
    """
    for step in steps:
        state = step.state
        if reductions.anywhere(state.nodes.V.mesh.comm, bool((step.search.start[1] < 0).any())):
            raise ValueError(
                "expected open contact at the start of a run for gradients, as the acceleration "
                f"follows from the forces there, given {state.pair.between} with nodes inside: "
                "begin with a gap, or make the gradient after a first step"
            )


def check_resisted(relief: InertiaRelief) -> None:
    """Check that bodies and contact resist all motions in the equilibrium of a step. Local.

    Raises:
        ValueError: Rigid motions have been suppressed, so that the tangent is singular.
    """
    if len(relief.loads):
        names = "; ".join(map(str, relief.bodies))
        raise ValueError(
            "expected, for gradients, supports or contact that resist all rigid motions, given "
            f"{names} in statics with {len(relief.loads)} free motions: add bcs or friction "
            "against them"
        )


def has_adjoint(pair: ContactPair) -> bool:
    """Whether the contact of a pair has derivatives in closed form, and thus an adjoint. Local.

    Springs of nodes on segments without friction have an adjoint. All other contact is
    differentiated along one direction at a time.
    """
    return pair.method == NODES and pair.friction is None


def has_exact_derivative(step: ContactStep, last: ContactContribution, *, gives_back: bool) -> bool:
    """Whether a step of contact has derivatives in closed form. Collective.

    Springs that return energy as an impulse, and springs of vertices, have no such derivative.

    Args:
        step: The accepted attempt, before its pairs accept their histories.
        last: Its last evaluation.
        gives_back: Whether springs return energy, as with inertia.
    """
    if not has_adjoint(step.state.pair):
        return False
    if step.num_active and isinstance(members(step.state)[0], VertexState):
        return False
    if not gives_back:
        return True
    normal, node = step.normal, last.pairs.node
    returns = [normal.surplus_energy(last.pairs), normal.released_energy(node)]
    own = any(bool((energy > 0).any()) for energy in returns)
    return not reductions.anywhere(step.state.nodes.V.mesh.comm, own)
