"""Arrays made of consecutive blocks: counts and maxima of each block."""

import numpy as np

from dolfinx_nts.common.arrays import Array, Flags, Floats

__all__ = ["counts_of_parts", "largest_of_parts"]


def counts_of_parts(flags: Flags, ends: Array) -> Array:
    """Count the set flags of each of ``c`` blocks, shape ``(c,)``. Local.

    Args:
        flags: Flags of all blocks, shape ``(m,)``.
        ends: Offsets of the blocks and the total length, shape ``(c + 1,)``.
    """
    found = np.searchsorted(flags.nonzero()[0], ends)
    counts: Array = found[1:] - found[:-1]
    return counts


def largest_of_parts(values: Floats, ends: Array) -> Floats:
    """Largest value of each of ``c`` blocks, 0 for empty ones, ``(c,)``. Local.

    Args:
        values: Values of all blocks, not negative, shape ``(m,)``.
        ends: Offsets of the blocks and the total length, shape ``(c + 1,)``.
    """
    largest, begin = np.zeros(len(ends) - 1), ends[:-1]
    present = begin < ends[1:]
    if present.any():
        largest[present] = np.maximum.reduceat(values, begin[present])
    return largest
