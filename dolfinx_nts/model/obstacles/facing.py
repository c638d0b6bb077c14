"""Admissible contact directions of points: on the outer side of their body."""

from dataclasses import dataclass

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints

__all__ = ["Facing"]

# Arguments for nodes without facets, which may touch all segments.
_NO_FACETS = _kernels.NodeFacets(
    np.empty((0, 3), dtype=np.int32),
    np.empty(0),
    np.zeros(2, dtype=np.int32),
    np.empty(0, dtype=np.int32),
    np.empty(0, dtype=np.int32),
    np.empty(0),
)
_NO_POSITIONS: Floats = np.empty((0, 3))


@dataclass(frozen=True)
class Facing:
    """Directions in which points can be touched, by the facets around them at t_n. Local.

    See `cpp/nts/search/facing.h`.

    Attributes:
        facets: Facets around the nodes of a surface.
        x: Positions of the vertices of these facets, shape ``(f, 3)`` [m].
        numbers: Number of each point among these nodes, shape ``(p,)``.
    """

    facets: _kernels.NodeFacets
    x: Floats
    numbers: Ints

    @classmethod
    def everywhere(cls, num_points: int) -> "Facing":
        """Points with any contact direction."""
        return cls(_NO_FACETS, _NO_POSITIONS, np.zeros(num_points, dtype=np.int32))

    def take(self, points: Ints) -> "Facing":
        """Select some of the points."""
        return Facing(self.facets, self.x, self.numbers[points])

    @property
    def arguments(self) -> tuple[_kernels.NodeFacets, Floats, Ints]:
        """The attributes in the order in which kernels take them."""
        return self.facets, self.x, self.numbers
