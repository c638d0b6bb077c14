"""Internal variables of all materials at the quadrature points."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.integrators.inelastic.dashpots import Dashpots
from dolfinx_nts.integrators.inelastic.material_memory import MaterialMemory
from dolfinx_nts.integrators.inelastic.plastic_flow import PlasticFlow
from dolfinx_nts.integrators.inelastic.step_strains import StepStrains
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.materials.hyperelastic import Hyperelastic
from dolfinx_nts.materials.plasticity import J2Plasticity
from dolfinx_nts.model.bodies import Body

__all__ = ["Memory"]


class Memory:
    """Internal variables of the materials of all bodies. Collective.

    Args:
        bodies: The bodies.
        u_n: Displacement at the start of a step [m].
        u: Displacement at its end [m].
        dt: Length of the step, a constant [s].
        scheme: Scheme, which defines the stress of a step.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        u_n: fem.Function,
        u: fem.Function,
        dt: fem.Constant,
        scheme: Scheme,
    ) -> None:
        mesh = u.function_space.mesh
        self._num_cells = mesh.topology.index_map(mesh.topology.dim).size_local
        step, self._of = StepStrains(u_n, u, dt, scheme), dict[Hyperelastic, MaterialMemory]()
        for material in dict.fromkeys(body.material for body in bodies):
            if not material.remembers:
                continue
            cells = np.concatenate([body.cells for body in bodies if body.material is material])
            arguments = u.function_space, np.sort(cells), step
            self._of[material] = (
                PlasticFlow(material, *arguments)
                if isinstance(material, J2Plasticity)
                else Dashpots(material, *arguments)
            )

    @property
    def exists(self) -> bool:
        """Whether any material has internal variables. Local."""
        return bool(self._of)

    @property
    def flows(self) -> bool:
        """Whether any material is plastic. Local."""
        return any(isinstance(each, PlasticFlow) for each in self._of.values())

    def plastic_strain(self) -> Floats:
        """Mean equivalent plastic strain of the owned cells, shape ``(c,)`` [-]. Local."""
        strain = np.zeros(self._num_cells)
        for each in self._of.values():
            cells, values = each.plastic_strain()
            strain[cells] = values
        return strain

    def begin(self) -> None:
        """Begin a step with the state that was accepted last. Local."""
        for each in self._of.values():
            each.begin()

    def accept(self) -> None:
        """Set the state at the end of the step that was solved. Local."""
        for each in self._of.values():
            each.accept()

    def serialize(self, archive: Archive) -> None:
        """Serialize the state at both ends of the last step."""
        for number, each in enumerate(self._of.values(), start=1):
            each.serialize(archive, f"memory_{number}")

    def work(self, material: Hyperelastic, parameters: Any, eta: Any) -> Any:
        """Virtual work of a material per reference volume, UFL [J/m^3]."""
        return self._of[material].work(parameters, eta)

    def elastic_work(self, material: Hyperelastic, parameters: Any, eta: Any) -> Any:
        """Virtual work with the state frozen at the end of the accepted step, UFL [J/m^3]."""
        return self._of[material].elastic_work(parameters, eta)

    def stiffness(self, material: Hyperelastic, parameters: Any, rate: Any) -> Any:
        """Stress increment of a material for a strain increment ``rate``, UFL (3, 3) [Pa]."""
        return self._of[material].stiffness(parameters, rate)

    def dissipation(self, material: Hyperelastic, parameters: Any) -> Any:
        """Energy dissipated in the accepted step per reference volume, UFL [J/m^3]."""
        return self._of[material].dissipation(parameters)

    def energy(self, material: Hyperelastic, parameters: Any) -> Any:
        """Energy at the end of the accepted step per reference volume, UFL [J/m^3]."""
        return self._of[material].energy(parameters)

    def energy_at_start(self, material: Hyperelastic, parameters: Any) -> Any:
        """Energy at the start of the accepted step per reference volume, UFL [J/m^3]."""
        return self._of[material].energy_at_start(parameters)

    def stress(self, material: Hyperelastic, parameters: Any, C: Any) -> tuple[Any, Any]:
        """Second Piola-Kirchhoff stress [Pa] and energy [J/m^3], see `MaterialMemory.stress`."""
        return self._of[material].stress(parameters, C)
