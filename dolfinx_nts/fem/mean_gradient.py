r"""Mean gradients of vector fields in cells, for terms with a single quadrature point.

The gradient at the centre of a distorted hexahedron differs from the mean :math:`\bar G = \int
\nabla v\, dX / V`. With the former, nodal forces of a uniform stress would not equal its tractions.
The mean has a closed form (Flanagan and Belytschko 1981). With the derivatives :math:`X_i`,
:math:`X_{ij}` of the position at the centre of the reference cell the volume is

.. math:: V = [X_1, X_2, X_3] + ([X_1, X_{12}, X_{31}] + [X_{12}, X_2, X_{23}]
   + [X_{31}, X_{23}, X_3])/12,

and :math:`\bar G = \nabla v + \sum_{ij} (X_i \cdot \nabla\nabla v \cdot X_j) \otimes (\partial
V/\partial X_{ij}) / V`, with the gradients at the centre. In tetrahedra, triangles and plane
quadrilaterals the gradient at the centre is the mean. In axisymmetric quadrilaterals it is not, see
`ring_means`.
"""

from collections.abc import Sequence
from typing import Any, ClassVar
from weakref import WeakKeyDictionary

import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.mesh import Mesh
from ufl.algorithms.analysis import extract_arguments, extract_coefficients
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction

from dolfinx_nts import compat
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.axisymmetry import is_axisymmetric
from dolfinx_nts.fem.cell_constant import CellConstant
from dolfinx_nts.fem.ring_means import PLANE_ENTRIES, ring_means
from dolfinx_nts.parallel import reductions

__all__ = ["with_mean_gradients"]

# Entries of a symmetric tensor, in the order in which they are stored.
_ENTRIES = ((0, 0), (1, 1), (2, 2), (1, 2), (2, 0), (0, 1))
# Signs of the vertex coordinates relative to the centre.
_SIGNS = np.array([[2.0 * (i >> axis & 1) - 1.0 for axis in range(3)] for i in range(8)])

# Vertex positions and coefficients by mesh, shared by all forms to save memory. Only the vector is
# cached: a function would keep its mesh alive.
_KNOWN: WeakKeyDictionary[Mesh, tuple[Floats, la.Vector]] = WeakKeyDictionary()


def with_mean_gradients(value: Any, V: fem.FunctionSpace) -> Any:
    """Replace gradients of functions by their means in each cell. Collective.

    Args:
        value: UFL scalar, to be integrated with one point per cell.
        V: Space of the functions, of degree 1.

    Returns:
        UFL scalar whose one-point integral uses the exact volumes of the cells as weights.
    """
    mesh = V.mesh
    axisymmetric = is_axisymmetric(mesh)
    if mesh.topology.cell_name() != ("quadrilateral" if axisymmetric else "hexahedron"):
        return value
    known = _KNOWN.get(mesh)
    is_same = known is not None and np.array_equal(known[0], mesh.geometry.x)
    if known is None or not reductions.everywhere(mesh.comm, is_same):
        x = mesh.geometry.x[compat.geometry_nodes(mesh)]
        numbers = (ring_means if axisymmetric else _numbers)(x)
        new = CellConstant(mesh, numbers.shape[1])
        new.x.array.reshape(numbers.shape)[new.function_space.dofmap.list[:, 0]] = numbers
        known = _KNOWN[mesh] = mesh.geometry.x.copy(), new.x
    # The values are shared by all forms on the mesh.
    coefficients = CellConstant(mesh, known[1].block_size, known[1])
    means = (_RingMeans if axisymmetric else _MeanGradients)(V, coefficients)
    return means.volume * map_expr_dag(means, value)


