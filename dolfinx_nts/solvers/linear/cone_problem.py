"""Cone complementarity problem of all contact points of a linear system.

Contact points on one rigid body share its unknowns, so their multipliers do not determine the state
of a single point: if four corners stick, three of them may carry the friction, or all. The same
holds at the onset of sliding, where each sliding node loads its neighbours. An active-set update
point by point then oscillates. Here the states of all points follow from one problem, which
`friction_cones` solves.
"""

from collections.abc import Sequence
from typing import Protocol

from mpi4py import MPI

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.enforcement import LagrangeMultiplier, Tied
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.implicit.coupled.cone_states import apply_solution
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.convergence import position_rounding
from dolfinx_nts.solvers.linear import friction_cones
from dolfinx_nts.solvers.linear.elimination import ActivePairs
from dolfinx_nts.solvers.linear.friction_cones import ConeSolution

__all__ = ["CondensedSystem", "has_cone_problem", "solve_cone_problem"]


class CondensedSystem(Protocol):
    """Function that condenses a linear system to the contact points."""

    def __call__(
        self, R: Floats, pairs: Sequence[ActivePairs], is_point: Flags, present: Floats
    ) -> tuple[Floats, Floats] | None:
        """Compliance W and offset q of the motions y = W f + q of points. Collective.

        Args:
            R: Residual on the owned dofs [N].
            pairs: Pairs, active or not, whose constraints are among the unknowns.
            is_point: Flags of the constraints that belong to the ``m`` points, for the constraints
                of all ranks.
            present: Multipliers of the points in the residual, shape ``(d m,)`` [N].

        Returns:
            W, shape ``(d m, d m)`` [m/N], and q, shape ``(d m,)`` [m]. None if the system is too
            large or singular.
        """


def has_cone_problem(steps: Sequence[ContactStep], inertia: bool) -> bool:
    """Whether any pair takes part in a cone problem. Local, the same on all ranks.

    In statics pairs without friction take part, since one wrong node may move a body far away that
    is supported only by contact. With inertia they take part only at nodes of rigid bodies;
    elsewhere their active set is found node by node.
    """

    def is_coupled(step: ContactStep) -> bool:
        return not inertia or step.state.pair.friction is not None or step.has_rigid_nodes

    return any(_takes_part(step) and is_coupled(step) for step in steps)


def solve_cone_problem(
    system: CondensedSystem,
    comm: MPI.Comm,
    R: Floats,
    steps: Sequence[ContactStep],
    states: Sequence[ContactContribution],
    inertia: bool,
) -> tuple[ContactContribution, ...] | None:
    """Find states of all points that satisfy all contact and friction conditions. Collective.

    Args:
        system: Condenses the linear system of the iteration.
        comm: Communicator of the mesh.
        R: Residual on the owned dofs [N].
        steps: Contact attempts, which receive the new states.
        states: Their last evaluations.
        inertia: Whether there is inertia.

    Returns:
        The evaluations with the new states. None if no pair near contact takes part in the problem,
        if the system is too large, or if no solution was found.
    """
    near = reductions.total(comm, np.array([len(state.active) for state in states])) > 0
    takes_part = [bool(n) and _takes_part(step) for n, step in zip(near, steps, strict=True)]
    deciding = [i for i, takes in enumerate(takes_part) if takes]
    laws = {i: law for i in deciding if (law := steps[i].friction.coupled) is not None}
    if not has_cone_problem([steps[i] for i in deciding], inertia):
        return None
    dim = dimension(steps[0].state.nodes.V)
    pairs, is_decided = [], []
    for i, (step, state) in enumerate(zip(steps, states, strict=True)):
        if takes_part[i] or step.num_active:
            if takes_part[i]:
                laws[i].use_all_slips(state.pairs)
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
    if condensed is None:
        return None
    farthest = max(_kernels.largest_size(step.x) for step in steps)
    W, q = condensed
    # Motions that are round-off need no forces, as at the hinge of a rigid body, which no force
    # moves.
    q[np.abs(q) <= position_rounding(reductions.largest(comm, farthest))] = 0.0
    found = _solution(W, q, mu, dim)
    if found is None:
        return None
    new, first = list(states), sum(len(part[0]) for part in parts[: comm.rank])
    for i in deciding:
        last = first + len(states[i].active)
        new[i] = apply_solution(steps[i], states[i], found.subset(slice(first, last)))
        first = last
    return tuple(new)


def _takes_part(step: ContactStep) -> bool:
    """Whether a pair has unilateral multipliers, and Coulomb or no friction. Local."""
    law = step.state.pair.enforcement
    pushes = isinstance(law, LagrangeMultiplier) and not isinstance(law, Tied)
    return pushes and step.friction.coupled is not None


def _multipliers(step: ContactStep, state: ContactContribution) -> Floats:
    """Multipliers of the last evaluation, normal and tangential, ``(m, 3)`` [N]. Local."""
    node = state.pairs.node
    values = np.column_stack([step.normal.lambda_N[node], step.friction.traction[node]])
    return np.where(state.active[:, None], values, 0.0)


def _with_all_rows(state: ContactContribution, dim: int) -> ContactContribution:
    """Copy with all pairs sticking, so that all force components are unknowns. Local."""
    m = len(state.active)
    return state._replace(
        active=np.ones(m, dtype=bool),
        rank=np.full(m, dim, dtype=np.int32),
        columns=state.pairs.columns,
        slopes=np.zeros_like(state.slopes),
    )


def _solution(W: Floats, q: Floats, mu: Floats, dim: int) -> ConeSolution | None:
    """Contact forces and motions of ``m`` points under Coulomb's law, see `CondensedSystem`. Local.

    ``mu`` are coefficients of friction, shape ``(m,)`` [-].
    """
    without = np.zeros((len(mu), dim), dtype=bool)
    without[:, 1:] = mu[:, None] == 0
    none = without.ravel()
    W[none], W[:, none], q[none] = 0.0, 0.0, 0.0
    return friction_cones.solve(W, q, np.where(mu > 0, mu, 1.0))
