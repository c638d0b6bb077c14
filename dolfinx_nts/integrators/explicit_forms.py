"""Forces of the bodies at one time, with lumped mass, for explicit steps."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem, la

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import deformation_gradient, dimension, gradient
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
        strain_energy: Strain energy of the cells of this rank at the last evaluation [J].
    """

    def __init__(self, bodies: Sequence[Body], u: fem.Function, loads: Sequence[Load]) -> None:
        V = u.function_space
        self._F, self._eta = deformation_gradient(u), ufl.TestFunction(V)
        # The strain energy of a cell stands behind the forces on its nodes: both have the same
        # strain, which is computed once.
        cell = V.mesh.basix_cell()
        number = basix.ufl.element("DG", cell, 0, dtype=V.mesh.geometry.x.dtype)
        W = fem.functionspace(V.mesh, basix.ufl.mixed_element([V.ufl_element(), number]))
        self.rate = fem.Function(V)
        self.mass: Floats = lumped_mass(bodies)
        soft = [body for body in bodies if not body.is_rigid]
        damped = [body for body in bodies if body.material.is_damped]
        work = partial(self._internal_work, *ufl.TestFunctions(W))
        self._cells = CellForm(bulk_form(soft, work), V=V, num_sums=1) if soft else None
        self.internal = NodalForce(self._cells, V)
        damping = [bulk_form(damped, self._damping_work)] if damped else []
        self.damping = [NodalForce(CellForm(form), V) for form in damping]
        self.loads = [NodalForce(PackedForm(load.form(u, u)), V) for load in loads]
        self.total: Floats = np.zeros_like(self.internal.values)
        self.strain_energy = 0.0
        # Forces whose works are told: internal ones, those of damping if there are, and loads.
        of_damping = self.damping[0].values if damped else None
        of_loads = (load.values for load in self.loads)
        self._working: list[Floats | None] = [self.internal.values, of_damping, *of_loads]

    def evaluate(self) -> None:
        """Set all forces to those of the present state. Collective."""
        self.internal.assemble()
        np.copyto(self.total, self.internal.values)
        if self._cells is not None:
            self.strain_energy = float(self._cells.sums[0])
        for part in (*self.loads, *self.damping):
            part.assemble()
            self.total += part.values

    @property
    def forces(self) -> list[Floats]:
        """Forces of the last evaluation, the total first, each ``(n, 3)`` [N]. Local."""
        parts = self.internal, *self.loads, *self.damping
        return [self.total, *(part.values for part in parts)]

    def work(self, du: Floats) -> list[float]:
        """Halves of the works of internal forces, damping and each load on this rank [J]. Local.

        Args:
            du: Displacement of the owned nodes, shape ``(n, 3)`` [m].
        """
        return [0.0 if force is None else float(np.vdot(force, du)) / 2 for force in self._working]

    def _internal_work(
        self, eta: Any, of_energy: Any, material: Hyperelastic, parameters: Any, rho: Any
    ) -> Any:
        C = right_cauchy_green(self._F)
        P = self._F * material.stress(C, **parameters)
        return of_energy * material.psi(C, **parameters) - ufl.inner(P, gradient(eta))

    def _damping_work(self, material: Hyperelastic, parameters: Any, rho: Any) -> Any:
        mesh = self.rate.function_space.mesh
        alpha = fem.Constant(mesh, material.mass_damping)
        beta = fem.Constant(mesh, material.stiffness_damping)
        strain_rate = ufl.sym(self._F.T * gradient(self.rate))
        P = beta * self._F * material.linear_stress(strain_rate, **parameters)
        drag = alpha * rho * ufl.inner(self.rate, self._eta)
        return -drag - ufl.inner(P, gradient(self._eta))
