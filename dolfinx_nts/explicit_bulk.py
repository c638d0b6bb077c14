"""Forces of the bodies at one time, with lumped mass: for explicit steps."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la

from dolfinx_nts.bodies import Body, bulk_form
from dolfinx_nts.forms import compile_form
from dolfinx_nts.loads import Load
from dolfinx_nts.lumping import lumped_mass
from dolfinx_nts.materials import Hyperelastic, right_cauchy_green
from dolfinx_nts.spring_state import SpringState

__all__ = ["ExplicitBulk", "Forces", "NodalForce"]

Floats = npt.NDArray[np.float64]


class NodalForce:
    """A linear form, assembled on the owned dofs.

    Args:
        form: Virtual work, linear in the test function.

    Attributes:
        num_assemblies: How often it was assembled.
    """

    def __init__(self, form: ufl.Form) -> None:
        """Compile the form and allocate."""
        self._form = compile_form(form)
        index_map = form.arguments()[0].ufl_function_space().dofmap.index_map
        self._vector = la.vector(index_map, 3)
        self._num_owned = index_map.size_local
        self.num_assemblies = 0

    def add_to(self, total: Floats, sign: float) -> None:
        """Add the force to that of the owned nodes. Collective.

        Args:
            total: Shape ``(n, 3)`` [N].
            sign: Factor.
        """
        values = self._vector.array
        values[:] = 0
        fem.assemble_vector(values, self._form)
        self._vector.scatter_reverse(la.InsertMode.add)
        total += sign * values.reshape(-1, 3)[: self._num_owned]
        self.num_assemblies += 1


@dataclass
class Forces:
    """Forces on the owned nodes at one time, each ``(n, 3)`` [N].

    Attributes:
        load: Of the loads.
        damping: Of damping.
        total: Of everything but the reactions of supports.
        acceleration: What follows, 0 where it is given [m/s^2].
        springs: Of contact, pair by pair.
    """

    load: Floats
    damping: Floats
    total: Floats
    acceleration: Floats
    springs: tuple[SpringState, ...] = ()

    @classmethod
    def none(cls, n: int) -> "Forces":
        """No forces on n nodes."""
        return cls(*np.zeros((4, n, 3)))


class ExplicitBulk:
    """Lumped mass and forces of bodies; contact is added by the stepper.

    Args:
        bodies: The bodies.
        u: Displacement at which forces are evaluated.
        loads: Loads on the bodies.

    Attributes:
        mass: Lumped mass of the owned nodes, shape ``(n,)`` [kg].
        rate: Velocity on which damping acts.
        internal: Internal forces.
        loads: Forces of the loads.
        damping: Forces of damping, empty without.
    """

    def __init__(self, bodies: Sequence[Body], u: fem.Function, loads: Sequence[Load]) -> None:
        """Compile the forms."""
        V = u.function_space
        self._u, self._eta = u, ufl.TestFunction(V)
        self.rate = fem.Function(V)
        self.mass: Floats = lumped_mass(bodies)
        self.internal = NodalForce(bulk_form(bodies, self._internal_work))
        self.loads = [NodalForce(load.form(u, u)) for load in loads]
        damped = [body for body in bodies if body.material.is_damped]
        self.damping = [NodalForce(bulk_form(damped, self._damping_work))] if damped else []
        self._strain_energy = compile_form(bulk_form(bodies, self._strain_energy_density))

    def evaluate(self, forces: Forces) -> None:
        """Set all forces but those of contact. Collective."""
        forces.load[:] = forces.damping[:] = 0
        for part in self.loads:
            part.add_to(forces.load, 1.0)
        for part in self.damping:
            part.add_to(forces.damping, -1.0)
        np.add(forces.load, forces.damping, out=forces.total)
        self.internal.add_to(forces.total, -1.0)

    def strain_energy(self) -> float:
        """Strain energy on this rank [J]."""
        return float(fem.assemble_scalar(self._strain_energy))

    def _internal_work(self, material: Hyperelastic, parameters: Any, rho: Any) -> Any:
        F = ufl.Identity(3) + ufl.grad(self._u)
        P = F * material.stress(right_cauchy_green(F), **parameters)
        return ufl.inner(P, ufl.grad(self._eta))

    def _damping_work(self, material: Hyperelastic, parameters: Any, rho: Any) -> Any:
        mesh = self._u.function_space.mesh
        alpha = fem.Constant(mesh, material.mass_damping)
        beta = fem.Constant(mesh, material.stiffness_damping)
        F = ufl.Identity(3) + ufl.grad(self._u)
        strain_rate = ufl.sym(F.T * ufl.grad(self.rate))
        P = beta * F * material.linear_stress(strain_rate, **parameters)
        drag = alpha * rho * ufl.inner(self.rate, self._eta)
        return drag + ufl.inner(P, ufl.grad(self._eta))

    def _strain_energy_density(self, material: Hyperelastic, parameters: Any, rho: Any) -> Any:
        F = ufl.Identity(3) + ufl.grad(self._u)
        return material.psi(right_cauchy_green(F), **parameters)
