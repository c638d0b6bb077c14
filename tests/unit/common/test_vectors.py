import numpy as np
import pytest

from dolfinx_nts.common.vectors import cross


@pytest.mark.serial
@pytest.mark.parametrize("m", [0, 1, 7])
def test_cross_products_agree_with_numpy(rng, m):
    a, b = rng.normal(size=(2, m, 3))
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))
