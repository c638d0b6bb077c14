"""Inertia of bodies in implicit steps."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import ufl
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.fem.jit import compile_form
from dolfinx_nts.integrators.implicit.implicit_forms import StepForms
from dolfinx_nts.integrators.inelastic.memory import Memory
from dolfinx_nts.integrators.rates import ConsistentMass, Rates
from dolfinx_nts.integrators.scheme import Scheme
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.reaction import Reaction
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.precond.tangent import Tangent, TangentOfAllCells

__all__ = ["ConsistentInertia", "Inertia", "VelocityUpdate"]


class VelocityUpdate(NamedTuple):
    """Result of the velocity update at the end of a step.

    Attributes:
        defect: Return value of `Rates.accept` on this rank [J].
        work: Energy given to the bodies by the update [J], the same on all ranks.
        reactions: Additional reaction of each support due to the update, the same on all ranks;
            empty if there is none.
    """

    defect: float
    work: ContactWork = ContactWork()
    reactions: tuple[Reaction, ...] = ()


class Inertia(ABC):
    """Base class of the inertia of bodies. Collective, as are all methods.

    Attributes:
        bulk: Residual of the bodies.
        tangent: Its tangent matrix.
    """

    bulk: Bulk
    tangent: Tangent

    @abstractmethod
    def momentum(self) -> Floats:
        """Momentum of the owned nodes, shape ``(n, d)`` [kg m/s]."""

    @abstractmethod
    def carried(self, forces: Floats) -> Floats:
        """Forces at the owned nodes, ``(n, d)`` [N], transferred to the nodes with mass."""

    @abstractmethod
    def accept(self, steps: Sequence[ContactStep]) -> VelocityUpdate:
        """Set the velocity at the end of a step.

        Args:
            steps: Accepted contact of the pairs.
        """

    def dissipated(self) -> float:
        """Dissipation by damping and inelastic materials in the step on this rank [J]. Local."""
        return 0.0


class ConsistentInertia(Inertia):
    """Consistent mass, as part of the forms of the bodies.

    Args:
        bodies: The bodies.
        rates: Relation between velocities and displacements.
        scheme: The scheme.
        bcs: Dirichlet conditions.
        loads: Virtual work of the loads.
        memory: Internal variables of materials.
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        rates: Rates,
        scheme: Scheme,
        bcs: Sequence[fem.DirichletBC],
        loads: Sequence[ufl.Form],
        memory: Memory,
    ) -> None:
        self._rates, self._mass = rates, ConsistentMass(bodies, rates.v)
        forms = StepForms(bodies, rates, scheme, memory)
        works = forms.residual(), rates.u, bcs, loads
        # In statics rigid bodies contribute nothing to the forms.
        is_partial = rates.acceleration is None and any(body.is_rigid for body in bodies)
        make = TangentOfAllCells if is_partial else Tangent
        self.bulk = Bulk(*works, jumps=memory.flows)
        self.tangent = make(*works, forms.nearby_tangent(), [body.nodes for body in bodies])
        damping = forms.dissipation()
        self._dissipation = None if damping is None else compile_form(damping)

    def momentum(self) -> Floats:
        return self._mass.momentum()

    def carried(self, forces: Floats) -> Floats:
        return forces

    def accept(self, steps: Sequence[ContactStep]) -> VelocityUpdate:
        return VelocityUpdate(self._rates.accept())

    def dissipated(self) -> float:
        some = self._dissipation
        return 0.0 if some is None else float(fem.assemble_scalar(some))
