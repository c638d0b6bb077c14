r"""Energies, momenta and contact forces of a stepper's accepted state.

Integrals have the quadrature of the scheme, so that what it conserves is constant to round-off.
Nodal momenta :math:`p_a = \int \rho_0 v \varphi_a` (in `CentralDifference`
:math:`p_a = v_a \int \rho_0 \varphi_a`) give the kinetic energy :math:`\sum v_a \cdot p_a / 2`,
the linear momentum :math:`\sum p_a` and the angular momentum :math:`\sum x_a \times p_a`. With
du = u_{n+1} - u_n, the total energy changes in a step by

.. math:: [V_{n+1} - V_n - f_{int} \cdot du] - \sum \lambda_N F \cdot du
   + R \cdot du:

the defect of the stress (bulk), the work of the contact forces, and that of the residual which
Newton's method leaves. `StepReport` has the last two.
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.arguments import as_call
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.diagnostics.bodies import BodyBalance, BodyDiagnostics
from dolfinx_nts.diagnostics.contact import ContactDiagnostics
from dolfinx_nts.diagnostics.names import flat
from dolfinx_nts.fem.components import deformation_gradient, in_space, moments, nodal, resultants
from dolfinx_nts.fem.jit import compile_form
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.bodies import Body, bulk_form

__all__ = ["Balance", "Diagnostics"]


@dataclass(frozen=True)
class Balance:
    """Energies, momenta and contact forces of one state, the same on all ranks.

    Attributes:
        time: Time [s].
        kinetic_energy: Kinetic energy [J].
        strain_energy: Strain energy, also of springs in viscous branches [J].
        contact_energy: Energy of penalty and friction springs [J].
        linear_momentum: Linear momentum, shape ``(3,)``, in the plane ``(2,)`` [kg m/s].
        angular_momentum: Angular momentum about the origin, shape ``(3,)``, in the plane
            ``(1,)``, about z [kg m^2/s].
        contact_force: Resultant of the last step on the nodes of all pairs, shape ``(3,)``, in
            the plane ``(2,)`` [N]. Of rings, in an axisymmetric mesh, momentum and resultant
            have one component, along y, and there is no angular momentum, shape ``(0,)``.
        active_nodes: Number of nodes that transmit force.
        min_gap: Least gap [m]; NaN if no node faces a segment.

    Example:
        >>> balance = nts.Diagnostics(stepper).balance()
        >>> f"{balance.total_energy:.6g} J"
        '250 J'
        >>> list(balance.columns())[:3]
        ['time', 'kinetic_energy', 'strain_energy']
    """

    time: float
    kinetic_energy: float
    strain_energy: float
    contact_energy: float
    linear_momentum: Floats
    angular_momentum: Floats
    contact_force: Floats
    active_nodes: int
    min_gap: float

    @property
    def total_energy(self) -> float:
        """Sum of kinetic, strain and contact energy [J]."""
        return self.kinetic_energy + self.strain_energy + self.contact_energy

    def columns(self) -> dict[str, float]:
        """All numbers by name, with ``_x``, ``_y``, ``_z`` for the parts of a vector. Local."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        names = list(values)
        names.insert(names.index("contact_energy") + 1, "total_energy")
        values["total_energy"] = self.total_energy
        return flat("", {name: values[name] for name in names})


