"""How pairs enter linear systems: blocks of the tangent, and systems for the multipliers."""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints

__all__ = ["OwnBlocks", "PairBlocks"]


class PairBlocks(ABC):
    """Blocks of the tangent of ``m`` pairs, and systems for what the constraints determine.

    Attributes:
        dofs: Nodes of the pairs, that with the multiplier first, shape ``(m, d)``.
        nodes: Nodes of the blocks, shape ``(p, k)``.
        may_overlap: Whether constraints may reach constrained nodes of other pairs.
    """

    dofs: Ints
    nodes: Ints
    may_overlap: ClassVar[bool]

    @abstractmethod
    def tangent(self, lambda_N: Floats) -> Floats:
        """Derivative of forces of multipliers, ``(m,)`` [N], shape ``(p, 3 k, 3 k)`` [N/m]."""

    @abstractmethod
    def of(self, active: Flags) -> Ints:
        """Blocks in which ``active`` pairs, shape ``(m,)``, have a part. Local."""

    @abstractmethod
    def restrict(self, force: Floats, tangent: Floats) -> Floats:
        """Force of the pairs, ``(m, 3 d)`` [N], without entries of given displacements. Local.

        The tangent, shape ``(p, 3 k, 3 k)`` [N/m], loses its rows and columns of them in place.
        """

    @abstractmethod
    def gathered(self, force: Floats) -> Floats:
        """Forces that balance what pairs do along what their nodes give up. Collective.

        Args:
            force: Forces at the owned nodes, shape ``(n, 3)`` [N].

        Returns:
            Those at the nodes of the pairs, shape ``(m, 3)`` [N]: at degree 2 mortar contact
            moves the nodes between vertices with these.
        """

    @abstractmethod
    def balance(
        self,
        normal: Floats,
        force: Floats,
        columns: Floats,
        rank: Ints,
        friction: tuple[Floats, Floats] | None,
    ) -> Floats:
        """Multipliers of pairs that balance forces at their nodes. Collective.

        Args:
            normal: Normals of the nodes, along which one multiplier acts, shape ``(m, 3)``.
            force: What is to be balanced at the nodes, shape ``(m, 3)`` [N].
            columns: Force per multiplier, shape ``(m, 3, 3 d)``.
            rank: Number of multipliers, 0, 1 or all components of the space, ``(m,)``.
            friction: Tractions that the multipliers balance too, shape ``(m, 2)`` [N], and
                direction of those per pressing force; None without any.

        Returns:
            Shape ``(m, 3)`` [N]; others than these multipliers mean nothing.
        """

    @abstractmethod
    def close_gaps(
        self,
        normal: Floats,
        gradients: Floats,
        gap: Floats,
        held: Flags,
        farthest: Floats,
        u: Floats,
    ) -> None:
        """Move nodes along their normals as far as closes gaps to first order. Collective.

        Args:
            normal: Normals of the nodes, shape ``(m, 3)``.
            gradients: Of the gaps, the first of ``(m, c, 3 d)``.
            gap: Gaps, shape ``(m,)`` [m].
            held: Pairs whose nodes move, shape ``(m,)``.
            farthest: Longest ways, ``(m,)``; nodes that would go farther stay [m].
            u: Displacements of the owned nodes, which are changed, shape ``(n, d)`` [m].
        """


class OwnBlocks(PairBlocks):
    """One block for each pair, and no constraint that reaches the node of another pair.

    Args:
        dofs: Nodes of the pairs, shape ``(m, k)``.
        free: 1 where the displacement is unknown, otherwise 0, shape ``(m, 3 k)``; None if all
            are unknown.
        tangent: Derivative of the force of each multiplier, shape ``(m, 3 k, 3 k)`` [1/m].
    """

    may_overlap = False

    def __init__(self, dofs: Ints, free: Floats | None, tangent: Floats) -> None:
        self.dofs = self.nodes = dofs
        self._free, self._tangent = free, tangent

    def tangent(self, lambda_N: Floats) -> Floats:
        blocks: Floats = lambda_N[:, None, None] * self._tangent
        return blocks

    def of(self, active: Flags) -> Ints:
        return active.nonzero()[0].astype(np.int32)

    def restrict(self, force: Floats, tangent: Floats) -> Floats:
        if self._free is None:
            return force
        tangent *= self._free[:, :, None] * self._free[:, None, :]
        return force * self._free

    def gathered(self, force: Floats) -> Floats:
        return force[self.dofs[:, 0]]

    def balance(
        self,
        normal: Floats,
        force: Floats,
        columns: Floats,
        rank: Ints,
        friction: tuple[Floats, Floats] | None,
    ) -> Floats:
        tractions = np.zeros((2, len(rank), 2)) if friction is None else friction
        return _kernels.balance(normal, force, columns, rank, *tractions)

    def close_gaps(
        self,
        normal: Floats,
        gradients: Floats,
        gap: Floats,
        held: Flags,
        farthest: Floats,
        u: Floats,
    ) -> None:
        normal = normal[:, : u.shape[1]]
        _kernels.close_gaps(self.dofs[:, 0], held, gap, normal, gradients, farthest, u)
