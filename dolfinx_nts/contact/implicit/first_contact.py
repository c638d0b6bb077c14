"""Step fraction at first contact of separated nodes."""

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.fem.components import in_space

__all__ = ["fraction_until_contact"]


# Largest penetration of separated nodes in an increment, relative to the smaller one of their cells
# and of the segment [-].
_DEEPEST = 0.15


def fraction_until_contact(step: ContactStep, increment: Floats, size: Floats) -> float:
    """Fraction of an increment, from 0 to 1, at which a separated node first penetrates too deep.

    The remaining motion of an obstacle is part of the increment, to first order. Collective; the
    result is for this rank.

    Args:
        step: Evaluated contact of the step.
        increment: Increments of the owned nodes, shape ``(n, d)`` [m].
        size: Sizes of the cells at the nodes, shape ``(n,)`` [m].
    """
    search, frame, normal = step.search, step.state.search.frame, step.normal
    given, _ = frame.remaining(step.x)
    increments = step.candidates.scatter.forward(in_space(increment)) - given
    apart = normal.nodes[~normal.active[normal.nodes]]
    none = np.full(len(apart), -1, dtype=np.int32)
    ends = step.x, step.x + increments @ frame.end.rotation
    met = step.candidates.follow(search.points.take(apart), *ends, none)
    depth = _DEEPEST * np.fmin(
        size[step.state.nodes.nodes[apart]], step.candidates.size[met.entered]
    )
    deep = (met.entered >= 0) & (met.begin > 0) & (met.gap < -depth)
    begin, gap, depth = met.begin[deep], met.gap[deep], depth[deep]
    return float((begin - (1 - begin) * depth / gap).min(initial=1.0))
