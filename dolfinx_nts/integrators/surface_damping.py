r"""Stiffness damping where nodes have no mass, so that it alone holds them back.

With a matrix K such a node obeys :math:`\beta K \dot x_c = -r`, with the rest r of its static
equilibrium. A step of length h, of second order, leaves of a deviation from equilibrium the part
:math:`(1 - z/2)/(1 + z/2)`, :math:`z = h/\beta`: where damping is weak deviations alternate for
ever. The equilibrium at the end of a step therefore takes from them what remains of nodes that a
resistance :math:`12\, (\beta/h)^3 K` holds, the part :math:`z^3/(12 + z^3)`: all without damping,
and where a step resolves :math:`\beta` no more than its error.
"""

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.integrators.body_groups import BodyGroups
from dolfinx_nts.integrators.implicit_forms import StepForms
from dolfinx_nts.integrators.rates import Rates
from dolfinx_nts.solvers.surface_forces import SurfaceForces
from dolfinx_nts.solvers.surface_work import SurfaceWork

__all__ = ["SurfaceDamping"]

# Part of (beta/h)^3 K with which damping resists the equilibrium, see above [-].
_RESISTANCE = 12.0


class SurfaceDamping:
    """Forces of stiffness damping at nodes without mass, and its dissipation. Collective.

    Args:
        forms: Forms of the bodies, some of which have stiffness damping.
        rates: Displacements of a step.
        massless: Owned nodes without mass, sorted, shape ``(m,)``.
        fixed: Owned scalar dofs where u is given.
        groups: Groups of connected bodies.

    Attributes:
        resistance: What resists the equilibrium, by its derivative where u_n is u.
        taken: Energy that the damping takes of each group in the step, shape ``(g,)`` [J].
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
        self._taken_before: Floats = np.zeros(len(groups.nodes))
        self.taken: Floats = self._taken_before

    def begin(self) -> Floats:
        """Take the step that was solved; its forces at the nodes without mass, ``(m, d)`` [N]."""
        self._at_nodes = self._forces.at_nodes()
        self.taken = self._taken_before = self._groups.sums(slice(None), self._work.at_nodes())
        return self._at_nodes

    def follow(self, dx: Floats) -> Floats:
        """Let the forces work on ways of the nodes since `begin`, ``(m, d)`` [m].

        Returns:
            What the damping of each group takes more by that, shape ``(g,)`` [J]. In all a step
            never gets energy from damping.
        """
        work = self._groups.sums(self._forces.nodes, (self._at_nodes * dx).sum(axis=1))
        more: Floats = np.maximum(work, -self._taken_before)
        self.taken = self._taken_before + more
        return more
