"""Neighbourhoods of nodes."""

from dolfinx import fem, la

from dolfinx_nts.common.arrays import Floats

__all__ = ["add_surroundings"]


def add_surroundings(marker: la.Vector, V: fem.FunctionSpace, layers: int) -> None:
    """Mark all nodes within some layers of cells around marked nodes. Collective.

    Args:
        marker: Nonzero at marked nodes, owned or ghost, on any rank; changed in place.
        V: Space of the nodes.
        layers: Number of layers of cells.
    """
    _combine_marks(marker)
    marks: Floats = marker.array
    nodes = V.dofmap.list
    for _ in range(layers):
        marks[nodes[marks.take(nodes).any(axis=1)]] = 1
        _combine_marks(marker)


def _combine_marks(marker: la.Vector) -> None:
    """Mark nodes that are marked on any rank that shares them. Collective."""
    marker.scatter_reverse(la.InsertMode.add)
    marker.scatter_forward()
