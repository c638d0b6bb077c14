"""Contact that holds nodes without mass at the end of a step, and what groups of bodies get."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.held_nodes import HeldNodes
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.integrators.body_groups import BodyGroups
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.gap_constraints import KeptGaps

__all__ = ["HeldContact"]


class HeldContact:
    """Nodes that the pairs with impact resolved in time hold at the end of a step. Collective.

    Args:
        steps: Accepted attempts of all contact pairs.
        groups: Groups of connected bodies, ``g`` in number.

    Attributes:
        holds: Gaps that the nodes close and slips that they keep, of each pair.
    """

    def __init__(self, steps: Sequence[ContactStep], groups: BodyGroups) -> None:
        resolved = (step for step in steps if is_resolved(step.state.pair))
        self._pairs = [(step, HeldNodes.of(step)) for step in resolved]
        self._groups = groups
        self.holds = [_holds(step, some) for step, some in self._pairs]

    def impulses(self, dim: int, dt: float) -> tuple[Floats, Floats]:
        """Impulses of normal contact in the step, see `VibrationAnalysis.of`. Collective.

        They act at the end of the step, where gaps have gradients without resultant and moment.
        Also returns the work of moving obstacles by them, shape ``(g,)`` [J]. ``dim`` is the number
        of components of a displacement, ``dt`` the length of the step [s].
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

    def after(self, way: Floats) -> tuple[list[ContactHistory], Floats]:
        """Contact of each pair after its nodes have gone a way, ``(n, d)`` [m]. Collective.

        Also returns what friction dissipates in each group on it, ``(g,)`` [J].
        """
        histories, dissipated = [], np.zeros(len(self._groups.nodes))
        for step, some in self._pairs:
            history = step.state.history
            rows = some.gradients.reshape(len(some.node), 3, some.dofs.shape[1], 3)
            ways = step.candidates.scatter.forward(in_space(way))[some.dofs]
            opened, *slid = np.einsum("mcki,mki->cm", rows, ways)
            gap, dissipation = history.gap.copy(), history.dissipation.copy()
            gap[some.node] = some.gap + opened
            # In all a step never gets energy from friction.
            lost = (some.traction * np.transpose(slid)).sum(axis=1)
            lost = np.maximum(lost, -np.maximum(dissipation[some.node], 0.0))
            dissipation[some.node] += lost
            histories.append(replace(history, gap=gap, dissipation=dissipation))
            dissipated += self._groups.sums(step.state.nodes.nodes[some.node], lost)
        return histories, dissipated

    def accept(self, histories: Sequence[ContactHistory]) -> None:
        """Make histories of `after` those of the pairs. Local."""
        for (step, _), history in zip(self._pairs, histories, strict=True):
            step.state.accept(history)

    def add_recoil(self, recoils: Floats) -> None:
        """Add the impulses of recoil, factors ``(g,)`` of the forces of the step. Local."""
        for step, some in self._pairs:
            nodes, history = step.state.nodes.nodes, step.state.history
            factor = recoils[self._groups.number_of[nodes]]
            lambda_N = (1 + factor) * history.lambda_N
            force = history.force + factor[:, None] * some.pushes
            step.state.accept(replace(history, lambda_N=lambda_N, force=force))


def _holds(step: ContactStep, some: HeldNodes) -> KeptGaps:
    """Gaps that nodes close, ``(m,)``, and slips of those that stick. Local."""
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
    return KeptGaps(
        step.candidates.scatter,
        np.concatenate([some.dofs, some.dofs[sticks], some.dofs[sticks]]),
        np.concatenate([gradient, *stuck]),
        np.concatenate([force, *stuck]),
        np.concatenate([-some.gap, np.zeros(2 * np.count_nonzero(sticks))]),
    )
