"""Blocks of pairs in the tangent, and systems for the multipliers."""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, Ints, indices

__all__ = ["OwnBlocks", "PairBlocks"]


class PairBlocks(ABC):
    """Blocks of ``m`` pairs in the tangent, and elimination of constraints.

    Attributes:
        dofs: Nodes of the pairs, the one with the multiplier first, shape ``(m, d)``.
        nodes: Nodes of the blocks, shape ``(p, k)``.
        may_overlap: Whether a constraint may depend on constrained nodes of other pairs.
    """

    dofs: Ints
    nodes: Ints
    may_overlap: ClassVar[bool]

    @abstractmethod
    def tangent(self, lambda_N: Floats) -> Floats:
        """Geometric tangent for multipliers ``(m,)`` [N], shape ``(p, 3 k, 3 k)`` [N/m]."""

    @abstractmethod
    def of(self, active: Flags) -> Ints:
        """Indices of the blocks of the pairs flagged in ``active``, ``(m,)``. Local."""

    @abstractmethod
    def restrict(self, force: Floats, tangent: Floats) -> Floats:
        """Set entries of prescribed displacements to 0; returns the forces ``(m, 3 d)`` [N]. Local.

        Rows and columns of the tangent, ``(p, 3 k, 3 k)`` [N/m], are set to 0 in place.
        """

    @abstractmethod
    def gathered(self, force: Floats) -> Floats:
        """Forces conjugate to the eliminated displacements of the pairs. Collective.

        Args:
            force: Forces at the owned nodes, shape ``(n, 3)`` [N].

        Returns:
            Forces at the nodes of the pairs, shape ``(m, 3)`` [N]; in mortar contact of degree 2
            including mid-nodes.
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
            normal: Normals of the nodes, the directions of single multipliers, shape ``(m, 3)``.
            force: Forces to be balanced at the nodes, shape ``(m, 3)`` [N].
            columns: Force per multiplier, shape ``(m, 3, 3 d)``.
            rank: Number of multipliers, 0, 1 or all components of the space, ``(m,)``.
            friction: Tractions to be balanced, shape ``(m, 2)`` [N], and tractions per unit normal
                force; None without friction.

        Returns:
            Multipliers, shape ``(m, 3)`` [N]; entries beyond the rank are undefined.
        """

    @abstractmethod
    def close_gaps(
        self,
        normal: Floats,
        gradients: Floats,
        gap: Floats,
        moves: Flags,
        farthest: Floats,
        u: Floats,
    ) -> None:
        """Move nodes along their normals to close gaps to first order. Collective.

        Args:
            normal: Normals of the nodes, shape ``(m, 3)``.
            gradients: Gradients, gaps first, shape ``(m, c, 3 d)``.
            gap: Gaps, shape ``(m,)`` [m].
            moves: Flags of pairs whose nodes move, shape ``(m,)``.
            farthest: Largest displacements, ``(m,)`` [m]; nodes that would move farther are not
                moved.
            u: Displacements of the owned nodes, shape ``(n, d)`` [m], changed in place.
        """


class OwnBlocks(PairBlocks):
    """One block for each pair, without constrained nodes of other pairs.

    Args:
        dofs: Nodes of the pairs, shape ``(m, k)``.
        free: 1 at unknown displacements, otherwise 0, shape ``(m, 3 k)``; None if all are unknown.
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
        return indices(active)

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
        moves: Flags,
        farthest: Floats,
        u: Floats,
    ) -> None:
        normal = normal[:, : u.shape[1]]
        _kernels.close_gaps(self.dofs[:, 0], moves, gap, normal, gradients, farthest, u)
