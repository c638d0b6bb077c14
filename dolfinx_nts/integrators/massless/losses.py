r"""Energy dissipated in a step of bodies with massless nodes, including stiffness damping.

With the stiffness K a massless node obeys :math:`\beta K \dot x_c = -r`, where r is the residual of
its static equilibrium. A second-order step of length h multiplies a deviation from equilibrium by
:math:`(1 - z/2)/(1 + z/2)`, :math:`z = h/\beta`. With weak damping the deviation alternates in sign
without decay. The equilibrium at the end of a step therefore removes the fraction :math:`z^3/(12 +
z^3)` of it, by a resistance :math:`12\, (\beta/h)^3 K`. Without damping this is the whole
deviation; it is less than the truncation error if the step resolves :math:`\beta`.
"""

from collections.abc import Sequence

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.jit import compile_form
from dolfinx_nts.integrators.implicit.implicit_forms import StepForms
from dolfinx_nts.integrators.massless.body_groups import BodyGroups
from dolfinx_nts.integrators.rates import Rates
from dolfinx_nts.solvers.massless.redistributed_mass import MassForce
from dolfinx_nts.solvers.massless.surface_forces import SurfaceForces
from dolfinx_nts.solvers.massless.surface_work import SurfaceWork

__all__ = ["StepLosses", "SurfaceDamping"]

# Factor of (beta/h)^3 K in the resistance of massless nodes [-], see the module docstring.
_RESISTANCE = 12.0


class SurfaceDamping:
    """Forces of stiffness damping at massless nodes, and its dissipation. Collective.

    Args:
        forms: Forms of the bodies, some with stiffness damping.
        rates: Displacements of a step.
        massless: Owned massless nodes, sorted, shape ``(m,)``.
        fixed: Owned scalar dofs whose displacement is prescribed.
        groups: Groups of connected bodies.

    Attributes:
        resistance: Forces of the resistance, whose derivative at u = u_n is used.
        dissipated: Energy dissipated in each group in the step, shape ``(g,)`` [J].
    """

    def __init__(
        self, forms: StepForms, rates: Rates, massless: Ints, fixed: Ints, groups: BodyGroups
    ) -> None:
        damping, u = forms.stiffness_damping(), rates.u
        topology = u.function_space.mesh.topology
        every = np.arange(topology.index_map(topology.dim).size_local, dtype=np.int32)
        self._forces = SurfaceForces(damping, u, massless, fixed)
        self.resistance = SurfaceForces(
            forms.stiffness_damping(factor=_RESISTANCE, power=3), u, massless, fixed
        )
        self._work, self._groups = SurfaceWork(damping, rates.u_n, u, every), groups
        self._at_nodes: Floats = np.zeros(self._forces.free.shape)
        self._dissipated_before: Floats = np.zeros(len(groups.nodes))
        self.dissipated: Floats = self._dissipated_before

    def begin(self) -> Floats:
        """Damping forces of the solved step at the massless nodes, shape ``(m, d)`` [N]."""
        self._at_nodes = self._forces.at_nodes()
        self.dissipated = self._dissipated_before = self._groups.sums(
            slice(None), self._work.at_nodes()
        )
        return self._at_nodes

    def follow(self, dx: Floats) -> Floats:
        """Update the dissipation for displacements of the nodes since `begin`, ``(m, d)`` [m].

        Returns:
            Additional dissipation in each group, shape ``(g,)`` [J]. The total dissipation of a
            step is never negative.
        """
        work = self._groups.sums(self._forces.nodes, (self._at_nodes * dx).sum(axis=1))
        more: Floats = np.maximum(work, -self._dissipated_before)
        self.dissipated = self._dissipated_before + more
        return more


class StepLosses:
    """Dissipation by mass damping, stiffness damping, and internal variables. Collective.

    Args:
        forms: Forms of the bodies, without inertia.
        rates: Displacements of a step.
        drag: Forces of mass damping.
        massless: Owned massless nodes, sorted, shape ``(m,)``.
        fixed: Owned scalar dofs whose displacement is prescribed.
        groups: Groups of connected bodies.
    """

    def __init__(
        self,
        forms: StepForms,
        rates: Rates,
        drag: Sequence[MassForce],
        massless: Ints,
        fixed: Ints,
        groups: BodyGroups,
    ) -> None:
        self._drag, self._groups, self._ends = drag, groups, (rates.u_n.x.array, rates.u.x.array)
        damping = massless, fixed, groups
        self._damping = (
            SurfaceDamping(forms, rates, *damping) if forms.has_stiffness_damping else None
        )
        memory = forms.dissipation()
        self._memory = None if memory is None else compile_form(memory)

    @property
    def resistance(self) -> SurfaceForces | None:
        """Resistance against the motion of massless nodes to equilibrium, if any. Local."""
        return None if self._damping is None else self._damping.resistance

    def begin(self) -> Floats | float:
        """Damping forces of the solved step at the massless nodes, shape ``(m, d)`` [N]."""
        return 0.0 if self._damping is None else self._damping.begin()

    def follow(self, dx: Floats) -> Floats | float:
        """Additional dissipation in each group for displacements dx [m], ``(g,)`` [J]."""
        return 0.0 if self._damping is None else self._damping.follow(dx)

    def on_this_rank(self) -> float:
        """Energy dissipated in the step on this rank [J]."""
        lost = 0.0 if self._memory is None else float(fem.assemble_scalar(self._memory))
        if self._damping is not None and self._groups.comm.rank == 0:
            lost += float(self._damping.dissipated.sum())
        num = len(self._groups.number_of)
        for mass, rate, _ in self._drag:
            force, u_n, u = (a.reshape(-1, mass.dim)[:num] for a in (rate(), *self._ends))
            lost += float(np.vdot(mass.times(force), u - u_n))
        return lost
