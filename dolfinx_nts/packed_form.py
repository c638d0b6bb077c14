"""Linear forms whose functions stay packed while they do not change."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import cpp, fem

from dolfinx_nts.forms import compile_form

__all__ = ["Coefficients", "PackedForm"]

Floats = npt.NDArray[np.float64]


class Coefficients:
    """Values of functions cell by cell, as the kernels of a form read them.

    Args:
        form: The form.
        functions: Those of its functions that are watched.

    Attributes:
        packed: All functions of the form, as DOLFINx wants them.
    """

    packed: dict[Any, Floats]

    def __init__(self, form: fem.Form, functions: Sequence[fem.Function]) -> None:
        """Pack at the first update."""
        self._form = form
        self._values: list[Floats] = [f.x.array for f in functions]
        self._before: list[Floats] | None = None

    def update(self) -> bool:
        """Pack if a watched function has changed; whether that was so. Local."""
        if self._before is not None and all(map(_same, self._values, self._before)):
            return False
        self._before = [values.copy() for values in self._values]
        self.packed = cpp.fem.pack_coefficients(self._form._cpp_object)
        return True


class PackedForm:
    """A linear form over whatever, compiled. Collective.

    Args:
        form: The form, not empty.
    """

    def __init__(self, form: ufl.Form) -> None:
        """Compile."""
        self._form = compile_form(form)
        self._coefficients = Coefficients(self._form, form.coefficients())

    def assemble(self, b: Floats) -> None:
        """Add the form on the cells and facets of this rank. Local.

        Args:
            b: Values at the local dofs, shape ``(3 l,)``.
        """
        self._coefficients.update()
        fem.assemble_vector(b, self._form, coeffs=self._coefficients.packed)


def _same(values: Floats, before: Floats) -> bool:
    """Whether all bits are the same."""
    return np.array_equal(values.view(np.int64), before.view(np.int64))
