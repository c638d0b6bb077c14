"""Von Mises stress, to colour pictures."""

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.cell_stress import CellStress

__all__ = ["von_mises"]


def von_mises(stepper: Stepper) -> Floats:
    """Von Mises stress at the centres of the owned cells' pieces, by body [Pa]. Collective."""
    middles = Element.of(stepper.u.function_space).middles
    remembered = stepper.memory.stress
    stress = CellStress(stepper.bodies, stepper.u, middles, remembered).evaluate().von_mises()
    cells = np.concatenate([body.cells for body in stepper.bodies])
    values: Floats = stress[cells].ravel()
    return values
