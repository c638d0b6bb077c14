r"""Memory of viscous branches: strains of dashpots at the points of the quadrature.

With :math:`\theta` the part of the end of the step in the stress of the scheme (1/2 for the
energy-momentum scheme) and :math:`E_\theta = (1 - \theta) E_n + \theta E_{n+1}`, the rate law of
a branch in a step is :math:`\tau (\Gamma_{n+1} - \Gamma_n)/\Delta t = E_\theta - \Gamma_\theta`,
so that

.. math:: \Gamma_{n+1} - \Gamma_n = \frac{\Delta t}{\tau + \theta \Delta t}
   (E_\theta - \Gamma_n), \qquad
   S = s D : (E_\theta - \Gamma_\theta)
   = \frac{s \tau}{\tau + \theta \Delta t} D : (E_\theta - \Gamma_n).

The strains of the dashpots are thus no unknowns. For :math:`\theta = 1/2` the work of S is the
change of the energy of the spring plus the dissipation
:math:`s \tau/\Delta t\, \Delta\Gamma : D : \Delta\Gamma \ge 0`, exactly.
"""

from collections.abc import Sequence
from typing import Any

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.components import deformation_gradient, gradient
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.jit import compile_expression
from dolfinx_nts.materials.branches import Branch
from dolfinx_nts.materials.hyperelastic import Hyperelastic, right_cauchy_green
from dolfinx_nts.model.bodies import Body

__all__ = ["Memory"]

# Entries of a symmetric tensor, in the order in which they are stored.
_ENTRIES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


