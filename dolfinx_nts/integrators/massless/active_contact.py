"""Active contact of massless nodes at the end of a step, and its impulses on groups of bodies."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.implicit.active_nodes import ActiveNodes
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.integrators.massless.body_groups import BodyGroups
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.massless.gap_constraints import PairConstraints

__all__ = ["ActiveContact"]


class ActiveContact:
    """Active nodes of the pairs with impact "resolved" at the end of a step. Collective.

    Args:
        steps: Accepted contact of all pairs.
        groups: Groups of connected bodies, ``g`` in number.

    Attributes:
        constraints: Constraints of each pair: active gaps, and slips of sticking nodes.
    """

    def __init__(self, steps: Sequence[ContactStep], groups: BodyGroups) -> None:
        resolved = (step for step in steps if is_resolved(step.state.pair))
        self._pairs = [(step, ActiveNodes.of(step)) for step in resolved]
        self._groups = groups
        self.constraints = [_constraints(step, some) for step, some in self._pairs]

    def impulses(self, dim: int, dt: float) -> tuple[Floats, Floats]:
        """Impulses of normal contact in the step, and their work. Collective.

        They act at the positions at the end of the step, so that gap gradients have no resultant
        and no moment.

        Args:
            dim: Number of components of a displacement, d.
            dt: Length of the step [s].

        Returns:
            Impulses as for `VibrationAnalysis.of`, and the work of moving obstacles, ``(g,)`` [J].
        """
        d, size = dim, len(self._groups.nodes)
        impulses, work = np.zeros((size, size, 1 + d, d)), np.zeros(size)
        group = np.zeros((len(self._groups.number_of), 3))
        group[:, 0] = self._groups.number_of
        for step, some in self._pairs:
            mine = self._groups.number_of[step.state.nodes.nodes[some.node]]
            other = step.candidates.scatter.forward(group)[some.dofs, 0].astype(np.int32)
            x_n, x = (positions[some.dofs] for positions in (step.search.x_n, step.x))
            impulse = some.gradients[:, 0].reshape(x.shape) * (dt * some.force)[:, None, None]
            fields = np.insert(x[:, :, :d], 0, 1.0, axis=2)
            products = fields[:, :, :, None] * impulse[:, :, None, :d]
            np.add.at(impulses, (mine[:, None], other), products)
            carried = step.state.search.frame.carried(x_n, x)
            np.add.at(work, mine, (impulse * carried).sum(axis=(1, 2)) / dt)
        comm = self._groups.comm
        return reductions.total(comm, impulses), reductions.total(comm, work)

    def after(self, du: Floats) -> tuple[list[ContactHistory], Floats]:
        """Contact history of each pair after displacement increments of the nodes. Collective.

        Args:
            du: Increments of the owned nodes, shape ``(n, d)`` [m].

        Returns:
            The histories, and the energy dissipated by friction in each group, ``(g,)`` [J].
        """
        histories, dissipated = [], np.zeros(len(self._groups.nodes))
        for step, some in self._pairs:
            history = step.state.history
            rows = some.gradients.reshape(len(some.node), 3, some.dofs.shape[1], 3)
            increments = step.candidates.scatter.forward(in_space(du))[some.dofs]
            opened, *slid = np.einsum("mcki,mki->cm", rows, increments)
            gap, dissipation = history.gap.copy(), history.dissipation.copy()
            gap[some.node] = some.gap + opened
            # The total dissipation of a step is never negative.
            lost = (some.traction * np.transpose(slid)).sum(axis=1)
            lost = np.maximum(lost, -np.maximum(dissipation[some.node], 0.0))
            dissipation[some.node] += lost
            histories.append(replace(history, gap=gap, dissipation=dissipation))
            dissipated += self._groups.sums(step.state.nodes.nodes[some.node], lost)
        return histories, dissipated

    def accept(self, histories: Sequence[ContactHistory]) -> None:
        """Accept the histories returned by `after`. Local."""
        for (step, _), history in zip(self._pairs, histories, strict=True):
            step.state.accept(history)

    def add_impulses(self, rigid_factors: Floats) -> None:
        """Multiply the normal forces of the step by 1 + factors of the groups, ``(g,)``. Local."""
        for step, some in self._pairs:
            nodes, history = step.state.nodes.nodes, step.state.history
            factor = rigid_factors[self._groups.number_of[nodes]]
            lambda_N = (1 + factor) * history.lambda_N
            force = history.force + factor[:, None] * some.pushes
            step.state.accept(replace(history, lambda_N=lambda_N, force=force))


def _constraints(step: ContactStep, some: ActiveNodes) -> PairConstraints:
    """Gap constraints of m active nodes, and slip constraints of sticking ones. Local."""
    sticks = some.sticks
    gradient, *along = some.gradients.transpose(1, 0, 2)
    slides = ~sticks & (some.force > 0)
    ratio = np.divide(
        some.traction,
        -some.force[:, None],
        out=np.zeros_like(some.traction),
        where=slides[:, None],
    )
    force = gradient + np.einsum("ma,ami->mi", ratio, np.array(along))
    stuck = [rows[sticks] for rows in along]
    return PairConstraints(
        step.candidates.scatter,
        np.concatenate([some.dofs, some.dofs[sticks], some.dofs[sticks]]),
        np.concatenate([gradient, *stuck]),
        np.concatenate([force, *stuck]),
        np.concatenate([-some.gap, np.zeros(2 * np.count_nonzero(sticks))]),
    )
