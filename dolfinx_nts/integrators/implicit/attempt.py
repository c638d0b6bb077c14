"""Starting guesses, prescribed data and admissible displacements of a step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from dolfinx import fem

from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.solvers.bulk import Bulk

__all__ = ["AdmissibleMotion", "Start", "StepProblem"]


class AdmissibleMotion:
    """Displacements at the end of a step that satisfy supports, guides and rigidity.

    Args:
        bulk: Residual of the bodies, with supports and rigid motions.
        u: Displacement at the end of the step, used as work space.
        u_n: Displacement at the start of the step.
    """

    def __init__(self, bulk: Bulk, u: fem.Function, u_n: fem.Function) -> None:
        self._bulk, self._u, self._u_n = bulk, u, u_n.x.array

    def displacements(self, u: Floats, fraction: float = 1.0) -> Floats:
        """Project displacements u of the local dofs [m] on admissible displacements. Collective.

        ``fraction`` is the fraction of the increment from the start of the step, from 0 to 1.
        """
        u_n, rigid = self._u_n, self._bulk.rigid
        u = self._bulk.supports.applied(u)
        if fraction < 1:
            u = u_n + fraction * (u - u_n)
        if rigid.exists:
            trial, du, guided = self._u.x, self.owned(u - u_n), rigid.guides.prescribed
            self.owned(trial.array)[:] = rigid.moved(self.owned(u_n), du, fraction * guided)
            trial.scatter_forward()
            u = trial.array.copy()
            trial.array[:] = u_n
        return u

    def prescribed(self, x_n: Floats, contacts: Sequence[PairState]) -> Floats:
        """Prescribed displacement increments of the step at the owned dofs [m]. Collective.

        They include increments of supports and guided bodies, and of obstacles at the nodes of
        their pairs.

        Args:
            x_n: Positions of the local nodes at the start of the step, shape ``(l, 3)`` [m].
            contacts: States of all contact pairs.
        """
        # Increments of guides at rest are round-off, whose direction is arbitrary.
        rigid = self._bulk.rigid
        applied = self.displacements if rigid.guides.are_moving else self._bulk.supports.applied
        u_n = self._u_n
        increments: Floats = (applied(u_n) - u_n)[: self._bulk.num_owned]
        for contact in contacts:
            frame, nodes = contact.search.frame, contact.nodes.nodes
            if frame.moves:
                increment = frame.in_space(frame.at_start(x_n[nodes])) - x_n[nodes]
                self.owned(increments)[nodes] += increment[:, : rigid.dim]
        return increments

    def owned(self, values: Floats) -> Floats:
        """View of dof values at the owned nodes, shape ``(n, d)``. Local."""
        return values[: self._bulk.num_owned].reshape(-1, self._bulk.rigid.dim)


@dataclass(frozen=True)
class Start:
    """Starting guess of Newton's method.

    Attributes:
        name: Name in error messages.
        u: Admissible displacements of the local dofs, shape ``(d l,)`` [m].
        guess: Displacements before the projection on admissible displacements.
        begins_sticking: Whether all nodes with friction stick at first, see `StickSlip`.
        most_long: Number of increments longer than half of the smallest cell after which the
            attempt fails; None if there is no limit.
    """

    name: str
    u: Floats
    guess: Floats
    begins_sticking: bool = False
    most_long: int | None = None


@dataclass(frozen=True)
class StepProblem:
    """Data of a step that do not depend on the starting guess.

    Attributes:
        x_n: Positions of the local nodes at the start of the step, shape ``(l, 3)`` [m].
        x_trial: Trial positions at its end without contact, from which candidate segments are
            searched, shape ``(l, 3)`` [m].
        x_spring_points: Positions at which points of mortar contact by springs are chosen, see
            `Rates`, shape ``(l, 3)`` [m].
        intermediate: Positions between ``x_n`` and ``x_trial`` by step fraction, see
            `ContactStep`.
        load: Norm of the loads [N].
        force_scale: Norm of all forces, to which the residual is relative [N].
        admitted: Flags of nodes that were eligible in earlier solutions of the step, by contact
            state, ``(n,)``.
    """

    x_n: Floats
    x_trial: Floats
    x_spring_points: Floats
    intermediate: Mapping[float, Floats]
    load: float
    force_scale: float
    admitted: Mapping[PairState | JointState, Flags] = field(default_factory=dict)

    def x_points(self, state: PairState | JointState) -> Floats:
        """Positions at which mortar points of a pair are chosen, shape ``(l, 3)`` [m]. Local."""
        return self.x_trial if state.eps_N is None else self.x_spring_points

    def with_trial(self, x: Floats) -> "StepProblem":
        """Copy with the same trial positions for all purposes, shape ``(l, 3)`` [m]. Local."""
        return replace(self, x_trial=x, x_spring_points=x)
