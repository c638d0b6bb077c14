"""Nodes within some cells of others."""

from dolfinx import fem, la

from dolfinx_nts.common.arrays import Floats

__all__ = ["add_surroundings"]


def add_surroundings(marker: la.Vector, V: fem.FunctionSpace, rings: int) -> None:
    """Mark also the nodes within some cells of those that are marked. Collective.

    Args:
        marker: Not zero at these nodes, owned or ghost, of any rank; changed in place.
        V: Space whose nodes they are.
        rings: Number of cells.
    """
    _share(marker)
    marks: Floats = marker.array
    nodes = V.dofmap.list
    for _ in range(rings):
        marks[nodes[marks.take(nodes).any(axis=1)]] = 1
        _share(marker)


def _share(marker: la.Vector) -> None:
    """Let all ranks know what is marked on any of them. Collective."""
    marker.scatter_reverse(la.InsertMode.add)
    marker.scatter_forward()
