"""Decisions on contact, stick and slip of all points of a linear system at once.

Multipliers of points that share the unknowns of rigid bodies tell little about single points: where
four corners stick, three of them may carry the friction or all. Nor do those of a body that begins
to slide, where each node that slides loads its neighbours. States that follow from multipliers
point by point change to and fro. See `friction_cones` for what decides instead.
"""

from collections.abc import Sequence
from typing import Protocol

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.enforcement import LagrangeMultiplier, Tied
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.implicit.decided_step import decide
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers import friction_cones
from dolfinx_nts.solvers.elimination import ActivePairs
from dolfinx_nts.solvers.friction_cones import ConeSolution

__all__ = ["CondensedSystem", "has_cone_problem", "solve_cone_problem"]


class CondensedSystem(Protocol):
    """Condenses a linear system to points of contact."""

    def __call__(
        self, R: Floats, pairs: Sequence[ActivePairs], is_point: Flags, present: Floats
    ) -> tuple[Floats, Floats] | None:
        """Motions y = W f + q of points by the forces on them. Collective.

        Args:
            R: Residual on the owned dofs [N].
            pairs: Pairs, active or not, whose constraints are among the unknowns.
            is_point: Which constraints, of all ranks, are of the ``m`` points.
            present: Their multipliers in the residual, shape ``(d m,)`` [N].

        Returns:
            W, shape ``(d m, d m)`` [m/N], and q, shape ``(d m,)`` [m]. None where the system is
            large or has no solution.
        """


def has_cone_problem(steps: Sequence[ContactStep], inertia: bool) -> bool:
    """Whether there are pairs on which is to be decided. Local, the same on all ranks.

    With inertia active sets without friction are found node by node. Without, bodies that contact
    alone holds go far by each node that is wrong.
    """
    return any(
        _takes_part(step) and not (inertia and step.state.pair.friction is None) for step in steps
    )


def solve_cone_problem(
    system: CondensedSystem,
    comm: MPI.Comm,
    R: Floats,
    steps: Sequence[ContactStep],
    states: Sequence[ContactContribution],
    inertia: bool,
) -> tuple[ContactContribution, ...] | None:
    """Let all points obey the conditions of contact and friction in the next iterate. Collective.

    Args:
        system: Condenses the linear system of the iteration.
        comm: Communicator of the mesh.
        R: Residual on the owned dofs [N].
        steps: Contact attempts, which take over what is decided.
        states: Their last evaluations.
        inertia: Whether there is any.

    Returns:
        The evaluations with the states that were decided. None if nothing was: where no pair is
        near on which is to be decided; in large systems; where no forces obey.
    """
    near = reductions.total(comm, np.array([len(state.active) for state in states])) > 0
    takes_part = [bool(n) and _takes_part(step) for n, step in zip(near, steps, strict=True)]
    deciding = [i for i, takes in enumerate(takes_part) if takes]
    laws = {i: law for i in deciding if (law := steps[i].friction.decided) is not None}
    if not has_cone_problem([steps[i] for i in deciding], inertia):
        return None
    dim = dimension(steps[0].state.nodes.V)
    pairs, is_decided = [], []
    for i, (step, state) in enumerate(zip(steps, states, strict=True)):
        if takes_part[i] or step.num_active:
            if takes_part[i]:
                laws[i].show_slips(state.pairs)
                state = _with_all_rows(state, dim)
            pairs.append(ActivePairs(step.candidates, state, dim))
            is_decided.append(np.full(int(pairs[-1].blocks.rank.sum()), takes_part[i]))
    own = (
        np.concatenate([_multipliers(steps[i], states[i])[:, :dim] for i in deciding]),
        np.concatenate([laws[i].coefficients(states[i].pairs.node) for i in deciding]),
        np.concatenate(is_decided),
    )
    parts = comm.allgather(own)
    present, mu, is_point = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    condensed = system(R, pairs, is_point, present.ravel())
    found = None if condensed is None else _solution(*condensed, mu, dim)
    if found is None:
        return None
    new, first = list(states), sum(len(part[0]) for part in parts[: comm.rank])
    for i in deciding:
        last = first + len(states[i].active)
        new[i] = decide(steps[i], states[i], found.part(slice(first, last)))
        first = last
    return tuple(new)


def _takes_part(step: ContactStep) -> bool:
    """Whether multipliers that push and Coulomb's law alone tell the states of pairs. Local."""
    law = step.state.pair.enforcement
    pushes = isinstance(law, LagrangeMultiplier) and not isinstance(law, Tied)
    return pushes and step.friction.decided is not None


def _multipliers(step: ContactStep, state: ContactContribution) -> Floats:
    """Multipliers of the last evaluation, normal and tangential, ``(m, 3)`` [N]. Local."""
    node = state.pairs.node
    values = np.column_stack([step.normal.lambda_N[node], step.friction.traction[node]])
    return np.where(state.active[:, None], values, 0.0)


def _with_all_rows(state: ContactContribution, dim: int) -> ContactContribution:
    """All pairs as if they stuck, so that their forces are unknowns. Local."""
    m = len(state.active)
    return state._replace(
        active=np.ones(m, dtype=bool),
        rank=np.full(m, dim, dtype=np.int32),
        columns=state.pairs.columns,
        slopes=np.zeros_like(state.slopes),
    )


def _solution(W: Floats, q: Floats, mu: Floats, dim: int) -> ConeSolution | None:
    """Forces and motions of ``m`` points that obey Coulomb's law, see `CondensedSystem`. Local.

    ``mu`` are coefficients of friction, shape ``(m,)`` [-].
    """
    without = np.zeros((len(mu), dim), dtype=bool)
    without[:, 1:] = mu[:, None] == 0
    none = without.ravel()
    W[none], W[:, none], q[none] = 0.0, 0.0, 0.0
    return friction_cones.solve(W, q, np.where(mu > 0, mu, 1.0))
