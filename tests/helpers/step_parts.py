"""Parts of a step: its forms, and contact forces along a motion."""

from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_nts.integrators.implicit.implicit_forms import StepForms

Array = npt.NDArray[np.float64]


def step_forms(stepper: Any) -> StepForms:
    """Forms of a step of an implicit stepper."""
    return StepForms(stepper.bodies, stepper._rates, stepper.scheme)


def following(state: Any, local: Array) -> Array:
    """Forces of springs and friction of pairs along a motion ``local``, both ``(m, d)``."""
    rows = state.pairs.gradients, state.slopes, state.columns
    values: Array = np.einsum("mjb,mij,mia,mb->ma", *rows, local, optimize=True)
    return values