class Diagnostics(ContactDiagnostics):
    """Evaluates energies, momenta and contact of a stepper's accepted state, without changing it.

    Collective, as are all its methods.

    Args:
        stepper: The stepper.

    Attributes:
        stepper: The argument.

    Raises:
        TypeError: ``stepper`` is no stepper.

    Example:
        >>> diagnostics = nts.Diagnostics(stepper)
        >>> f"{diagnostics.kinetic_energy():.6g} J, {diagnostics.min_gap():.2g} m"
        '250 J, 0.01 m'
    """

    def __init__(self, stepper: Stepper) -> None:
        """Check the stepper, and compile the forms of the energies."""
        if not isinstance(stepper, Stepper):
            raise TypeError(f"expected a stepper, given {type(stepper).__name__}")
        super().__init__(stepper)
        u, u_n = stepper.u, stepper.u_n
        F_n, F = deformation_gradient(u_n), deformation_gradient(u)

        def strain_energy(material: Any, parameters: Any, rho: Any) -> Any:
            return material.psi(F.T * F, **parameters)

        def bulk_defect(material: Any, parameters: Any, rho: Any) -> Any:
            P = stepper.scheme.stress(material, parameters, F_n, F)
            change = material.psi(F.T * F, **parameters) - material.psi(F_n.T * F_n, **parameters)
            return change - ufl.inner(P, F - F_n)

        memory = stepper.memory

        def defect_of_branches(material: Any, parameters: Any) -> Any:
            change = memory.energy(material, parameters)
            change -= memory.energy_at_start(material, parameters)
            change += memory.dissipation(material, parameters)
            return change - memory.work(material, parameters, u - u_n)

        self._strain_energy, self._bulk_defect = (
            compile_form(bulk_form(stepper.bodies, *integrands))
            for integrands in ((strain_energy, memory.energy), (bulk_defect, defect_of_branches))
        )
        self._bodies = BodyDiagnostics(stepper)

    def __repr__(self) -> str:
        """Return the call that makes such diagnostics, with the class of the stepper. Local."""
        return as_call(self, stepper=type(self.stepper))

    def kinetic_energy(self) -> float:
        """Kinetic energy [J]."""
        return self._motion()[0]

    def strain_energy(self) -> float:
        """Strain energy [J]."""
        return float(self._sum(fem.assemble_scalar(self._strain_energy)))

    def linear_momentum(self) -> Floats:
        """Linear momentum, shape ``(3,)``, in the plane ``(2,)`` [kg m/s]."""
        return self._motion()[1]

    def angular_momentum(self) -> Floats:
        """Angular momentum about the origin, ``(3,)``, in the plane ``(1,)`` [kg m^2/s]."""
        return self._motion()[2]

    def bulk_defect(self) -> float:
        """Energy that bulk and inertia added to the total energy in the last step [J].

        It is the integral of psi(C) - psi(C_n) - P : (F - F_n), with the stress P of the
        scheme, plus ``inertia_defect`` of the stepper. Of viscous branches it has the energy of
        the springs and the dissipation.
        """
        defect = self._sum(fem.assemble_scalar(self._bulk_defect))
        return float(defect + self.stepper.inertia_defect)

    def centre_of_mass(self, body: Body) -> Floats:
        """Current centre of mass of a body, shape ``(3,)``, in the plane ``(2,)`` [m].

        Args:
            body: One of the stepper's bodies.

        Raises:
            ValueError: The body belongs to another stepper.
        """
        return resultants(self._bodies.mean(body, self.stepper.x), self._V)

    def body_velocity(self, body: Body) -> Floats:
        """Velocity of the centre of mass of a body, shape ``(3,)``, in the plane ``(2,)`` [m/s].

        Argument and error are those of `centre_of_mass`.
        """
        return resultants(self._bodies.mean(body, in_space(nodal(self.stepper.v))), self._V)

    def bodies(self) -> dict[str, BodyBalance]:
        """Mass, energies, momenta and motion of each body, by its name."""
        return self._bodies.balances()

    def balance(self) -> Balance:
        """All numbers of the whole state at once."""
        kinetic_energy, linear, angular = self._motion()
        energies = kinetic_energy, self.strain_energy(), self.contact_energy()
        contact = self.contact_force(), self.active_nodes(), self.min_gap()
        return Balance(self.stepper.t, *energies, linear, angular, *contact)

    def _motion(self) -> tuple[float, Floats, Floats]:
        """Kinetic energy, linear and angular momentum."""
        p = self.stepper.nodal_momentum()
        n = len(p)
        v = nodal(self.stepper.v)[:n]
        turning = np.cross(self.stepper.x[:n], in_space(p)).sum(axis=0)
        parts = [[np.sum(v * p) / 2], in_space(p.sum(axis=0)), turning]
        sums = self._sum(np.concatenate(parts))
        return float(sums[0]), resultants(sums[1:4], self._V), moments(sums[4:], self._V)
