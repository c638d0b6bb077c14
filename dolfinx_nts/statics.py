"""Quasi-static load stepping: the same bodies and pairs without inertia."""

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl

from dolfinx_nts.bodies import bulk_form
from dolfinx_nts.integrators import Stepper, right_cauchy_green
from dolfinx_nts.materials import Hyperelastic

__all__ = ["QuasiStatic"]

Floats = npt.NDArray[np.float64]


class QuasiStatic(Stepper):
    """Equilibrium at the end of each step; time only counts the load.

    Contact is closed, g = 0 (there is no impact, so the kind of impact of
    a multiplier does not matter); friction follows the slip from step to
    step. Supports must leave no body free to move rigidly, unless contact
    holds it. Arguments and attributes are those of `EnergyMomentum`; the
    velocity stays zero.
    """

    _contact = "static"
    _trial = "extrapolated"

    def _stress(self, material: Hyperelastic, parameters: Any, F_n: Any, F: Any) -> Any:
        return material.stress(right_cauchy_green(F), **parameters)

    def _residual(self) -> ufl.Form:
        u = self.u
        eta = ufl.TestFunction(u.function_space)
        F = ufl.Identity(3) + ufl.grad(u)

        def integrand(material: Hyperelastic, parameters: dict[str, Any], rho: Any) -> Any:
            S = material.stress(right_cauchy_green(F), **parameters)
            return ufl.inner(F * S, ufl.grad(eta))

        return bulk_form(self.bodies, integrand)

    def _starts(self) -> dict[str, Floats]:
        u_n = self.u_n.x.array
        return {"extrapolated": u_n + self.dt * self._mean_velocity, "last": u_n}

    def _update_velocity(self) -> None:
        pass
