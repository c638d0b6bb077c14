"""Nodal forces of explicit steps, with lumped mass."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem, la

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, GlobalInts
from dolfinx_nts.contact.explicit.all_springs import AllSprings
from dolfinx_nts.fem.cell_constant import changing
from dolfinx_nts.fem.components import deformation_gradient, dimension, gradient
from dolfinx_nts.fem.linear_forms import CellForm, PackedForm
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.model.bodies import Body, bulk_form
from dolfinx_nts.model.loads.load import Load
from dolfinx_nts.model.lumped_mass import lumped_mass
from dolfinx_nts.parallel import reductions

__all__ = ["ExplicitBulk", "NodalForce", "PresentForces"]


class NodalForce:
    """Nodal forces assembled from a linear form.

    Args:
        form: Virtual work, or None for zero forces.
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
        """Assemble the forces at the current state. Collective."""
        self._local.fill(0.0)
        self.num_assemblies += 1
        if self._form is None:
            return
        self._form.assemble(self._local)
        self._vector.scatter_reverse(la.InsertMode.add)


class ExplicitBulk:
    """All forces on bodies except contact forces, which the stepper adds.

    Args:
        bodies: The bodies.
        u: Displacement at which the forces are evaluated.
        loads: Loads on the bodies.

    Attributes:
        mass: Lumped mass of the owned nodes, shape ``(n,)`` [kg].
        rate: Velocity from which damping forces are computed.
        internal: Internal forces.
        loads: Forces of the loads.
        damping: Damping forces; empty without damping.
        total: Sum of all forces, to which the stepper adds contact, shape ``(n, 3)`` [N].
        strain_energy: Strain energy of the cells of this rank at the last evaluation [J].
    """

    def __init__(self, bodies: Sequence[Body], u: fem.Function, loads: Sequence[Load]) -> None:
        V = u.function_space
        self._F, self._eta = deformation_gradient(u), ufl.TestFunction(V)
        # One kernel returns the nodal forces of a cell and then its strain energy, so that strains
        # are computed once.
        cell = V.mesh.basix_cell()
        number = basix.ufl.element("DG", cell, 0, dtype=V.mesh.geometry.x.dtype)
        W = fem.functionspace(V.mesh, basix.ufl.mixed_element([V.ufl_element(), number]))
        self.rate = fem.Function(V)
        self.mass: Floats = lumped_mass(bodies)
        soft = [body for body in bodies if not body.is_rigid]
        damped = [body for body in bodies if body.material.is_damped]
        work = partial(self._internal_work, *ufl.TestFunctions(W))
        form = bulk_form(soft, work) if soft else ufl.Form([])
        self._cells = CellForm(form, V=V, num_sums=1) if soft else None
        # Values of Constants and Functions in the energies of the materials, as shared views.
        self._of_materials: list[Any] = [constant.value for constant in form.constants()]
        self._of_materials += [f.x.array for f in changing(form.coefficients()) if f is not u]
        self._known_values = self._values()
        self.internal = NodalForce(self._cells, V)
        damping = [bulk_form(damped, self._damping_work)] if damped else []
        self.damping = [NodalForce(CellForm(form), V) for form in damping]
        self.loads = [NodalForce(PackedForm(load.form(u, u)), V) for load in loads]
        self.total: Floats = np.zeros_like(self.internal.values)
        self.strain_energy = 0.0
        # Forces whose works are reported: internal forces, damping if any, and loads.
        of_damping = self.damping[0].values if damped else None
        of_loads = (load.values for load in self.loads)
        self._working: list[Floats | None] = [self.internal.values, of_damping, *of_loads]

    def evaluate(self) -> None:
        """Evaluate all forces at the current state. Collective."""
        self.internal.assemble()
        np.copyto(self.total, self.internal.values)
        if self._cells is not None:
            self.strain_energy = float(self._cells.sums[0])
        for part in (*self.loads, *self.damping):
            part.assemble()
            self.total += part.values

    def have_materials_changed(self) -> bool:
        """Whether values in energies have changed on this rank since the last call. Local."""
        before, self._known_values = self._known_values, self._values()
        return before != self._known_values

    def _values(self) -> list[bytes]:
        """Values of Constants and Functions in the energies of the materials. Local."""
        return [value.tobytes() for value in self._of_materials]

    @property
    def forces(self) -> list[Floats]:
        """Forces of the last evaluation, the total first, each ``(n, 3)`` [N]. Local."""
        parts = self.internal, *self.loads, *self.damping
        return [self.total, *(part.values for part in parts)]

    def work(self, du: Floats) -> list[float]:
        """Half the work of internal forces, damping and each load on this rank [J]. Local.

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


class PresentForces:
    """Accelerations, power and strain energy of the last force evaluation. Collective.

    Args:
        bulk: Forces on the bodies, with contact in their total.
        springs: Contact springs of all pairs.
        mobility: Inverse mass of the free degrees of freedom, 0 at prescribed ones, shape
            ``(n, d)`` [1/kg].

    Attributes:
        acceleration: Acceleration of the owned nodes, shape ``(n, d)`` [m/s^2].
        power: Sum of the products of force and acceleration on this rank [N m/s^2].
        strain_energy: Strain energy of all ranks [J].
        known: Whether the forces belong to the current state.
    """

    def __init__(self, bulk: ExplicitBulk, springs: AllSprings, mobility: Floats) -> None:
        self._bulk, self._springs, self._mobility = bulk, springs, mobility
        self.acceleration: Floats = np.zeros_like(mobility)
        self.power = self.strain_energy = 0.0
        self.known = False

    def begin(self) -> None:
        """Set accelerations and power of a new state from the last evaluation of the forces."""
        total = self._bulk.total
        self._springs.accept()
        np.multiply(self._mobility, total, out=self.acceleration)
        self.power = float(np.vdot(total, self.acceleration))
        comm = self._bulk.rate.function_space.mesh.comm
        self.strain_energy = reductions.total(comm, self._bulk.strain_energy)

    def kick(self, dt: float, rate: Floats) -> float:
        """Complete the velocities of a step with the accelerations at its end. Local.

        Args:
            dt: Length of the step [s].
            rate: Velocities in the middle of the step, overwritten where they are free by those
                at its end, shape ``(n, d)`` [m/s].

        Returns:
            Change of the power on this rank [N m/s^2].
        """
        before, total = self.power, self._bulk.total
        self.power = _kernels.kick(dt, self._mobility, total, self.acceleration, rate)
        return self.power - before

    def serialize(self, archive: Archive, node_ids: GlobalInts, x: Floats) -> None:
        """Serialize the last forces, which are then not evaluated again.

        Args:
            archive: The archive.
            node_ids: Input numbers of the owned nodes, see `node_numbering`, shape ``(n,)``.
            x: Positions of the local nodes, shape ``(l, 3)`` [m].
        """
        self.known = archive.same("forces_are_known", self.known)
        if not self.known:
            return
        for number, force in enumerate((self.acceleration, *self._bulk.forces)):
            force[:] = archive.nodal(f"force/{number}", node_ids, force)
        # The sum is stored, as another order of summation would change its last digit.
        self.strain_energy = archive.same("strain_energy", self.strain_energy)
        stored = archive.local("power", None if archive.restores else [np.array(self.power)])
        computed = np.vdot(self._bulk.total, self.acceleration)
        self.power = float(computed if stored is None else stored[0])
        self._springs.serialize(archive, x)
