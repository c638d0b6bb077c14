"""Decisions on contact, stick and slip of all points of a small linear system at once.

Multipliers of points that share the unknowns of rigid bodies tell little about single points: where
four corners stick, three of them may carry the friction or all. States that follow from them point
by point change to and fro. See `friction_cones` for what decides instead.
"""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.enforcement import LagrangeMultiplier, Tied
from dolfinx_nts.contact.implicit.contact_step import ContactStep, decide
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.fem.components import dimension
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers import friction_cones
from dolfinx_nts.solvers.elimination import ActivePairs
from dolfinx_nts.solvers.friction_cones import ConeSolution
from dolfinx_nts.solvers.saddle_point import SaddlePointSystem, WholeSystem

__all__ = ["decided", "may_be_decided"]


def may_be_decided(steps: Sequence[ContactStep]) -> bool:
    """Whether there is friction at pairs on which can be decided. Local, the same on all ranks."""
    return any(_takes_part(step) and step.state.pair.friction is not None for step in steps)


def decided(
    system: SaddlePointSystem,
    R: Floats,
    steps: Sequence[ContactStep],
    states: Sequence[ContactContribution],
) -> tuple[ContactContribution, ...] | None:
    """Let all points obey the conditions of contact and friction in the next iterate. Collective.

    Args:
        system: Linear system of the iteration.
        R: Residual on the owned dofs [N].
        steps: Contact attempts, which take over what is decided.
        states: Their last evaluations.

    Returns:
        The evaluations with the states that were decided. None if nothing was: where no pair with
        friction is near, as active sets are found without that; in large systems; where no forces
        obey.
    """
    comm = system.comm
    present = reductions.total(comm, np.array([len(state.active) for state in states])) > 0
    takes_part = [bool(p) and _takes_part(step) for p, step in zip(present, steps, strict=True)]
    deciding = [i for i, takes in enumerate(takes_part) if takes]
    laws = {i: law for i in deciding if (law := steps[i].friction.decided) is not None}
    if not may_be_decided([steps[i] for i in deciding]):
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
    whole = system.whole(R, pairs)
    if whole is None:
        return None
    own = (
        np.concatenate([_multipliers(steps[i], states[i])[:, :dim] for i in deciding]),
        np.concatenate([laws[i].coefficients(states[i].pairs.node) for i in deciding]),
        np.concatenate(is_decided),
    )
    parts = comm.allgather(own)
    found = _solution(whole, *(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
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


def _solution(
    whole: WholeSystem, present: Floats, mu: Floats, is_decided: Flags
) -> ConeSolution | None:
    """Forces and motions of all points that obey Coulomb's law. Local.

    Args:
        whole: System with all their forces as unknowns.
        present: Multipliers of the residual, ``(m, d)`` [N].
        mu: Coefficients of friction, shape ``(m,)`` [-].
        is_decided: Which multipliers of the system are theirs.
    """
    mine = np.zeros(len(whole.right), dtype=bool)
    mine[whole.is_multiplier] = is_decided
    A, right, forces = whole.matrix, whole.right, present.ravel()
    columns = A[~mine][:, mine]
    try:
        moved = np.linalg.solve(
            A[~mine][:, ~mine], np.column_stack([right[~mine] + columns @ forces, columns])
        )
    except np.linalg.LinAlgError:
        return None
    motions = A[mine][:, ~mine] @ moved
    W, q = motions[:, 1:], motions[:, 0] - right[mine]
    without = np.zeros(present.shape, dtype=bool)
    without[:, 1:] = mu[:, None] == 0
    none = without.ravel()
    W[none], W[:, none], q[none] = 0.0, 0.0, 0.0
    return friction_cones.solve(W, q, np.where(mu > 0, mu, 1.0))