class _MeanGradients(MultiFunction):  # type: ignore[misc]
    """Replaces gradients of functions of a space by their means.

    Args:
        V: The space.
        coefficients: Result of `_numbers` by cell.
    """

    expr = MultiFunction.reuse_if_untouched
    entries: ClassVar[Sequence[tuple[int, int]]] = _ENTRIES

    def __init__(self, V: fem.FunctionSpace, coefficients: CellConstant) -> None:
        super().__init__()
        self._V, self._coefficients = V, coefficients
        self._axes = range(V.mesh.geometry.dim)

    @property
    def volume(self) -> Any:
        """Ratio of the exact volume of a cell to its one-point estimate, UFL."""
        return self._coefficients[len(self._coefficients) - 1]

    def grad(self, o: Any) -> Any:
        """Gradient plus the difference between its mean and its value at the centre."""
        (v,), axes, d = o.ufl_operands, self._axes, len(self._axes)
        if not all(self._is_function_of(f) for f in _functions(v)):
            return o
        second = ufl.grad(o)
        rest = [[self._times(second, i, slice(m, None, d)) for m in axes] for i in axes]
        return o + ufl.as_matrix(rest)

    def _is_function_of(self, function: Any) -> bool:
        """Whether the space of a function is V, or a mixed space with V as its first component."""
        space, V = function.ufl_function_space(), self._V
        elements = space.ufl_element().sub_elements
        return space == V or (len(elements) > 0 and elements[0] == V.ufl_element())

    def _times(self, second: Any, i: int, places: slice) -> Any:
        """Sum over `entries` of second derivatives of component i times cell coefficients."""
        numbers = range(len(self._coefficients))[places]
        return sum(
            second[i, j, k] * self._coefficients[n]
            for (j, k), n in zip(self.entries, numbers, strict=False)
        )


class _RingMeans(_MeanGradients):
    """Replaces gradients, and values over the radius, by their axisymmetric means.

    Arguments as for `_MeanGradients`, with the result of `ring_means`.
    """

    entries = PLANE_ENTRIES

    def coefficient(self, o: Any) -> Any:
        """Replace the radial component v_r by r times the mean of v_r/r."""
        if not self._is_function_of(o):
            return o
        c, first, r = self._coefficients, ufl.grad(o), ufl.SpatialCoordinate(self._V.mesh)[0]
        mean = o[0] * c[6] + first[0, 0] * c[7] + first[0, 1] * c[8]
        mean += self._times(ufl.grad(first), 0, slice(9, None))
        return ufl.as_vector([r * mean, *(o[i] for i in range(1, len(o)))])

    argument = coefficient


def _functions(v: Any) -> list[Any]:
    return [*extract_coefficients(v), *extract_arguments(v)]


def _numbers(x: Floats) -> Floats:
    r"""Coefficients of the means, ``(c, 19)``, from vertices of cells, ``(c, 8, 3)`` [m]. Local.

    They are the vectors :math:`c_{jk}` of :math:`\bar G = \nabla v + \sum_{j \le k} \nabla_j
    \nabla_k v \otimes c_{jk}` [m], and the ratio of the volume to its one-point estimate [-].
    """
    first = [np.einsum("a,cai->ci", _SIGNS[:, i] / 4, x) for i in range(3)]
    pairs = ((1, 2), (2, 0), (0, 1))
    X23, X31, X12 = (np.einsum("a,cai->ci", _SIGNS[:, [i, j]].prod(1) / 2, x) for i, j in pairs)
    X1, X2, X3 = first
    estimate = _triple(X1, X2, X3)
    volume = estimate + (_triple(X1, X12, X31) + _triple(X12, X2, X23) + _triple(X31, X23, X3)) / 12
    slopes = (
        (np.cross(X12, X2) + np.cross(X3, X31)) / 12,
        (np.cross(X1, X12) + np.cross(X23, X3)) / 12,
        (np.cross(X31, X1) + np.cross(X2, X23)) / 12,
    )
    c = np.zeros((len(x), 3, 3, 3))
    for (i, j), slope in zip(pairs, slopes, strict=True):
        c += np.einsum("cj,ck,cm->cjkm", first[i], first[j], slope)
    c /= volume[:, None, None, None]
    by_entry = [c[:, j, k] + c[:, k, j] if j != k else c[:, j, j] for j, k in _ENTRIES]
    return np.column_stack([*by_entry, volume / estimate])


def _triple(a: Floats, b: Floats, c: Floats) -> Floats:
    """Triple products of vectors, shape ``(c,)`` [m^3]."""
    volumes: Floats = np.einsum("ci,ci->c", a, np.cross(b, c))
    return volumes
