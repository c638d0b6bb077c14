r"""Mean gradients of vector fields in axisymmetric quadrilaterals.

Axisymmetric integrals have the radius r as a weight, and the gradient has the hoop component v_r/r.
With :math:`A = \int r\, dA`, the derivatives :math:`X_1, X_2, X_{12}` of the position with respect
to the reference coordinates, and v at the centre, the means are

.. math:: \frac1A \int \nabla v\, r\, dA = \nabla v + (X_1 \cdot \nabla\nabla v \cdot X_2)
   \otimes b , \qquad \frac1A \int v_r\, dA = a_0 v_r + a \cdot \nabla v_r
   + a_{12}\, X_1 \cdot \nabla\nabla v_r \cdot X_2 ,

since a bilinear field has four coefficients, and a linear field has a constant gradient.
"""

import basix
import numpy as np

from dolfinx_nts.common.arrays import Floats

__all__ = ["PLANE_ENTRIES", "ring_means"]

# Entries of a symmetric tensor, in the order in which they are stored.
PLANE_ENTRIES = ((0, 0), (1, 1), (0, 1))
# Quadrature degree that is exact for r times derivatives of shape functions [-].
_DEGREE = 4
# Bilinear shape functions about the centre: coefficients of 1, of both coordinates and of their
# product, by vertex.
_SIGNS = np.array([[1.0, x / 2, y / 2, x * y / 4] for y in (-1, 1) for x in (-1, 1)])


def ring_means(x: Floats) -> Floats:
    """Coefficients of the means from the geometry of cells. Local.

    Args:
        x: Vertices in Basix order, shape ``(c, 4, 3)``, the radius first [m].

    Returns:
        Shape ``(c, 13)``: for each of `PLANE_ENTRIES` two coefficients of the gradient [m]; the
        coefficients of value, both derivatives and `PLANE_ENTRIES` in the hoop mean [1/m, -, m];
        and the ratio of the volume to its one-point estimate [-].
    """
    element = basix.create_element(basix.ElementFamily.P, basix.CellType.quadrilateral, 1)
    points, weights = basix.make_quadrature(basix.CellType.quadrilateral, _DEGREE)
    values, *slopes = element.tabulate(1, points)[..., 0]
    X1, X2, X12 = (np.einsum("a,cai->ci", _weights(i), x[:, :, :2]) for i in (1, 2, 3))
    J = np.einsum("jqa,cai->cqij", np.array(slopes), x[:, :, :2])
    area = np.abs(np.linalg.det(J)) * weights
    volume = (x[:, :, 0] @ values.T) * area
    gradient = np.einsum("jqa,cqji->cqai", np.array(slopes), np.linalg.inv(J))
    total = volume.sum(axis=1)
    mean = np.einsum("cq,cqai->cai", volume, gradient) / total[:, None, None]
    hoop = area @ values / total[:, None]
    b = np.einsum("a,cai->ci", _SIGNS[:, 3], mean)
    a0, a1, a2, a12 = (hoop @ _SIGNS).T
    entries = np.stack(
        [X1[:, 0] * X2[:, 0], X1[:, 1] * X2[:, 1], X1[:, 0] * X2[:, 1] + X1[:, 1] * X2[:, 0]],
        axis=1,
    )
    slope = a1[:, None] * X1 + a2[:, None] * X2 + a12[:, None] * X12
    middle = x[:, :, 0].mean(axis=1) * np.abs(X1[:, 0] * X2[:, 1] - X1[:, 1] * X2[:, 0])
    return np.column_stack(
        [
            (entries[:, :, None] * b[:, None]).reshape(len(x), 6),
            *(a0, slope, a12[:, None] * entries, total / middle),
        ]
    )


def _weights(i: int) -> Floats:
    """Weights of the vertices in a derivative at the centre: first, second or mixed."""
    weights: Floats = _SIGNS[:, i] * (1.0 if i < 3 else 4.0)
    return weights
