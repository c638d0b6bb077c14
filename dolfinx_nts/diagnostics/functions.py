"""DOLFINx Functions from nodal values, and nodal values from Functions."""

from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Array, Floats, Ints
from dolfinx_nts.fem.components import dimension, nodal
from dolfinx_nts.parallel.slabs import Some

__all__ = ["NodalFunctions", "nodal_values"]

_NUMBERS = {2: "two", 3: "three"}


class NodalFunctions:
    """DOLFINx Functions by name; each is created when its values are first set.

    Collective, as its method.

    Args:
        V: Vector space of the nodes.
    """

    def __init__(self, V: fem.FunctionSpace) -> None:
        self._V = V
        self._scalars, self._dofs = V.sub(0).collapse()
        # Exchange of values of owned nodes with ghosts.
        self._carrier = fem.Function(V)
        self._functions: dict[str, fem.Function] = {}

    def set(self, name: str, values: Array | Some) -> fem.Function:
        """Set the values of a Function.

        Args:
            name: Name of the Function.
            values: Values at the owned nodes, shape ``(n,)`` or ``(n, 3)``, or at some of them.

        Returns:
            The Function, in the vector space (with two components in the plane) or in the scalar
            space.
        """
        if isinstance(values, Some):
            values = values.whole(self._V.dofmap.index_map.size_local)
        is_vector = values.ndim == 2
        if name not in self._functions:
            space = self._V if is_vector else self._scalars
            self._functions[name] = fem.Function(space, name=name)
        carried = nodal(self._carrier)
        d = carried.shape[1]
        carried[: len(values)] = values[:, :d] if is_vector else values[:, None]
        self._carrier.x.scatter_forward()
        array = self._carrier.x.array
        self._functions[name].x.array[:] = array if is_vector else array[self._dofs]
        return self._functions[name]


def nodal_values(V: fem.FunctionSpace, function: Any) -> Floats:
    """Values of a Function at the owned nodes of a vector space. Local.

    Args:
        V: The vector space.
        function: Function of it, or of a scalar or vector space of the same degree.

    Returns:
        Values, shape ``(n,)`` or ``(n, d)``.

    Raises:
        ValueError: The space has nodes at other positions.
    """
    W = function.function_space
    element, own = W.ufl_element(), V.ufl_element()
    shape, dim = element.reference_value_shape, dimension(V)
    kinds = [(e.family_name, e.degree, e.discontinuous) for e in (element, own)]
    if W.mesh is not V.mesh:
        raise ValueError("expected a Function on the mesh of the bodies, given one of another mesh")
    if kinds[0] != kinds[1] or shape not in ((), (dim,)):
        raise ValueError(
            f"expected a Lagrange Function of degree {own.degree}, scalar or of {_NUMBERS[dim]} "
            f"components, as at the nodes of the bodies, given one of {element}"
        )
    if W == V:
        order: Ints = np.arange(V.dofmap.index_map.size_local, dtype=np.int32)
    else:
        order = np.empty(V.dofmap.index_map.size_local + V.dofmap.index_map.num_ghosts, np.int32)
        order[V.dofmap.list] = W.dofmap.list
        order = order[: V.dofmap.index_map.size_local]
    values: Floats = function.x.array.reshape(-1, *shape)[order]
    return values
