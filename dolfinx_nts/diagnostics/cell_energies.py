"""Strain energy of the bodies, and the defect of the stress of a step, in one pass over cells."""

from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import deformation_gradient
from dolfinx_nts.fem.linear_forms import CellForm
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.bodies import bulk_form

__all__ = ["CellEnergies"]


class CellEnergies:
    """Integrates the strain energy and the defect of the stress of a step.

    The defect is psi(C) - psi(C_n) - P : (F - F_n), with the stress P of the scheme. In viscous
    branches the energy includes the springs, and the defect also the dissipation. Integrals that
    the last step has computed are reused.

    Args:
        stepper: Stepper whose last step is evaluated.
    """

    def __init__(self, stepper: Stepper) -> None:
        self._stepper = stepper
        u, u_n, memory = stepper.u, stepper.u_n, stepper.memory
        V = u.function_space
        F_n, F = deformation_gradient(u_n), deformation_gradient(u)
        # Constant in cells, so that the assembled vector contains the two integrals over each cell.
        W = fem.functionspace(V.mesh, ("Discontinuous Lagrange", 0, (2,)))
        of_energy, of_defect = ufl.TestFunction(W)

        def integrand(material: Any, parameters: Any, rho: Any) -> Any:
            P = stepper.scheme.stress(material, parameters, F_n, F)
            energy = material.psi(F.T * F, **parameters)
            before = material.psi(F_n.T * F_n, **parameters)
            return of_energy * energy + of_defect * (energy - before - ufl.inner(P, F - F_n))

        def remembered(material: Any, parameters: Any) -> Any:
            energy = memory.energy(material, parameters)
            change = energy - memory.energy_at_start(material, parameters)
            change += memory.dissipation(material, parameters)
            change -= memory.work(material, parameters, u - u_n)
            return of_energy * energy + of_defect * change

        soft = [body for body in stepper.bodies if not body.is_rigid]
        self._form = CellForm(bulk_form(soft, integrand, remembered), V=V) if soft else None
        self._values: Floats = np.empty(2 * len(W.dofmap.list))
        self._ones = np.ones(len(W.dofmap.list))

    def total(self) -> Floats:
        """Energy and defect of the cells of this rank, shape ``(2,)`` [J]. Collective at first.

        If the last step has computed the global integrals, the first rank returns them.
        """
        known = self._stepper.cell_energies
        if known is not None:
            is_first = self._stepper.u.function_space.mesh.comm.rank == 0
            return np.array(known) if is_first else np.zeros(2)
        self._values.fill(0.0)
        if self._form is not None:
            self._form.assemble(self._values)
        total: Floats = self._ones @ self._values.reshape(-1, 2)
        return total
