"""Forces of the bodies at one time, with lumped mass, for explicit steps."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, la

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import deformation_gradient, dimension, gradient
from dolfinx_nts.fem.jit import compile_form
from dolfinx_nts.fem.linear_forms import CellForm, PackedForm
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.model.loads import Load
from dolfinx_nts.model.lumped_mass import lumped_mass

__all__ = ["ExplicitBulk", "NodalForce"]


class NodalForce:
    """Assembles a linear form to forces on the owned nodes.

    Args:
        form: Virtual work; None: there is none.
        V: Space of its test function.

    Attributes:
        values: Forces on the owned nodes, shape ``(n, 3)`` [N].
        num_assemblies: Number of assemblies so far.
    """

    def __init__(self, form: CellForm | PackedForm | None, V: fem.FunctionSpace) -> None:
        """Make room for the values."""
        self._form = form
        index_map, dim = V.dofmap.index_map, dimension(V)
        self._vector = la.vector(index_map, dim)
        self._local: Floats = self._vector.array
        self.values: Floats = self._local.reshape(-1, dim)[: index_map.size_local]
        self.num_assemblies = 0

    def assemble(self) -> None:
        """Set the values to those of the present state. Collective."""
        self._local.fill(0.0)
        self.num_assemblies += 1
        if self._form is None:
            return
        self._form.assemble(self._local)
        self._vector.scatter_reverse(la.InsertMode.add)


class ExplicitBulk:
    """Evaluates all forces on bodies except those of contact, which the stepper adds.

    Args:
        bodies: The bodies.
        u: Displacement at which the forces are evaluated.
        loads: Loads on the bodies.

    Attributes:
        mass: Lumped mass of the owned nodes, shape ``(n,)`` [kg].
        rate: Velocity on which damping acts.
        internal: Internal forces.
        loads: Forces of the loads.
        damping: Forces of damping; empty without damping.
        total: Sum of all, and of what is added to it, shape ``(n, 3)`` [N].
    """

    def __init__(self, bodies: Sequence[Body], u: fem.Function, loads: Sequence[Load]) -> None:
        """Compile the forms."""
        V = u.function_space
        self._F, self._eta = deformation_gradient(u), ufl.TestFunction(V)
        self.rate = fem.Function(V)
        self.mass: Floats = lumped_mass(bodies)
        soft = [body for body in bodies if not body.is_rigid]
        damped = [body for body in bodies if body.material.is_damped]
        works = [(soft, self._internal_work), *([(damped, self._damping_work)] if damped else [])]
        self.internal, *self.damping = (
            NodalForce(CellForm(bulk_form(some, work)) if some else None, V) for some, work in works
        )
        self.loads = [NodalForce(PackedForm(load.form(u, u)), V) for load in loads]
        self._strain_energy = (
            compile_form(bulk_form(soft, self._strain_energy_density)) if soft else None
        )
        # The sum takes the place of the internal forces, which each evaluation makes anew.
        self.total = self.internal.values

    def evaluate(self) -> None:
        """Set all forces to those of the present state. Collective."""
        self.internal.assemble()
        for part in (*self.loads, *self.damping):
            part.assemble()
            self.total += part.values

    @property
    def forces(self) -> list[Floats]:
        """Forces of the last evaluation, the total first, each ``(n, 3)`` [N]. Local."""
        return [self.internal.values, *(part.values for part in (*self.loads, *self.damping))]

    def work(self, du: Floats) -> list[float]:
        """Halves of the works of damping and of each present load on this rank [J]. Local.

        Args:
            du: Displacement of the owned nodes, shape ``(n, 3)`` [m].
        """
        damping, *loads = (
            sum(float(np.vdot(part.values, du)) / 2 for part in parts)
            for parts in (self.damping, *([load] for load in self.loads))
        )
        return [damping, *loads]

    def strain_energy(self) -> float:
        """Strain energy on this rank [J]."""
        energy = self._strain_energy
        return 0.0 if energy is None else float(fem.assemble_scalar(energy))

    def _internal_work(self, material: Hyperelastic, parameters: Any, rho: Any) -> Any:
        P = self._F * material.stress(right_cauchy_green(self._F), **parameters)
        return -ufl.inner(P, gradient(self._eta))

    def _damping_work(self, material: Hyperelastic, parameters: Any, rho: Any) -> Any:
        mesh = self.rate.function_space.mesh
        alpha = fem.Constant(mesh, material.mass_damping)
        beta = fem.Constant(mesh, material.stiffness_damping)
        strain_rate = ufl.sym(self._F.T * gradient(self.rate))
        P = beta * self._F * material.linear_stress(strain_rate, **parameters)
        drag = alpha * rho * ufl.inner(self.rate, self._eta)
        return -drag - ufl.inner(P, gradient(self._eta))

    def _strain_energy_density(self, material: Hyperelastic, parameters: Any, rho: Any) -> Any:
        return material.psi(right_cauchy_green(self._F), **parameters)
