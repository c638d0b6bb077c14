"""Products of many small vectors."""

import numpy as np

from dolfinx_nts.common.arrays import Floats

__all__ = ["cross"]


def cross(a: Floats, b: Floats) -> Floats:
    """Cross products of vectors, ``(m, 3)`` each, identical to ``np.cross``. Local.

    NumPy takes several times as long for the few vectors of a contact pair.
    """
    product: Floats = np.empty_like(a)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[:, j], b[:, k], out=product[:, i])
        product[:, i] -= a[:, k] * b[:, j]
    return product
