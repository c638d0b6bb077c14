"""Fields of a stepper as DOLFINx Functions: motion, contact, stress and strain energy."""

from functools import cached_property

from mpi4py import MPI

import basix
import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arguments import as_call
from dolfinx_nts.common.arrays import Array, Floats
from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.diagnostics.functions import NodalFunctions
from dolfinx_nts.diagnostics.nodal_fields import NodalFields
from dolfinx_nts.fem.components import nodal
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.cell_stress import CellStress, StressState
from dolfinx_nts.parallel.collective_calls import collective, meet

__all__ = ["Fields"]


@collective
class Fields:
    """Fields of a stepper's accepted state as DOLFINx Functions.

    Each call updates the same Function, which can be given to a writer once. Its values do not
    change until the next call. Functions of motion and contact have the nodes of the bodies'
    space. Functions of stress are discontinuous between cells: constant in cells of degree 1, with
    the value at the centre, and linear in cells of degree 2. Collective, as are all its methods.

    Args:
        stepper: The stepper.

    Raises:
        TypeError: ``stepper`` is not a Stepper.
        ValueError: Not all ranks make the same call.

    Example:
        >>> fields = nts.Fields(stepper)
        >>> steps = list(stepper.run(until=0.02))
        >>> pressure = fields.contact_pressure()
        >>> pressure.name, bool(pressure.x.array.max() > 0.0)
        ('contact_pressure', True)
        >>> stress = fields.von_mises_stress()
        >>> len(stress.x.array) == len(body.cells) + len(other.cells)
        True
    """

    def __init__(self, stepper: Stepper) -> None:
        if not isinstance(stepper, Stepper):
            raise TypeError(f"expected a stepper, given {type(stepper).__name__}")
        self._comm: MPI.Comm = stepper.u.function_space.mesh.comm
        meet(self._comm, "make Fields")
        self._stepper = stepper
        self._nodal = NodalFields(stepper)
        self._functions = NodalFunctions(stepper.u.function_space)
        self._cell: dict[str, fem.Function] = {}

    def __repr__(self) -> str:
        return as_call(self, stepper=type(self._stepper))

    def displacement(self) -> fem.Function:
        """Displacement of each node [m], a copy of ``stepper.u``."""
        return self._motion("displacement", self._stepper.u)

    def velocity(self) -> fem.Function:
        """Velocity of each node [m/s], a copy of ``stepper.v``; 0 in statics."""
        return self._motion("velocity", self._stepper.v)

    def gap(self) -> fem.Function:
        """Smallest gap of each node [m], > 0 open, NaN without a candidate segment."""
        return self._contact("gap")

    def contact_pressure(self) -> fem.Function:
        """Contact pressure at the nodes of all pairs [Pa], 0 elsewhere.

        With mortar contact it refers to the part of the surface in contact, averaged over a node
        and its neighbours where that part is small. On facets partly in contact it therefore
        exceeds force per facet area, which is `contact_traction`.
        """
        return self._contact("contact_pressure")

    def contact_traction(self) -> fem.Function:
        """Contact force per reference area, with friction, at the nodes of all pairs [Pa].

        It is 0 elsewhere, also on the side of the segments, unless that side has contact nodes of
        its own. With mortar contact its integral over the whole surface of the nodes is the force.
        With node-to-segment contact and obstacles, it is the integral over the facets that face the
        contact. At degree 2, interpolate it linearly on halves of edges to integrate.
        """
        return self._contact("contact_traction")

    def cauchy_stress(self) -> fem.Function:
        """Cauchy stress in the cells, shape (3, 3), also in the plane [Pa].

        At degree 1 it is the value at the centre of each cell, at degree 2 it is linear in each
        cell.
        """
        return self._of_cells("cauchy_stress", self._state().cauchy)

    def von_mises_stress(self) -> fem.Function:
        """Von Mises stress in the cells [Pa]."""
        return self._of_cells("von_mises_stress", self._state().von_mises())

    def strain_energy_density(self) -> fem.Function:
        """Strain energy per reference volume in the cells [J/m^3]."""
        return self._of_cells("strain_energy_density", self._state().energy_density)

    def plastic_strain(self) -> fem.Function:
        """Equivalent plastic strain, mean of each cell [-]; 0 without plasticity."""
        strain = self._stepper.memory.plastic_strain()
        return self._of_cells("plastic_strain", strain[:, None])

    def _motion(self, name: str, function: fem.Function) -> fem.Function:
        owned = nodal(function)[: len(self._stepper.node_ids)]
        return self._functions.set(name, owned)

    def _contact(self, name: str) -> fem.Function:
        return self._functions.set(name, self._nodal.contact(CurrentState(self._stepper), name))

    @cached_property
    def _stress(self) -> CellStress:
        u = self._stepper.u
        element = Element.of(u.function_space)
        points: Floats = basix.create_element(
            basix.ElementFamily.P,
            basix.CellType[element.cell],
            element.degree - 1,
            basix.LagrangeVariant.gll_warped,
            basix.DPCVariant.unset,
            True,
        ).points
        return CellStress(self._stepper.bodies, u, points, self._stepper.memory.stress)

    def _state(self) -> StressState:
        return self._stress.evaluate()

    def _of_cells(self, name: str, values: Array) -> fem.Function:
        """Function with a name and values ``(c, p, ...)`` in the owned cells."""
        V = self._stepper.u.function_space
        shape = values.shape[2:]
        if name not in self._cell:
            space = fem.functionspace(V.mesh, ("DG", Element.of(V).degree - 1, shape))
            self._cell[name] = fem.Function(space, name=name)
        function = self._cell[name]
        dofs = function.function_space.dofmap.list[: len(values)]
        size = int(np.prod(shape, dtype=int))
        function.x.array.reshape(-1, size)[dofs] = values.reshape(*values.shape[:2], size)
        function.x.scatter_forward()
        return function
