r"""Energies, momenta and contact forces of a stepper's accepted state.

Integrals use the quadrature of the scheme, so conserved quantities are constant to round-off. Nodal
momenta :math:`p_a = \int \rho_0 v \varphi_a` (in `CentralDifference` :math:`p_a = v_a \int \rho_0
\varphi_a`) give the kinetic energy :math:`\sum v_a \cdot p_a / 2`, the linear momentum :math:`\sum
p_a` and the angular momentum :math:`\sum x_a \times p_a`. With du = u_{n+1} - u_n, the total energy
changes in a step by

.. math:: [V_{n+1} - V_n - f_{int} \cdot du] - \sum \lambda_N F \cdot du
   + R \cdot du:

the defect of the stress (bulk), the work of the contact forces, and the work of the remaining
residual. `StepReport` has the last two.
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
from dolfinx_nts.fem.components import (
    deformation_gradient,
    in_space,
    motion_sums,
    nodal,
    resultants,
)
from dolfinx_nts.fem.linear_forms import CellForm
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.parallel.collective_calls import collective, meet

__all__ = ["Balance", "CellEnergies", "Diagnostics"]


class CellEnergies:
    """Strain energy, and defect of the stress in a step, of the cells.

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
        """Energy and defect of the cells of this rank, ``(2,)`` [J]. Collective at the first use.

        If the last step has computed the global integrals, rank 0 returns them, all other ranks 0.
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
        contact_force: Resultant of the last step on the nodes of all pairs, shape ``(3,)``, in the
            plane ``(2,)`` [N]. In an axisymmetric mesh momentum and resultant have one component,
            along y, and there is no angular momentum, shape ``(0,)``.
        active_nodes: Number of nodes that transmit force.
        min_gap: Smallest gap [m]; NaN if no node has a candidate segment.

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
        """All quantities by name, with ``_x``, ``_y``, ``_z`` for components of vectors. Local."""
        return flat("", {name: getattr(self, name) for name in _COLUMNS})


# Insert the total energy after its terms.
_COLUMNS = [field.name for field in fields(Balance)]
_COLUMNS.insert(_COLUMNS.index("contact_energy") + 1, "total_energy")


@collective
class Diagnostics(ContactDiagnostics):
    """Evaluates energies, momenta and contact of a stepper's accepted state, without changing it.

    Collective, as are all its methods.

    Args:
        stepper: The stepper.

    Attributes:
        stepper: The argument.

    Raises:
        TypeError: ``stepper`` is not a Stepper.
        ValueError: Not all ranks make the same call.

    Example:
        >>> diagnostics = nts.Diagnostics(stepper)
        >>> f"{diagnostics.kinetic_energy():.6g} J, {diagnostics.min_gap():.2g} m"
        '250 J, 0.01 m'
    """

    def __init__(self, stepper: Stepper) -> None:
        if not isinstance(stepper, Stepper):
            raise TypeError(f"expected a stepper, given {type(stepper).__name__}")
        meet(stepper.u.function_space.mesh.comm, "make Diagnostics")
        super().__init__(stepper)
        self._energies = CellEnergies(stepper)
        self._bodies = BodyDiagnostics(stepper)

    def __repr__(self) -> str:
        return as_call(self, stepper=type(self.stepper))

    def kinetic_energy(self) -> float:
        """Kinetic energy [J]."""
        return float(self._sum(self._motion())[0])

    def strain_energy(self) -> float:
        """Strain energy [J]."""
        return float(self._sum(self._energies.total())[0])

    def linear_momentum(self) -> Floats:
        """Linear momentum, shape ``(3,)``, in the plane ``(2,)`` [kg m/s]."""
        return self._momenta(self._sum(self._motion()))[0]

    def angular_momentum(self) -> Floats:
        """Angular momentum about the origin, ``(3,)``, in the plane ``(1,)`` [kg m^2/s]."""
        return self._momenta(self._sum(self._motion()))[1]

    def bulk_defect(self) -> float:
        """Energy that bulk and inertia added to the total energy in the last step [J].

        It is the integral of psi(C) - psi(C_n) - P : (F - F_n), with the stress P of the scheme,
        plus ``inertia_defect`` of the stepper. In viscous branches it includes the energy of the
        springs and the dissipation.
        """
        return float(self._sum(self._energies.total())[1] + self.stepper.inertia_defect)

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

        Arguments and errors as for `centre_of_mass`.
        """
        return resultants(self._bodies.mean(body, in_space(nodal(self.stepper.v))), self._V)

    def bodies(self) -> dict[str, BodyBalance]:
        """Mass, energies, momenta and motion of each body, by its name."""
        return self._bodies.balances()

    def balance(self) -> Balance:
        """All quantities of the current state."""
        return self.after_step()[1]

    def after_step(self) -> tuple[float, Balance]:
        """Evaluate `bulk_defect` [J] and `balance` in one pass over the cells.

        Returns:
            Results of both methods.
        """
        parts = self._motion(), self._energies.total(), self._of_own_nodes()
        sums = self._sum(np.concatenate(parts))
        of_contact = self._now().contact_sums = self._sums_by_pair(sums[9:])
        of_all = of_contact[0].sum(axis=0)
        kinetic, strain, defect = sums[[0, 7, 8]].tolist()
        linear, angular = self._momenta(sums)
        stored, active = of_all[:2].tolist()
        energies = kinetic, strain, stored
        contact = of_all[3:6][self._axes[0]], int(active), self.min_gap()
        balance = Balance(self.stepper.t, *energies, linear, angular, *contact)
        return defect + self.stepper.inertia_defect, balance

    def _motion(self) -> Floats:
        """Kinetic energy, linear and angular momentum of this rank, shape ``(7,)``."""
        p = self.stepper.nodal_momentum()
        return motion_sums(self._now().x, p, nodal(self.stepper.v)[: len(p)])

    def _momenta(self, motion: Floats) -> tuple[Floats, Floats]:
        """Linear and angular momentum with the components that exist in the space. Local."""
        return self._parts(np.reshape(motion[1:7], (2, 3)))