class Memory:
    """Strains of the dashpots of all bodies, and what they add to forms. Collective.

    Args:
        bodies: The bodies.
        u_n: Displacement at the start of a step [m].
        u: Displacement at its end [m].
        dt: Length of the step, a constant [s].
        share: Part of the end of the step in the stress of the scheme, theta [-].
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        u_n: fem.Function,
        u: fem.Function,
        dt: fem.Constant,
        share: float,
    ) -> None:
        """Begin with dashpots without strain."""
        self._dt, self._theta = dt, share
        F_n, F = map(deformation_gradient, (u_n, u))
        self._F = (1 - share) * F_n + share * F
        self._E_n, self._E = ((right_cauchy_green(G) - ufl.Identity(3)) / 2 for G in (F_n, F))
        self._mean = (1 - share) * self._E_n + share * self._E
        self._dashpots: dict[Hyperelastic, _Dashpots] = {}
        for material in dict.fromkeys(body.material for body in bodies):
            if material.branches:
                cells = [body.cells for body in bodies if body.material is material]
                self._dashpots[material] = _Dashpots(
                    u.function_space, np.sort(np.concatenate(cells)), material.branches, self._mean
                )

    @property
    def exists(self) -> bool:
        """Whether any material has branches. Local."""
        return bool(self._dashpots)

    def begin(self) -> None:
        """Begin a step with the strains that were accepted last. Local."""
        for dashpots in self._dashpots.values():
            dashpots.strain_n.x.array[:] = dashpots.strain.x.array

    def accept(self) -> None:
        """Set the strains at the end of the step that was solved. Local."""
        dt = float(self._dt.value)
        for material, dashpots in self._dashpots.items():
            times = [branch.relaxation_time for branch in material.branches]
            dashpots.follow(np.array([dt / (time + self._theta * dt) for time in times]))

    def serialize(self, archive: Archive) -> None:
        """Serialize the strains at both ends of the last step."""
        for number, dashpots in enumerate(self._dashpots.values(), start=1):
            dashpots.serialize(archive, f"dashpots_{number}")

    def work(self, material: Hyperelastic, parameters: Any, eta: Any) -> Any:
        """Virtual work of the branches per reference volume, UFL [J/m^3].

        Args:
            material: Material with branches.
            parameters: Its numbers by name, as constants.
            eta: Test function, UFL.
        """
        strain = ufl.zero(3, 3)
        for number, branch in enumerate(material.branches):
            share, time = self._numbers(branch)
            gamma_n = self._dashpots[material].at_start(number)
            strain += share * time / (time + self._theta * self._dt) * (self._mean - gamma_n)
        return ufl.inner(self._F * material.shape_stress(strain, **parameters), gradient(eta))

    def stiffness(self, material: Hyperelastic, parameters: Any, rate: Any) -> Any:
        """Stress of a strain E at the end of the step, as a tangent has it, UFL (3, 3) [Pa]."""
        numbers = [self._numbers(branch) for branch in material.branches]
        factor = sum(s * t / (t + self._theta * self._dt) for s, t in numbers)
        return self._theta * factor * material.shape_stress(rate, **parameters)

    def dissipation(self, material: Hyperelastic, parameters: Any) -> Any:
        """Energy that the dashpots take in the step, per reference volume, UFL [J/m^3]."""
        total = ufl.as_ufl(0)
        for number, branch in enumerate(material.branches):
            share, time = self._numbers(branch)
            gamma_n = self._dashpots[material].at_start(number)
            change = self._dt / (time + self._theta * self._dt) * (self._mean - gamma_n)
            stress = material.shape_stress(change, **parameters)
            total += share * time / self._dt * ufl.inner(stress, change)
        return total

    def energy(self, material: Hyperelastic, parameters: Any) -> Any:
        """Energy of the springs at the end of the step per reference volume, UFL [J/m^3]."""
        dashpots = self._dashpots[material]
        strains = (self._E - dashpots.at_end(i) for i in range(len(material.branches)))
        return self._stored(material, parameters, strains)

    def energy_at_start(self, material: Hyperelastic, parameters: Any) -> Any:
        """The same at the start of the step."""
        dashpots = self._dashpots[material]
        strains = (self._E_n - dashpots.at_start(i) for i in range(len(material.branches)))
        return self._stored(material, parameters, strains)

    def stress(self, material: Hyperelastic, parameters: Any, C: Any) -> tuple[Any, Any]:
        """Stress and energy of the springs at t with the mean strains of dashpots in cells.

        Args:
            material: Material with branches.
            parameters: Its numbers by name, as constants.
            C: Right Cauchy-Green tensor at t, UFL (3, 3).

        Returns:
            Second Piola-Kirchhoff stress, UFL (3, 3) [Pa], and energy, UFL [J/m^3].
        """
        means, E = self._dashpots[material].means, (C - ufl.Identity(3)) / 2
        strains = [E - _tensor(means, i) for i in range(len(material.branches))]
        shares = (self._numbers(branch)[0] for branch in material.branches)
        total = sum(share * strain for share, strain in zip(shares, strains, strict=True))
        energy = self._stored(material, parameters, strains)
        return material.shape_stress(total, **parameters), energy

    def _stored(self, material: Hyperelastic, parameters: Any, strains: Any) -> Any:
        """Energy of springs by their strains."""
        shares = (self._numbers(branch)[0] for branch in material.branches)
        return sum(
            share / 2 * ufl.inner(material.shape_stress(strain, **parameters), strain)
            for share, strain in zip(shares, strains, strict=True)
        )

    def _numbers(self, branch: Branch) -> tuple[fem.Constant, fem.Constant]:
        """Share and relaxation time as constants."""
        mesh = self._dt.ufl_domain()
        share, time = (fem.Constant(mesh, number) for number in branch)
        return share, time


class _Dashpots:
    """Strains of the dashpots of one material at the points of its cells.

    Args:
        V: Space of the displacement.
        cells: Owned cells of the material, shape ``(c,)``.
        branches: Branches of the material.
        strain: Strain that the dashpots follow, UFL (3, 3).

    Attributes:
        strain_n: Strains at the start of the last step [-], a Function of points.
        strain: Strains at its end.
        means: Their means over the points of each cell.
    """

    def __init__(
        self, V: fem.FunctionSpace, cells: Ints, branches: Sequence[Branch], strain: Any
    ) -> None:
        mesh, degree = V.mesh, Element.of(V).stress_degree
        self._mesh, self._cells, self._number = mesh, cells, len(branches)
        self._ids = mesh.topology.original_cell_index[cells]
        cell = mesh.topology.cell_name()
        entries = len(_ENTRIES) * len(branches)
        element = basix.ufl.quadrature_element(cell, value_shape=(entries,), degree=degree)
        space = fem.functionspace(mesh, element)
        self.strain_n, self.strain = fem.Function(space), fem.Function(space)
        self._dofs = space.dofmap.list[cells]
        constant = fem.functionspace(mesh, ("Discontinuous Lagrange", 0, (entries,)))
        self.means, self._places = fem.Function(constant), constant.dofmap.list[cells, 0]
        points, _ = basix.make_quadrature(basix.CellType[cell], degree)
        parts = ufl.as_vector([strain[entry] for entry in _ENTRIES])
        self._expression = compile_expression(parts, points)

    def at_start(self, branch: int) -> Any:
        """Strain of a branch at the start of the step, UFL (3, 3)."""
        return _tensor(self.strain_n, branch)

    def at_end(self, branch: int) -> Any:
        """Strain of a branch at the end of the step, UFL (3, 3)."""
        return _tensor(self.strain, branch)

    def follow(self, parts: Floats) -> None:
        """Set the strains at the end by the parts of the way that each branch goes, ``(b,)``."""
        strain = self._expression.eval(self._mesh, self._cells)
        strain = strain.reshape(*self._dofs.shape, 1, len(_ENTRIES))
        before = self._of(self.strain_n)
        values = before + parts[:, None] * (strain - before)
        self._set(self.strain, values)

    def serialize(self, archive: Archive, name: str) -> None:
        """Serialize the strains by the numbers of the cells in the mesh as read."""
        for end, function in (("start", self.strain_n), ("end", self.strain)):
            values = self._of(function)
            self._set(function, archive.nodal(f"{name}/{end}", self._ids, values))

    def _of(self, function: fem.Function) -> Floats:
        """Strains at the points of the cells, shape ``(c, p, b, 6)``."""
        rows = function.x.array.reshape(-1, self._number, len(_ENTRIES))
        values: Floats = rows[self._dofs]
        return values

    def _set(self, function: fem.Function, values: Floats) -> None:
        rows = function.x.array.reshape(-1, self._number, len(_ENTRIES))
        rows[self._dofs] = values
        if function is self.strain:
            means = self.means.x.array.reshape(-1, self._number, len(_ENTRIES))
            means[self._places] = values.mean(axis=1)


def _tensor(strains: fem.Function, branch: int) -> Any:
    """Symmetric tensor of a branch, UFL (3, 3)."""
    first = len(_ENTRIES) * branch
    number = {entry: first + i for i, entry in enumerate(_ENTRIES)}
    rows = [[strains[number[min(i, j), max(i, j)]] for j in range(3)] for i in range(3)]
    return ufl.as_matrix(rows)
