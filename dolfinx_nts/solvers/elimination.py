r"""Elimination of the multipliers from the linear systems of Newton's method.

Each active node gives up its normal displacement, which the constraint
determines, so Krylov methods see a system of the size and condition of the
bulk and no saddle point. With one column E per active pair, the node's
normal at the node, the gap gradients G, the forces F, and

.. math:: Z = 1 - E (G^T E)^{-1} G^T, \qquad
          \tilde Z^T = 1 - F (E^T F)^{-1} E^T,

the increment is :math:`\Delta u = x_p + Z y` with a particular part
:math:`x_p` that satisfies the constraints, and the multipliers follow from
the balance of normal forces at the nodes.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Array, Flags, Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.search.scatter import NodalScatter
from dolfinx_nts.solvers.contact_blocks import ContactBlocks
from dolfinx_nts.solvers.partial_scatter import PartialScatter

__all__ = ["ActivePairs", "Elimination", "active_pairs"]


_NO_VALUES = np.empty(0)  # of constraints: they are to become zero


class ActivePairs(NamedTuple):
    """Active pairs of one contact pair.

    Attributes:
        blocks: Their constraints and tangent, by the nodes of ``ghosts``.
        kernel: The same with places in the part of a vector that is needed.
        scatter: Takes this part; None where a rank knows all values: then
            it is the vector itself.
        places: Of the constrained nodes in the part.
        ghosts: Carries the values of nodes between ranks.
        fixed: Whether the node cannot give up what constraints determine.
        excess: What the constraints should make zero, shape ``(m, 3)`` [m].
    """

    blocks: ContactBlocks
    kernel: _kernels.Elimination
    scatter: PartialScatter | None
    places: Array
    ghosts: NodalScatter
    fixed: Flags
    excess: Floats

    @classmethod
    def of(cls, candidates: Candidates, state: ContactContribution) -> "ActivePairs":
        """Take the active ones of all pairs.

        Args:
            candidates: What carries the values of their nodes.
            state: The pairs.
        """
        pairs, ghosts = state.pairs, candidates.scatter
        arrays: tuple[Any, ...] = (
            *(pairs.fixed, pairs.excess, pairs.dofs, state.rank),
            *(pairs.normal, pairs.gradients, state.columns, state.tangent),
        )
        if not state.active.all():
            active = np.flatnonzero(state.active)
            arrays = tuple(array.take(active, axis=0) for array in arrays)
        fixed, excess, dofs, rank, normal, gradients, columns, tangent = arrays
        start, nodes = np.arange(0, dofs.size + 1, dofs.shape[1]), dofs.ravel()
        blocks = ContactBlocks(start, nodes, rank, normal, gradients, columns, dofs, tangent)
        needed = blocks
        scatter = None
        if not ghosts.is_local:
            nodes = np.union1d(blocks.nodes, blocks.tangent_nodes)
            scatter = PartialScatter(ghosts, nodes)
            needed = blocks.renumbered(lambda some: np.searchsorted(nodes, some).astype(np.int32))
        kernel = needed.kernel()
        return cls(blocks, kernel, scatter, needed.constrained, ghosts, fixed, excess)

    def global_blocks(self) -> ContactBlocks:
        """The blocks with global numbers of the nodes."""
        if self.ghosts.index_map.size_local == self.ghosts.index_map.size_global:
            return self.blocks
        return self.blocks.renumbered(self.ghosts.global_nodes)


def active_pairs(
    steps: Sequence[ContactStep], states: Sequence[ContactContribution]
) -> list[ActivePairs]:
    """Active pairs of each contact pair that has any, on whatever rank.

    Args:
        steps: Contact attempts.
        states: Their pairs.
    """
    # An exchange is collective: what is empty on all ranks is left out.
    return [
        ActivePairs.of(step.candidates, state)
        for step, state in zip(steps, states, strict=True)
        if step.num_active
    ]


class Elimination:
    """Projections for the active pairs of one Newton iteration.

    Collective, as all its methods. Vectors are nodal, shape ``(n, 3)``,
    over the owned nodes.

    Args:
        pairs: Active pairs, one item for each contact pair that has any.
            The projections only exist unless `ActiveSets.are_coupled`.
        active_version: Their number by `ActiveSets`.
    """

    def __init__(self, pairs: Sequence[ActivePairs], active_version: int) -> None:
        """Create the projections of some pairs."""
        self.pairs, self.active_version = pairs, active_version

    @property
    def empty(self) -> bool:
        """Whether no pair is active on any rank."""
        return not self.pairs

    def particular(self, n: int) -> tuple[Floats, list[Floats]]:
        """Nodal vector x_p with G^T x_p = -(g - g_ref), and as `constrain`."""
        x = np.zeros((n, 3))
        return x, self._constrain(x, [-p.excess for p in self.pairs])

    def constrain(self, x: Floats) -> list[Floats]:
        """Replace x by Z x; returns the part of Z x that each of `pairs` needs."""
        return self._constrain(x, [_NO_VALUES] * len(self.pairs))

    def _constrain(self, x: Floats, values: list[Floats]) -> list[Floats]:
        parts = [x if p.scatter is None else p.scatter.take(x) for p in self.pairs]
        for p, value, part in zip(self.pairs, values, parts, strict=True):
            p.kernel.constrain(value, part)
            if part is not x:
                x[p.blocks.constrained] = part[p.places]
        return parts

    def act(self, parts: list[Floats], y: Floats) -> Floats:
        """Z~^T (y + sum lambda dF/dq x), x as `constrain` returns it; overwrites y."""
        self._act(parts, y)
        return y

    def multipliers(self, x: Floats, y: Floats) -> list[Floats]:
        """Multipliers that balance y + sum lambda dF/dq x where nodes give up displacements.

        Args:
            x: Values at the owned nodes, shape ``(n, 3)`` [m].
            y: Forces at them, the same shape, overwritten [N].

        Returns:
            Those of each of `pairs`, constraint by constraint [N].
        """
        parts = [x if p.scatter is None else p.scatter.take(x) for p in self.pairs]
        removed = zip(self.pairs, self._act(parts, y), strict=True)
        return [-values[np.arange(3) < p.blocks.rank[:, None]] for p, values in removed]

    def _act(self, parts: list[Floats], y: Floats) -> list[Floats]:
        """Project y; returns the multipliers of what this removes."""
        removed = []
        for p, x in zip(self.pairs, parts, strict=True):
            part = y if p.scatter is None else p.scatter.owned(y)
            removed.append(p.kernel.act(x, part))
            if p.scatter is not None:
                p.scatter.put(part, y)
        return removed
