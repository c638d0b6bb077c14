"""Von Mises stress, to colour pictures."""

from functools import cache

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.jit import compile_expression
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.materials.hyperelastic import Hyperelastic

__all__ = ["von_mises"]


def von_mises(stepper: Stepper) -> Floats:
    """Von Mises stress in the middle of the owned cells' pieces, body by body [Pa]. Local."""
    mesh, element = stepper.u.function_space.mesh, Element.of(stepper.u.function_space)
    middles = element.points[element.pieces].mean(axis=1)
    F = ufl.Identity(3) + ufl.grad(stepper.u)

    @cache
    def of(material: Hyperelastic) -> fem.Expression:
        # Constants, as numbers would become part of the compiled code.
        parameters = {k: fem.Constant(mesh, v) for k, v in material.parameters.items()}
        sigma = F * material.stress(F.T * F, **parameters) * F.T / ufl.det(F)
        stress = ufl.sqrt(1.5 * ufl.inner(ufl.dev(sigma), ufl.dev(sigma)))
        return compile_expression(stress, middles)

    values = [of(body.material).eval(mesh, body.cells).reshape(-1) for body in stepper.bodies]
    return np.concatenate(values)
