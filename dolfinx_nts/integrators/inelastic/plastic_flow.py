r"""Plastic flow: plastic metric and equivalent plastic strain at the quadrature points.

A radial return at the end of the step updates the state from the plastic metric :math:`G_n`, see
`radial_return`. The stress of the step is the elastic stress of the scheme with :math:`G_n`,
times the factor t of a radial return at :math:`(1 - \theta) C_n + \theta C_{n+1}`, where
:math:`\theta` is the weight of the end of the step. For the energy-momentum scheme the work of
this stress is t times the elastic energy change of a step without flow,
:math:`t\, (W_{tr} - W_n)`. The dissipation is therefore exactly

.. math:: D = t\, W_{tr} + (1 - t)\, W_n - W_{n+1}.

For small strains it is never negative: with the elastic deviators :math:`e_n`, :math:`e_{tr}`,
their mean :math:`e_m` of norm :math:`r/t`, and the radius r of the yield surface,

.. math:: D/\mu \ge 4 r\, (|e_m| - e_m \cdot e_n/|e_m|) - r^2 + |e_n|^2
   \ge (r - |e_n|)(3 r - |e_n|) \ge 0,

The tests show the same for large strains. Schemes that do not conserve energy dissipate
:math:`\sigma_y(\alpha_{n+1})\, \Delta\alpha`.
"""

from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh

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
from dolfinx_nts.materials.hardening import Hardening
from dolfinx_nts.materials.plasticity import J2Plasticity
from dolfinx_nts.materials.radial_return import RadialReturn

__all__ = ["PlasticFlow"]

# Initial metric and equivalent plastic strain; index of the plastic strain.
_INITIAL, _ALPHA = [1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0], 6
# Indices of the entries of the metric.
_PLACES = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


class PlasticFlow(MaterialMemory):
    """Plastic state of one material. Collective.

    Args:
        material: The material.
        V: Space of the displacement.
        cells: Owned cells of the material, sorted, shape ``(c,)``.
        step: Strains of a step.
    """

    def __init__(
        self, material: J2Plasticity, V: fem.FunctionSpace, cells: Ints, step: StepStrains
    ) -> None:
        self._material, self._step, self._mesh = material, step, V.mesh
        self._hardening = _constants(V.mesh, material.hardening)
        self._state = PointValues(V, cells, _INITIAL)
        self._of_cells = CellValues(V.mesh, cells, 6)
        mu = fem.Constant(V.mesh, material.parameters["mu"])
        flow = self._flow(step.C, mu)
        alpha = self._state.start[_ALPHA] + flow.increment
        parts = [*symmetric_entries(flow.metric), alpha]
        self._after = compile_expression(ufl.as_vector(parts), self._state.points)
        F = ufl.as_vector([step.F[i, j] for i in range(3) for j in range(3)])
        middle = self._state.points.mean(axis=0, keepdims=True)
        places = np.concatenate([self._state.points, middle])
        self._gradients = compile_expression(F, places)
        self._describe()

    def begin(self) -> None:
        self._state.begin()

    def accept(self) -> None:
        state = self._state
        after = self._after.eval(self._mesh, state.cells)
        state.set(state.end, after.reshape(state.of(state.end).shape))
        self._describe()

    def serialize(self, archive: Archive, name: str) -> None:
        self._state.serialize(archive, name)
        self._describe()

    def plastic_strain(self) -> tuple[Ints, Floats]:
        state = self._state
        return state.cells, state.of(state.end)[..., _ALPHA].mean(axis=1)

    def work(self, parameters: Any, eta: Any) -> Any:
        return self._factor(parameters) * self._elastic(parameters, eta, self._state.start)

    def elastic_work(self, parameters: Any, eta: Any) -> Any:
        return self._elastic(parameters, eta, self._state.end)

    def stiffness(self, parameters: Any, rate: Any) -> Any:
        # Moduli of the undeformed material in the current configuration: plastic flow leaves the
        # elastic strains small.
        F_inv = ufl.inv(self._step.F_n)
        tau = 2 * parameters["mu"] * ufl.dev(F_inv.T * rate * F_inv)
        return self._step.theta * F_inv * tau * F_inv.T

    def dissipation(self, parameters: Any) -> Any:
        step, start, end = self._step, self._state.start, self._state.end
        if step.theta != 0.5:
            alpha = end[_ALPHA]
            return self._hardening.stress(alpha) * (alpha - start[_ALPHA])
        # Formulated so that it is exactly 0 at points without flow.
        C_n, C = (ufl.det(each) ** (-1 / 3) * each for each in (step.C_n, step.C))
        before, after = symmetric_tensor(start), symmetric_tensor(end)
        lost = ufl.inner(C, before - after)
        lost -= (1 - self._factor(parameters)) * ufl.inner(C - C_n, before)
        return parameters["mu"] / 2 * lost

    def energy(self, parameters: Any) -> Any:
        return self._energy(parameters, self._step.C, self._state.end)

    def energy_at_start(self, parameters: Any) -> Any:
        return self._energy(parameters, self._step.C_n, self._state.start)

    def stress(self, parameters: Any, C: Any) -> tuple[Any, Any]:
        some = self._with_metric(parameters, self._of_cells.function)
        return self._material.stress(C, **some), self._material.psi(C, **some)

    def _describe(self) -> None:
        """Compute a plastic metric per cell, for the mean elastic strain at its midpoint."""
        state, cells = self._state, self._state.cells
        F = self._gradients.eval(self._mesh, cells).reshape(len(cells), len(state.points) + 1, 3, 3)
        F /= np.cbrt(np.linalg.det(F))[..., None, None]
        values = state.of(state.end)
        metrics = values[..., _PLACES]
        turned = np.linalg.solve(F[:, -1:], F[:, :-1])
        mean = np.einsum("cpij,cpjk,cplk->cil", turned, metrics, turned) / values.shape[1]
        rows, columns = np.triu_indices(3)
        self._of_cells.set(mean[:, rows, columns])

    def _flow(self, C: Any, mu: Any) -> RadialReturn:
        """Radial return from the state at the start of the step."""
        start = self._state.start
        return RadialReturn(C, symmetric_tensor(start), start[_ALPHA], mu, self._hardening)

    def _factor(self, parameters: Any) -> Any:
        """Ratio of the stress of the step to the trial stress."""
        step = self._step
        return self._flow(step.mean(step.C_n, step.C), parameters["mu"]).factor

    def _elastic(self, parameters: Any, eta: Any, state: fem.Function) -> Any:
        """Virtual work of the elastic stress with the metric of a state."""
        step, some = self._step, self._with_metric(parameters, state)
        P = step.scheme.stress(self._material, some, step.F_n, step.F)
        return ufl.inner(P, gradient(eta))

    def _energy(self, parameters: Any, C: Any, state: fem.Function) -> Any:
        return self._material.psi(C, **self._with_metric(parameters, state))

    def _with_metric(self, parameters: Any, state: fem.Function | None = None) -> dict[str, Any]:
        """Parameters of the deviatoric energy, by default with the metric at t_n."""
        metric = symmetric_tensor(self._state.start if state is None else state)
        return {**parameters, "kappa": 0.0, "metric": metric}


def _constants(mesh: Mesh, hardening: Hardening) -> Hardening:
    """Hardening parameters as UFL constants; without saturation its terms are left out."""
    stress, modulus, increase, rate = (fem.Constant(mesh, number) for number in hardening)
    if hardening.saturates:
        return Hardening(stress, modulus, increase, rate)
    return hardening._replace(yield_stress=stress, modulus=modulus)
