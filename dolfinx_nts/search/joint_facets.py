"""Facets around the nodes of several surfaces, for joint evaluation."""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts.search.nodal_facets import AroundNodes, NodalFacets
from dolfinx_nts.search.scatter import joint_scatter

__all__ = ["JointFacets"]


class JointFacets(NodalFacets):
    """Facets around the nodes of several surfaces, see `NodalFacets`. Collective.

    Points are the nodes of all surfaces, surface by surface. Each surface may touch one group of
    segments of `JointCandidates`.

    Args:
        parts: Facets of each surface, of one shape.
    """

    def __init__(self, parts: Sequence[NodalFacets]) -> None:
        around = [part.around for part in parts]
        scatter, rows = joint_scatter([each.scatter for each in around])
        vertices = [
            each.vertices if own is None else own[each.vertices]
            for each, own in zip(around, rows, strict=True)
        ]
        first = np.cumsum([0, *(len(each.vertices) for each in around[:-1])]).astype(np.int32)
        facets = [each.facets + number for each, number in zip(around, first, strict=True)]
        nodes, orientation, counts, corner, angle = (
            np.concatenate([getattr(each, name) for each in around])
            for name in ("nodes", "orientation", "counts", "corner", "angle")
        )
        arrays = np.concatenate(vertices), orientation, counts, np.concatenate(facets), corner
        num_nodes = [len(each.nodes) for each in around]
        group = np.repeat(np.arange(len(parts), dtype=np.int32), num_nodes)
        self._take(AroundNodes(scatter, nodes, *arrays, angle), group)
