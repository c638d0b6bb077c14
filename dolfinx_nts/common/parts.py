"""Arrays of several parts, one after the other: counts and extremes of each part."""

import numpy as np

from dolfinx_nts.common.arrays import Array, Flags, Floats

__all__ = ["counts_of_parts", "largest_of_parts"]


def counts_of_parts(flags: Flags, ends: Array) -> Array:
    """Count how many flags of each of ``c`` parts are set, shape ``(c,)``. Local.

    Args:
        flags: Those of all parts, shape ``(m,)``.
        ends: Where each part begins, and the end, shape ``(c + 1,)``.
    """
    found = np.searchsorted(flags.nonzero()[0], ends)
    counts: Array = found[1:] - found[:-1]
    return counts


def largest_of_parts(values: Floats, ends: Array) -> Floats:
    """Find the largest value of each of ``c`` parts, 0 where it has none, ``(c,)``. Local.

    Args:
        values: Those of all parts, not negative, shape ``(m,)``.
        ends: Where each part begins, and the end, shape ``(c + 1,)``.
    """
    largest, begin = np.zeros(len(ends) - 1), ends[:-1]
    present = begin < ends[1:]
    if present.any():
        largest[present] = np.maximum.reduceat(values, begin[present])
    return largest
