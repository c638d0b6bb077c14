"""Forms: how FFCx compiles them, their values, and forms on a part of the cells."""

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from ufl.algorithms import extract_coefficients
from ufl.algorithms.analysis import extract_constants

__all__ = ["CellForm", "assembled", "compile_form"]

Floats = npt.NDArray[np.float64]

# As fast as -ffast-math but for the assumption that there are no NaNs.
_OPTIONS = {
    "cffi_extra_compile_args": [
        "-O3",
        "-march=native",
        "-ffp-contract=fast",
        "-fno-math-errno",
        "-fno-trapping-math",
        "-fno-signed-zeros",
        "-fassociative-math",
    ]
}

compile_form = partial(fem.form, jit_options=_OPTIONS)


def assembled(form: fem.Form) -> Floats:
    """A linear form on the owned dofs, summed over the ranks. Collective.

    Args:
        form: The form, compiled.
    """
    vector = fem.assemble_vector(form)
    vector.scatter_reverse(la.InsertMode.add)
    values: Floats = vector.array[: vector.block_size * vector.index_map.size_local]
    return values


class CellForm:
    """A form of `bulk_form` with one argument, compiled once.

    Args:
        form: Linear form.

    Attributes:
        everywhere: On the cells of its measures.
    """

    def __init__(self, form: ufl.Form) -> None:
        """Compile."""
        self._ufl = form
        self._regions = form.integrals()[0].subdomain_data()
        self.everywhere: fem.Form = compile_form(form)
        self._compiled: Any = None

    def without(self, cells: npt.NDArray[np.int32]) -> fem.Form:
        """On all cells but these; collective for the first time.

        Args:
            cells: Owned cells.
        """
        form, V = self._ufl, self._ufl.arguments()[0].ufl_function_space()
        if self._compiled is None:
            self._compiled = fem.compile_form(V.mesh.comm, form, jit_options=_OPTIONS)
        return fem.create_form(
            self._compiled,
            [V],
            V.mesh,
            {fem.IntegralType.cell: [(i, np.setdiff1d(all_, cells)) for i, all_ in self._regions]},
            {item: item for item in extract_coefficients(form)},
            {item: item for item in extract_constants(form)},
        )
