"""Where on a way nodes that were apart come to be inside of what they face."""

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.fem.components import in_space

__all__ = ["until_met"]


# Depth to which an increment may bring nodes that were apart into what they meet, relative to the
# smaller one of their cells and of what they meet [-].
_DEEPEST = 0.15


def until_met(step: ContactStep, way: Floats, size: Floats) -> float:
    """Part of a way, from 0 to 1, after which a node that was apart is deep inside.

    The obstacle goes all that is left of its own way, to first order. Collective, but the
    part is that of this rank.

    Args:
        step: An attempt, evaluated.
        way: Ways of the owned nodes, shape ``(n, d)`` [m].
        size: Sizes of the cells at these, shape ``(n,)`` [m].
    """
    search, frame, normal = step.search, step.state.search.frame, step.normal
    given, _ = frame.remaining(step.x)
    ways = step.candidates.scatter.forward(in_space(way)) - given
    apart = normal.nodes[~normal.active[normal.nodes]]
    none = np.full(len(apart), -1, dtype=np.int32)
    ends = step.x, step.x + ways @ frame.end.rotation
    met = step.candidates.follow(search.points.take(apart), *ends, none)
    depth = _DEEPEST * np.fmin(
        size[step.state.nodes.nodes[apart]], step.candidates.size[met.entered]
    )
    deep = (met.entered >= 0) & (met.begin > 0) & (met.gap < -depth)
    begin, gap, depth = met.begin[deep], met.gap[deep], depth[deep]
    return float((begin - (1 - begin) * depth / gap).min(initial=1.0))
