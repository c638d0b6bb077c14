"""Checksums of rows that do not depend on the partition."""

import numpy as np

from dolfinx_nts.common.arrays import Array, GlobalInts

__all__ = ["checksum"]


def checksum(numbers: GlobalInts, values: Array) -> int:
    """Sum of hashes of rows and their numbers, modulo 2^64. Local.

    The rows may have any order and distribution: sums of parts add up.

    Args:
        numbers: Number of each row, shape ``(n,)``.
        values: The rows, shape ``(n, ...)``.

    Returns:
        The sum.
    """
    if not values.size:
        return 0
    rows = np.ascontiguousarray(values).reshape(len(numbers), -1).view(np.uint8)
    words = np.pad(rows, ((0, 0), (0, -rows.shape[1] % 8))).view(np.uint64)
    keys = np.asarray(numbers).astype(np.uint64)[:, None] * np.uint64(words.shape[1])
    keys = keys + np.arange(words.shape[1], dtype=np.uint64)
    return int(_hashes(_hashes(keys) + words).sum(dtype=np.uint64))


def _hashes(words: Array) -> Array:
    """Hash of words: finaliser of SplitMix64 (Steele, Lea and Flood, OOPSLA 2014, section 4)."""
    words = words + np.uint64(0x9E3779B97F4A7C15)
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    scrambled: Array = words ^ (words >> np.uint64(31))
    return scrambled
