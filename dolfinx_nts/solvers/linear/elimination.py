r"""Elimination of the multipliers from the linear systems of Newton's method.

The constraint of an active node determines its normal displacement, which is eliminated together
with the multiplier. Krylov methods are then applied to a system with the size and condition of the
bulk, which is not a saddle point problem. With one column E per active pair, which is the normal at
its node, the gap gradients G, the forces F, and

.. math:: Z = 1 - E (G^T E)^{-1} G^T, \qquad
          \tilde Z^T = 1 - F (E^T F)^{-1} E^T,

the increment is :math:`\Delta u = x_p + Z y` with a particular solution :math:`x_p` of the
constraints, and the multipliers follow from the balance of normal forces at the nodes. With
node-to-segment contact :math:`G^T E` is diagonal. With mortar contact it is nearly diagonal, and
each rank solves with the global matrix.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.implicit.mortar.mortar_pairing import PointBlocks
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.solvers.linear.contact_blocks import ContactBlocks

__all__ = ["ActivePairs", "CoupledPairs", "Elimination", "active_pairs"]


# A nodal vector at the owned nodes, and its values at ghosts.
Ghosted = tuple[Floats, Floats]

_NO_VALUES = np.empty(0)  # zero constraint values


class ActivePairs:
    """Active pairs of one contact pair; no two of them constrain the same node.

    Vectors are nodal, shape ``(n, d)``, over the owned nodes. A *ghosted* vector is the tuple
    of such a vector, which must not change, and of its values at ghosts.

    Args:
        candidates: Candidates of the search, which exchange values of their nodes.
        state: All pairs.
        dim: Components of the displacement at a node, d.

    Attributes:
        blocks: Constraints and tangent, with node numbers of ``ghosts``.
        ghosts: Exchange of nodal values between ranks.
        fixed: Whether the displacement of a node is prescribed, so that it cannot be eliminated.
        excess: Constraint residuals, shape ``(m, d)`` [m].
    """

    # Whether constraints may depend on constrained nodes of other pairs.
    may_overlap = False

    def __init__(self, candidates: Candidates, state: ContactContribution, dim: int) -> None:
        pairs, ghosts = state.pairs, candidates.scatter
        arrays: tuple[Any, ...] = (
            *(pairs.fixed, pairs.excess, pairs.dofs, state.rank),
            *(pairs.normal, pairs.gradients, state.columns, state.slopes),
        )
        tangent_nodes, tangent = pairs.blocks.nodes, state.tangent
        if not state.active.all():
            active = np.flatnonzero(state.active)
            arrays = tuple(array.take(active, axis=0) for array in arrays)
            loaded = pairs.blocks.of(state.active)
            tangent_nodes, tangent = tangent_nodes[loaded], tangent[loaded]
        self.fixed, self.excess, dofs, rank, normal, gradients, columns, slopes = arrays
        self._pair_dofs, self.ghosts = dofs, ghosts
        start, nodes = np.arange(0, dofs.size + 1, dofs.shape[1]), dofs.ravel()
        if dim < 3:  # restricted to the d components of the space
            self.excess, normal = self.excess[:, :dim], normal[:, :dim]
            gradients, columns, slopes, tangent = (
                _components(blocks, dim) for blocks in (gradients, columns, slopes, tangent)
            )
        constraints = start, nodes, rank, normal, gradients, columns, slopes
        self.blocks = blocks = ContactBlocks(*constraints, tangent_nodes, tangent)
        self._kernel = blocks.kernel()

    @property
    def is_regular(self) -> bool:
        """Whether the projections exist for this contact pair. Collective."""
        return True

    def constrain(self, values: Floats, x: Floats) -> Ghosted:
        """Replace x by Z x + E (G^T E)^-1 values; return the new x, ghosted. Collective."""
        ghosted = self.ghosted(x)
        self._kernel.constrain(values, *ghosted)
        return ghosted

    def act(self, x: Ghosted, y: Floats) -> Floats:
        """Replace y by Z~^T (y + C x) for a ghosted x. Collective.

        Returns:
            Multipliers of the forces that are removed, shape ``(m, 3)`` [N].
        """
        ghosts = self.ghosts.no_values(y.shape[1])
        removed = self._kernel.act(*x, y, ghosts)
        self.ghosts.add_of_ghosts(y, ghosts)
        return removed

    def ghosted(self, x: Floats) -> Ghosted:
        """A nodal vector with its values at the ghosts of these pairs. Collective."""
        return x, self.ghosts.at_ghosts(x)

    def global_blocks(self) -> ContactBlocks:
        """The blocks with global node numbers."""
        if self.ghosts.index_map.size_local == self.ghosts.index_map.size_global:
            return self.blocks
        return self.blocks.renumbered(self.ghosts.global_nodes)


class CoupledPairs(ActivePairs):
    """Active pairs whose constraints depend on each other's constrained nodes (mortar contact)."""

    may_overlap = True

    def __init__(self, candidates: Candidates, state: ContactContribution, dim: int) -> None:
        super().__init__(candidates, state, dim)
        blocks, dofs = self.blocks, self._pair_dofs
        assert isinstance(state.pairs.blocks, PointBlocks)
        self._eliminated = state.pairs.blocks.eliminated.take(dofs)
        self._gradients, self._forces = (
            self._eliminated.system(blocks.rank, rows, blocks.normal, transposed=transposed)
            for rows, transposed in ((blocks.gradients, False), (blocks.columns, True))
        )

    @property
    def is_regular(self) -> bool:
        ones = np.ones(self._gradients.directions.shape[:2])
        solutions = [system.solve(ones) for system in (self._gradients, self._forces)]
        return all(bool(np.isfinite(each).all()) for each in solutions)

    def constrain(self, values: Floats, x: Floats) -> Ghosted:
        missing = self._kernel.missing(values, *self.ghosted(x))
        directions = self._gradients.directions
        steps = self._gradients.solve(missing[:, : directions.shape[1]])
        self._eliminated.move((steps[:, None] @ directions)[:, 0], x)
        return self.ghosted(x)

    def act(self, x: Ghosted, y: Floats) -> Floats:
        ghosts = self.ghosts.no_values(y.shape[1])
        self._kernel.add_tangent(*x, y, ghosts)
        self.ghosts.add_of_ghosts(y, ghosts)
        directions = self._forces.directions
        force = (directions @ self._eliminated.gather(y)[:, :, None])[:, :, 0]
        removed = np.zeros((len(force), y.shape[1]))
        removed[:, : force.shape[1]] = self._forces.solve(force)
        ghosts.fill(0)
        self._kernel.remove(removed, y, ghosts)
        self.ghosts.add_of_ghosts(y, ghosts)
        return removed


