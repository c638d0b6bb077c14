"""Energy that damping and materials take in a step of bodies with nodes that have no mass."""

from collections.abc import Sequence

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.fem.jit import compile_form
from dolfinx_nts.integrators.body_groups import BodyGroups
from dolfinx_nts.integrators.implicit_forms import StepForms
from dolfinx_nts.integrators.rates import Rates
from dolfinx_nts.integrators.surface_damping import SurfaceDamping
from dolfinx_nts.solvers.redistributed_mass import MassForce
from dolfinx_nts.solvers.surface_forces import SurfaceForces

__all__ = ["StepLosses"]


class StepLosses:
    """Losses by mass damping, stiffness damping, and materials with a memory. Collective.

    Args:
        forms: Forms of the bodies, without inertia.
        rates: Displacements of a step.
        drag: Forces of mass damping.
        massless: Owned nodes without mass, sorted, shape ``(m,)``.
        fixed: Owned scalar dofs where u is given.
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
        """What resists the equilibrium of nodes without mass, if anything. Local."""
        return None if self._damping is None else self._damping.resistance

    def begin(self) -> Floats | float:
        """Take the step that was solved; its damping forces at nodes without mass, ``(m, d)``."""
        return 0.0 if self._damping is None else self._damping.begin()

    def follow(self, dx: Floats) -> Floats | float:
        """Additional energy dissipated by damping in each group for displacements dx [m]."""
        return 0.0 if self._damping is None else self._damping.follow(dx)

    def on_this_rank(self) -> float:
        """Energy that is lost in the step on this rank [J]."""
        lost = 0.0 if self._memory is None else float(fem.assemble_scalar(self._memory))
        if self._damping is not None and self._groups.comm.rank == 0:
            lost += float(self._damping.taken.sum())
        num = len(self._groups.number_of)
        for mass, rate, _ in self._drag:
            force, u_n, u = (a.reshape(-1, mass.dim)[:num] for a in (rate(), *self._ends))
            lost += float(np.vdot(mass.times(force), u - u_n))
        return lost
