"""Contact of a surface with itself: search that leaves out neighbours.

What a node may touch is decided by normals, by the thickness of the cells
and by the positions at rest, see `cpp/nts/own_surface.h`.
"""

import numpy as np
import numpy.typing as npt

from dolfinx_nts.model.surfaces import area_vectors
from dolfinx_nts.neighbourhood import Neighbourhood
from dolfinx_nts.search import Search

__all__ = ["OwnNeighbourhood", "OwnSearch"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


class OwnNeighbourhood(Neighbourhood):
    """Segments of a surface within reach of its own nodes. Collective.

    Args:
        here: The segments; among them all those around this rank's nodes.
        X: Positions at rest of the owned nodes, shape ``(n, 3)`` [m].
    """

    def __init__(self, here: Neighbourhood, X: Floats) -> None:
        """Fetch the positions at rest."""
        super().__init__(
            here.index_map, here.segments, here.orientation, here.key, here.size, here.thickness
        )
        self._X = self.with_ghosts(X)
        self._N = self._normals(self._X)

    def _found(
        self, x: Floats, nodes: Ints, current: Ints, slack: float, reach: float
    ) -> tuple[Ints, Floats, Floats, Floats]:
        return self._kernel.pair_own(
            x[nodes],
            current,
            slack,
            reach,
            x,
            self._normals(x)[nodes],
            self._X[nodes],
            self._N[nodes],
            self._X,
            self.thickness,
        )

    def _normals(self, x: Floats) -> Floats:
        """Normals of the surface, of any length; right at owned nodes."""
        normals = np.zeros_like(x)
        areas = area_vectors(x[self.segments], self.orientation)
        for vertex in self.segments.T:
            np.add.at(normals, vertex, areas)
        return normals


class OwnSearch(Search):
    """Keeps the neighbourhood of a surface with itself up to date."""

    def _exchange(self, x: Floats, reach: float) -> OwnNeighbourhood:
        X = self._nodes.V.tabulate_dof_coordinates()
        num_owned = self._nodes.V.dofmap.index_map.size_local
        return OwnNeighbourhood(super()._exchange(x, reach), X[:num_owned])
