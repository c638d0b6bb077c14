"""Attempts at a step: where Newton's method starts, and what all attempts share."""

from collections.abc import Mapping
from dataclasses import dataclass

from dolfinx_nts.common.arrays import Floats

__all__ = ["Start", "StepProblem"]


@dataclass(frozen=True)
class Start:
    """A state from which Newton's method starts.

    Attributes:
        name: What errors call the state.
        u: Displacements of the local dofs, shape ``(d l,)`` [m], with supports and rigid bodies
            where the step takes them.
        guess: The same before supports and rigid bodies have changed it.
        begins_sticking: Whether all nodes with friction stick at first, see `StickSlip`.
    """

    name: str
    u: Floats
    guess: Floats
    begins_sticking: bool = False


@dataclass(frozen=True)
class StepProblem:
    """What is given in a step, whatever state Newton's method starts from.

    Attributes:
        x_n: Positions of the local nodes at the start of the step, shape ``(l, 3)`` [m].
        x_trial: Positions at its end if there were no contact, which decide what may touch,
            shape ``(l, 3)`` [m].
        on_the_way: Positions between these two, by the part of the way, see `ContactStep`.
        load: Norm of the loads [N].
        force_scale: Norm of all forces at work, with which the residual is compared [N].
    """

    x_n: Floats
    x_trial: Floats
    on_the_way: Mapping[float, Floats]
    load: float
    force_scale: float
