"""Constraints and tangent blocks of the active contacts in a linear system."""

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Array, Flags, Floats, GlobalInts, Ints
from dolfinx_nts.solvers.linear.block_csr import entries_of_rows, starts

__all__ = ["ContactBlocks", "rows_of", "slopes_at_nodes", "tangents_of"]


class ContactBlocks(NamedTuple):
    """Constraints of some nodes and blocks of the tangent, see `cpp/nts/solvers/elimination.h`.

    Constraints and blocks have separate lists of nodes. The lists of the constraints may differ in
    length: with k nodes and d components, gradients are d rows of d k numbers.

    Attributes:
        start: Offsets of the node lists of the constrained nodes, shape ``(m + 1,)``.
        nodes: Nodes of the constraints, list by list, the constrained one first, shape ``(l,)``.
        rank: Number of constraints, 0, 1 or d, shape ``(m,)``.
        normal: Unit normal at the constrained node, shape ``(m, d)``.
        gradients: Gradients of the constraints, ``d d l`` numbers in any shape.
        columns: Force per multiplier, ``d d l`` numbers in any shape.
        slopes: Derivative of the multipliers with respect to gap and slip, for penalty springs and
            friction, shape ``(m, d, d)``.
        tangent_nodes: Nodes of the blocks, shape ``(p, k)``.
        tangent: Blocks, shape ``(p, d k, d k)``.
    """

    start: GlobalInts
    nodes: Array
    rank: Ints
    normal: Floats
    gradients: Floats
    columns: Floats
    slopes: Floats
    tangent_nodes: Array
    tangent: Floats

    @property
    def constrained(self) -> Array:
        """Constrained nodes: nodes with rank > 0."""
        return self.nodes[self.start[:-1][self.rank > 0]]

    def kernel(self) -> _kernels.Elimination:
        """Arguments of the C++ kernels."""
        return _kernels.Elimination(*self)

    def renumbered(self, number: Callable[[Array], Array]) -> "ContactBlocks":
        """Copy with other node numbers.

        Args:
            number: Returns the new numbers of nodes, shape ``(n,)``.
        """
        tangent_nodes = number(self.tangent_nodes.ravel()).reshape(self.tangent_nodes.shape)
        return self._replace(nodes=number(self.nodes), tangent_nodes=tangent_nodes)

    def touching(self, flags: Flags, tangent_flags: Flags) -> tuple[Array, Array]:
        """Subset of constraints and blocks whose node lists include flagged nodes.

        Args:
            flags: Flags of ``nodes``, shape ``(l,)``.
            tangent_flags: Flags of ``tangent_nodes``, shape ``(p, k)``.
        """
        row = np.repeat(np.arange(len(self.rank)), np.diff(self.start))
        return np.unique(row[flags]), np.flatnonzero(tangent_flags.any(axis=1))

    def take(self, constraints: Array, blocks: Array) -> "ContactBlocks":
        """Subset of constraints and blocks.

        Args:
            constraints: Indices of the constrained nodes.
            blocks: Indices of the blocks of the tangent.
        """
        start, entries = entries_of_rows(self.start, constraints)
        return ContactBlocks(
            start,
            self.nodes[entries],
            self.rank[constraints],
            self.normal[constraints],
            self.gradients.reshape(-1, self.normal.shape[1] ** 2)[entries],
            self.columns.reshape(-1, self.normal.shape[1] ** 2)[entries],
            self.slopes[constraints],
            self.tangent_nodes[blocks],
            self.tangent[blocks],
        )

    @classmethod
    def concatenated(cls, parts: Sequence["ContactBlocks"]) -> "ContactBlocks":
        """Concatenate several objects, as `take` returns them."""
        lengths = [np.diff(part.start) for part in parts]
        _, *arrays = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        return cls(starts(np.concatenate(lengths)), *arrays)


def rows_of(blocks: ContactBlocks) -> Iterator[tuple[Array, Floats, Floats]]:
    """Nodes, ``(k,)``, gradients and columns, ``(d, d k)``, of each constrained node."""
    d = blocks.normal.shape[1]
    gradients, columns = blocks.gradients.ravel(), blocks.columns.ravel()
    for first, last in pairwise(map(int, blocks.start)):
        part = slice(d * d * first, d * d * last)
        rows = gradients[part].reshape(d, -1), columns[part].reshape(d, -1)
        yield blocks.nodes[first:last], *rows


def tangents_of(blocks: ContactBlocks) -> Iterator[tuple[Array, Floats]]:
    """Nodes, ``(k,)``, and matrices, ``(d k, d k)``, whose sum is the contact tangent."""
    yield from zip(blocks.tangent_nodes, blocks.tangent, strict=True)
    for (nodes, gradients, columns), slope in zip(rows_of(blocks), blocks.slopes, strict=True):
        if slope.any():
            yield nodes, columns.T @ slope @ gradients


def slopes_at_nodes(blocks: ContactBlocks) -> Floats:
    """Tangent of the constrained nodes due to the slopes, ``(m, d, d)``."""
    return _kernels.slopes_at_nodes(blocks.start, blocks.gradients, blocks.columns, blocks.slopes)
