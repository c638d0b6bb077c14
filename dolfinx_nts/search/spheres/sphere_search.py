"""Global search for segments on a rigid body whose surface is an exact sphere."""

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.segment_candidates import FoundSegments, SegmentCandidates
from dolfinx_nts.search.smooth.smooth_search import SmoothSearch
from dolfinx_nts.search.spheres.sphere_candidates import SphereCandidates
from dolfinx_nts.search.spheres.sphere_frame import SphereFrame

__all__ = ["SphereSearch"]


class SphereSearch(SmoothSearch):
    """Search for facets of a sphere near nodes of another surface.

    Args:
        nodes: Surface of the nodes.
        segments: Surface of a rigid body with a sphere as its shape.
    """

    def __init__(self, nodes: Surface, segments: Surface) -> None:
        self._frame = SphereFrame(segments)
        super().__init__(nodes, segments, self._frame)

    def update(self, x: Floats, reach: float) -> tuple[SegmentCandidates, bool]:
        return super().update(x, reach + self._frame.bulge)

    def _make(
        self, found: FoundSegments, others: Ints, x: Floats, reach: float
    ) -> SphereCandidates:
        return SphereCandidates(found, self.num_vertices, self._frame.sphere, self._frame.bulge)
