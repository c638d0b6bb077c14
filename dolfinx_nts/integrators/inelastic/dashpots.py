r"""Maxwell branches: strains of the dashpots at the quadrature points.

Let :math:`\theta` be the weight of the end of the step in the stress of the scheme (1/2 for the
energy-momentum scheme). With :math:`E_\theta = (1 - \theta) E_n + \theta E_{n+1}`, the rate law of
a branch in a step is :math:`\tau (\Gamma_{n+1} - \Gamma_n)/\Delta t = E_\theta - \Gamma_\theta`,
so that

.. math:: \Gamma_{n+1} - \Gamma_n = \frac{\Delta t}{\tau + \theta \Delta t}
   (E_\theta - \Gamma_n), \qquad
   S = s D : (E_\theta - \Gamma_\theta)
   = \frac{s \tau}{\tau + \theta \Delta t} D : (E_\theta - \Gamma_n).

The strains of the dashpots are thus eliminated locally. For :math:`\theta = 1/2` the work of S is
exactly the change of the energy of the spring plus the dissipation
:math:`s \tau/\Delta t\, \Delta\Gamma : D : \Delta\Gamma \ge 0`.
"""

from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.components import gradient
from dolfinx_nts.fem.jit import compile_expression
from dolfinx_nts.integrators.inelastic.material_memory import MaterialMemory
from dolfinx_nts.integrators.inelastic.point_values import CellValues, PointValues
from dolfinx_nts.integrators.inelastic.step_strains import (
    StepStrains,
    symmetric_entries,
    symmetric_tensor,
)
from dolfinx_nts.materials.branches import Branch
from dolfinx_nts.materials.hyperelastic import Hyperelastic

__all__ = ["Dashpots"]


class Dashpots(MaterialMemory):
    """Strains of the dashpots of one material. Collective.

    Args:
        material: Material with branches.
        V: Space of the displacement.
        cells: Owned cells of the material, sorted, shape ``(c,)``.
        step: Strains at both ends of a step.
    """

    def __init__(
        self, material: Hyperelastic, V: fem.FunctionSpace, cells: Ints, step: StepStrains
    ) -> None:
        self._material, self._step, self._mesh = material, step, V.mesh
        self._F = step.mean(step.F_n, step.F)
        self._E_n, self._E = (_strain(C) for C in (step.C_n, step.C))
        self._mean = step.mean(self._E_n, self._E)
        self._strains = PointValues(V, cells, [0.0] * 6 * len(material.branches))
        self._of_cells = CellValues(V.mesh, cells, 6 * len(material.branches))
        parts = ufl.as_vector(symmetric_entries(self._mean))
        self._followed = compile_expression(parts, self._strains.points)

    def begin(self) -> None:
        self._strains.begin()

    def accept(self) -> None:
        strains, dt = self._strains, float(self._step.dt.value)
        times = np.array([branch.relaxation_time for branch in self._material.branches])
        parts = dt / (times + self._step.theta * dt)
        before = strains.of(strains.start)
        by_branch = before.reshape(*before.shape[:2], len(times), 6)
        mean = self._followed.eval(self._mesh, strains.cells)
        mean = mean.reshape(*before.shape[:2], 1, 6)
        after = by_branch + parts[:, None] * (mean - by_branch)
        strains.set(strains.end, after.reshape(before.shape))
        self._describe()

    def serialize(self, archive: Archive, name: str) -> None:
        self._strains.serialize(archive, name)
        self._describe()

    def plastic_strain(self) -> tuple[Ints, Floats]:
        return self._strains.cells, np.zeros(len(self._strains.cells))

    def work(self, parameters: Any, eta: Any) -> Any:
        strain = ufl.zero(3, 3)
        for number, branch in enumerate(self._material.branches):
            share, time = self._branch_constants(branch)
            gamma_n = symmetric_tensor(self._strains.start, 6 * number)
            lag = self._mean - gamma_n
            strain += share * time / (time + self._step.theta * self._step.dt) * lag
        P = self._F * self._material.shape_stress(strain, **parameters)
        return ufl.inner(P, gradient(eta))

    def elastic_work(self, parameters: Any, eta: Any) -> Any:
        shares = (self._branch_constants(branch)[0] for branch in self._material.branches)
        strains = self._springs(self._mean, self._strains.end)
        strain = sum(share * strain for share, strain in zip(shares, strains, strict=True))
        P = self._F * self._material.shape_stress(strain, **parameters)
        return ufl.inner(P, gradient(eta))

    def stiffness(self, parameters: Any, rate: Any) -> Any:
        numbers, theta = (
            [self._branch_constants(b) for b in self._material.branches],
            self._step.theta,
        )
        factor = sum(s * t / (t + theta * self._step.dt) for s, t in numbers)
        return theta * factor * self._material.shape_stress(rate, **parameters)

    def dissipation(self, parameters: Any) -> Any:
        total, dt = ufl.as_ufl(0), self._step.dt
        for number, branch in enumerate(self._material.branches):
            share, time = self._branch_constants(branch)
            gamma_n = symmetric_tensor(self._strains.start, 6 * number)
            change = dt / (time + self._step.theta * dt) * (self._mean - gamma_n)
            stress = self._material.shape_stress(change, **parameters)
            total += share * time / dt * ufl.inner(stress, change)
        return total

    def energy(self, parameters: Any) -> Any:
        return self._stored(parameters, self._springs(self._E, self._strains.end))

    def energy_at_start(self, parameters: Any) -> Any:
        return self._stored(parameters, self._springs(self._E_n, self._strains.start))

    def stress(self, parameters: Any, C: Any) -> tuple[Any, Any]:
        strains = self._springs(_strain(C), self._of_cells.function)
        shares = (self._branch_constants(branch)[0] for branch in self._material.branches)
        total = sum(share * strain for share, strain in zip(shares, strains, strict=True))
        energy = self._stored(parameters, strains)
        return self._material.shape_stress(total, **parameters), energy

    def _describe(self) -> None:
        self._of_cells.set(self._strains.of(self._strains.end).mean(axis=1))

    def _springs(self, E: Any, gammas: fem.Function) -> list[Any]:
        """Strains of the springs from the total strain and the strains of the dashpots."""
        numbers = range(len(self._material.branches))
        return [E - symmetric_tensor(gammas, 6 * number) for number in numbers]

    def _stored(self, parameters: Any, strains: list[Any]) -> Any:
        """Energy of the springs from their strains."""
        shares = (self._branch_constants(branch)[0] for branch in self._material.branches)
        return sum(
            share / 2 * ufl.inner(self._material.shape_stress(strain, **parameters), strain)
            for share, strain in zip(shares, strains, strict=True)
        )

    def _branch_constants(self, branch: Branch) -> tuple[fem.Constant, fem.Constant]:
        """Share s and relaxation time of a branch as UFL constants."""
        share, time = (fem.Constant(self._mesh, number) for number in branch)
        return share, time


def _strain(C: Any) -> Any:
    """Green-Lagrange strain, UFL (3, 3)."""
    return (C - ufl.Identity(3)) / 2
