"""Global search of smooth segments, which depend on nodes around their facets."""

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.segment_candidates import FoundSegments
from dolfinx_nts.search.smooth.smooth_candidates import SmoothCandidates
from dolfinx_nts.search.smooth.smooth_patches import SmoothPatches
from dolfinx_nts.search.spheres.sphere_frame import SphereFrame

__all__ = ["SmoothSearch", "depth_beneath_facets"]


class SmoothSearch(GlobalSearch):
    """Search for smooth segments near nodes of another surface.

    Args:
        nodes: Surface of the nodes.
        segments: Surface of the segments.
        patches: Patches on its facets, or the frame of its sphere.
    """

    candidates: SmoothCandidates

    def __init__(
        self, nodes: Surface, segments: Surface, patches: SmoothPatches | SphereFrame
    ) -> None:
        super().__init__(nodes, segments)
        self._offer = patches.ids, patches.owners, *self._offer[2:]
        self._weights = (patches.weights,)

    def _make(
        self, found: FoundSegments, others: Ints, x: Floats, reach: float
    ) -> SmoothCandidates:
        return SmoothCandidates(found, self.num_vertices)


def depth_beneath_facets(nodes: Surface, segments: Surface, x: Floats, reach: float) -> float:
    """Largest depth of smooth segments below their facets, of segments near nodes [m]. Collective.

    Args:
        nodes: Surface of the nodes.
        segments: The smooth surface.
        x: Positions of the local nodes of the space, shape ``(l, 3)`` [m].
        reach: Largest distance of segments from nodes [m].
    """
    search = SmoothSearch(nodes, segments, SmoothPatches.of(segments))
    search.renew(x, reach)
    candidates = search.candidates
    depth = candidates.beneath(candidates.scatter.forward(x))
    return reductions.largest(segments.V.mesh.comm, depth)