def _components(blocks: Floats, dim: int) -> Floats:
    """Restriction of blocks ``(m, 3 j, 3 k)`` to d components of the space, ``(m, d j, d k)``."""
    m, j, k = len(blocks), blocks.shape[1] // 3, blocks.shape[2] // 3
    parts = blocks.reshape(m, j, 3, k, 3)[:, :, :dim, :, :dim]
    return parts.reshape(m, dim * j, dim * k)


def active_pairs(
    steps: Sequence[ContactStep], states: Sequence[ContactContribution], dim: int
) -> list[ActivePairs]:
    """Active pairs of each contact pair with active pairs on any rank.

    Args:
        steps: Contact attempts.
        states: Their pairs.
        dim: Components of the displacement at a node.
    """
    # Contact pairs without active nodes on all ranks are left out, to save collective exchanges.
    return [
        (CoupledPairs if state.pairs.blocks.may_overlap else ActivePairs)(
            step.candidates, state, dim
        )
        for step, state in zip(steps, states, strict=True)
        if step.num_active
    ]


class Elimination:
    """Projections for the active pairs of one Newton iteration.

    Collective, as all its methods. Vectors are nodal, shape ``(n, 3)``, over the owned nodes.

    Args:
        pairs: Active pairs, one item for each contact pair with any. The projections do not exist
            if `ActiveSets.are_coupled`.
        active_version: Number of the active set by `ActiveSets`.
    """

    def __init__(self, pairs: Sequence[ActivePairs], active_version: int) -> None:
        self.pairs, self.active_version = pairs, active_version

    @property
    def empty(self) -> bool:
        """Whether no pair is active on any rank."""
        return not self.pairs

    def particular(self, shape: tuple[int, ...]) -> tuple[Floats, list[Ghosted]]:
        """Particular solution x_p of G^T x_p = -(g - g_ref), also ghosted for each of `pairs`."""
        x = np.zeros(shape)
        return x, [p.constrain(-p.excess, x) for p in self.pairs]

    def constrain(self, x: Floats) -> list[Ghosted]:
        """Replace x by Z x; return Z x, ghosted for each of `pairs`."""
        return [p.constrain(_NO_VALUES, x) for p in self.pairs]

    def act(self, ghosted: list[Ghosted], y: Floats) -> Floats:
        """Replace y by Z~^T (y + sum lambda dF/dq x), with x as returned by `constrain`."""
        self._project(ghosted, y)
        return y

    def multipliers(self, x: Floats, y: Floats) -> list[Floats]:
        """Multipliers that balance y + sum lambda dF/dq x at the constrained nodes.

        Args:
            x: Values at the owned nodes, shape ``(n, 3)`` [m].
            y: Forces at them, the same shape, overwritten [N].

        Returns:
            Multipliers of each of `pairs`, constraint by constraint [N].
        """
        removed = zip(self.pairs, self._project([p.ghosted(x) for p in self.pairs], y), strict=True)
        return [
            -values[np.arange(p.blocks.normal.shape[1]) < p.blocks.rank[:, None]]
            for p, values in removed
        ]

    def _project(self, ghosted: list[Ghosted], y: Floats) -> list[Floats]:
        """Project y; return the multipliers of the removed forces, each ``(m, 3)``."""
        return [p.act(x, y) for p, x in zip(self.pairs, ghosted, strict=True)]
