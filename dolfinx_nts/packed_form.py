"""Linear forms whose functions stay packed from one assembly to the next."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from dolfinx import cpp, fem

from dolfinx_nts import _kernels

__all__ = ["PackedForm"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


class PackedForm:
    """A linear form that packs only the functions that have changed.

    The kernels of a form read the values of its functions cell by cell.
    Packing all of them for every assembly, as `fem.assemble_vector` does,
    takes 15 to 30 % of the time of an assembly.

    Args:
        form: The form.
        functions: Its functions, as UFL orders them.
        V: Space whose functions are packed here, if the form has no
            integrals but over cells; None: all are packed by DOLFINx.
        nodes: Nodes of the cells of each integral, in the order of their
            numbers, each ``(c, k)``.

    Attributes:
        num_packed: How often all functions were packed.
    """

    def __init__(
        self,
        form: fem.Form,
        functions: Sequence[fem.Function],
        V: fem.FunctionSpace | None = None,
        nodes: Sequence[Ints] = (),
    ) -> None:
        """Find the columns of the functions."""
        self._form, self.num_packed = form, 0
        positions = form.ufcx_form.original_coefficient_positions
        used = [functions[positions[i]] for i in range(form.ufcx_form.num_coefficients)]
        self._values: list[Floats] = [f.x.array for f in used]
        self._packed: list[Floats] = [values.copy() for values in self._values]
        widths = [f.function_space.element.space_dimension for f in used]
        self._first: list[int] = [sum(widths[:i]) for i in range(len(used))]
        self._ours = [f.function_space == V for f in used]
        self._nodes = list(nodes)
        self._coefficients: dict[tuple[fem.IntegralType, int], Floats] = {}
        self._rows: list[Floats] = []  # the same arrays

    def assemble(self, b: Floats) -> None:
        """Add the form on the cells of this rank. Local.

        Args:
            b: Values at the local dofs, shape ``(3 l,)``.
        """
        self._pack()
        fem.assemble_vector(b, self._form, coeffs=self._coefficients)

    def _pack(self) -> None:
        pairs = enumerate(zip(self._values, self._packed, strict=True))
        changed = [i for i, (values, packed) in pairs if _kernels.follow(values, packed)]
        if not self.num_packed or not all(self._ours[i] for i in changed):
            self._coefficients = packed = cpp.fem.pack_coefficients(self._form._cpp_object)
            # In the order of their numbers, whether these or indices are in the keys.
            self._rows = [packed[key] for key in sorted(packed, key=lambda key: key[1])]
            self.num_packed += 1
            return
        for i in changed:
            x = self._values[i].reshape(-1, 3)
            for rows, nodes in zip(self._rows, self._nodes, strict=True):
                _kernels.pack(x, nodes, self._first[i], rows)
