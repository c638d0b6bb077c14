"""Linear systems of Newton's method, solved by a preconditioned Krylov method.

The operator is the exact tangent of bodies and contacts, projected on the
constraints by `elimination`; no matrix is assembled for it. The preconditioner
consists of factors of the matrix of the bodies, which serve for many steps, and
of a correction around the contacts. Where the Krylov method fails, the whole
system is factorised.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.active_sets import ActiveSets
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.cone_problem import CondensedSystem, has_cone_problem, solve_cone_problem
from dolfinx_nts.solvers.contact_corrections import ContactCorrections
from dolfinx_nts.solvers.elimination import ActivePairs, Elimination, active_pairs
from dolfinx_nts.solvers.factor_age import FactorAge
from dolfinx_nts.solvers.inertia_relief import InertiaRelief
from dolfinx_nts.solvers.krylov_failures import KrylovFailures
from dolfinx_nts.solvers.petsc_options import PetscOptions
from dolfinx_nts.solvers.preconditioner import BulkPreconditioner
from dolfinx_nts.solvers.projected_krylov import (
    KrylovMethod,
    Operator,
    Preconditioner,
    RigidPreconditioner,
)
from dolfinx_nts.solvers.saddle_point import SaddlePointSystem
from dolfinx_nts.solvers.statistics import SolverStatistics
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["LinearSolver"]

# Share of the reduction asked for that a right-hand side may leave out [-].
_NEGLIGIBLE = 0.03
# Bound on a force of the bulk: sum of a row of the tangent over its diagonal [-].
_ROW_SUM = 3.0
# Number of random forces that look for a motion along which the energy falls.
_NUM_FORCES = 4


class LinearSolver:
    """Solves for the increments of Newton's method.

    Args:
        bulk: Residual of the bodies.
        tangent: Matrix of its derivative.
        inertia: Share of lumped inertia in the tangent at the owned dofs,
            shape ``(d n,)`` [N/m]; 0 without inertia.
        options: PETSc options without prefix: ``ksp_...`` for the Krylov
            method, all others for the preconditioner of the bulk.

    Attributes:
        tangent: The matrix.
        num_direct: Number of systems that were factorised as a whole.

    Raises:
        ValueError: The preconditioner does not exist on several ranks.
    """

    def __init__(
        self,
        bulk: Bulk,
        tangent: Tangent,
        inertia: Callable[[], Floats],
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Create the Krylov method and its preconditioner, as yet without factors."""
        self.tangent, self._inertia = tangent, inertia
        known = PetscOptions(bulk.comm, options)
        self._operator = Operator(bulk)
        self._preconditioner = BulkPreconditioner(tangent, known)
        self._contacts = ContactCorrections(tangent, self._preconditioner)
        context: Preconditioner | RigidPreconditioner
        context = Preconditioner(self._operator, self._preconditioner, self._contacts)
        if bulk.rigid.exists:
            context = RigidPreconditioner(context, bulk.rigid, tangent)
        self._krylov = KrylovMethod(self._operator, context, known)
        self._active_sets = ActiveSets(bulk.comm)
        self._saddle = SaddlePointSystem(tangent, bulk)
        self._factors = FactorAge(tangent, self._preconditioner, self._operator, inertia)
        self._failures = KrylovFailures()
        self.num_direct = 0

    @property
    def one_application_reduction(self) -> float:
        """Reduction for which the preconditioner is applied once, without a product [-]. Local.

        It is what an iteration was found to give; NaN as long as this is not known, with rigid
        bodies, and where waves go so far in a step that incomplete factors do not suffice: there
        what is left of an increment moves contacts everywhere.
        """
        has_rigid = self._operator.bulk.rigid.exists
        return math.nan if has_rigid else self._factors.one_application_reduction

    @property
    def num_iterations(self) -> int:
        """Krylov iterations so far, but for those of `solve_for`."""
        return self._krylov.num_iterations

    def solve(
        self,
        R: Floats,
        steps: Sequence[ContactStep],
        states: Sequence[ContactContribution],
        rtol: float,
    ) -> tuple[Floats, list[Floats] | None]:
        """Increments of one Newton iteration. Collective.

        Args:
            R: Residual on the owned dofs, shape ``(d n,)`` [N].
            steps: Contact attempts.
            states: Their pairs.
            rtol: Reduction of the projected residual.

        Returns:
            du on the owned dofs [m]; and increments of the multipliers of
            each state, constraint by constraint [N], or None where the
            balance of forces at the nodes is the better estimate.

        Raises:
            ValueError: There are PETSc options that nothing asks for.
        """
        pairs = active_pairs(steps, states, self._operator.bulk.rigid.dim)
        elimination = Elimination(pairs, self._active_sets.number(pairs))
        if pairs and self._active_sets.are_coupled(pairs):
            return self._solve_direct(R, steps, pairs)
        if self._operator.bulk.rigid.has_no_inertia or self._failures.skip():
            return self._solve_direct(R, steps, pairs)
        factors = self._factors
        is_new = factors.renew()
        num_active = sum(step.num_active for step in steps)
        self._contacts.choose(num_active)
        while (du := self._solve_krylov(R, elimination, rtol)) is None:
            if self._contacts.choose(num_active):
                continue
            # Where it fails, there are new factors, then stronger ones, then the whole system.
            if is_new and not self._preconditioner.strengthen():
                self._failures.count()
                return self._solve_direct(R, steps, pairs)
            factors.build()
            is_new = True
        self._failures.forget()
        factors.strengthen_if_slow(is_new)
        if not (num_active and self._contacts.uses_complement):
            return du, None
        # Near incompressibility this balance is of no use before convergence: what volumes lack
        # is far above contact forces.
        y = self._nodal(R) + self._operator.bulk.action(self._nodal(du))
        increments = iter(elimination.multipliers(self._nodal(du), y))
        return du, [next(increments) if step.num_active else np.empty(0) for step in steps]

    def solve_for(
        self,
        nodes: Flags,
        R: Floats,
        steps: Sequence[ContactStep],
        states: Sequence[ContactContribution],
        rtol: float,
    ) -> Floats | None:
        """Increments of some nodes, with all others given, by incomplete factors. Collective.

        Args:
            nodes: Which owned nodes the bulk does not take as given, shape ``(n,)``.
            R: Residual on the owned dofs, 0 where they are given [N].
            steps: Contact attempts.
            states: Their pairs.
            rtol: Reduction of the projected residual.

        Returns:
            du on the owned dofs [m]. None where there are none, or others, and where multipliers
            cannot be eliminated.
        """
        self._contacts.choose(sum(step.num_active for step in steps))
        if self._contacts.uses_complement or not self._preconditioner.is_incomplete:
            return None
        pairs = active_pairs(steps, states, self._operator.bulk.rigid.dim)
        elimination = Elimination(pairs, self._active_sets.number(pairs))
        if pairs and self._active_sets.are_coupled(pairs):
            return None
        with self._preconditioner.restricted(nodes):
            return self._solve_krylov(R, elimination, rtol, is_local=True)

    def consistent_states(
        self,
        R: Floats,
        steps: Sequence[ContactStep],
        states: Sequence[ContactContribution],
        inertia: bool,
        relief: InertiaRelief,
    ) -> tuple[ContactContribution, ...] | None:
        """States of contact that obey all conditions of the linear system. Collective.

        Args:
            R: Residual on the owned dofs, shape ``(d n,)`` [N].
            steps: Contact attempts.
            states: Their pairs.
            inertia: Whether there is any.
            relief: Knows how free bodies move.

        Returns:
            The pairs with these states, None if nothing was decided, see `cone_problem`.
        """
        if not has_cone_problem(steps, inertia):
            return None
        system = self._condensed_system(steps, states, inertia, relief)
        if system is None:
            return None
        return solve_cone_problem(system, self._operator.bulk.comm, R, steps, states, inertia)

    def negative_curvature_direction(
        self, steps: Sequence[ContactStep], states: Sequence[ContactContribution], seed: int
    ) -> Floats | None:
        """Motion along which the energy falls from the present equilibrium. Collective.

        Friction is constant in it. It is looked for with the factors that there are, or where
        whole systems are factorised by those of one more.

        Args:
            steps: Contact attempts.
            states: Their pairs, in equilibrium.
            seed: Chooses the forces that look for it.

        Returns:
            The motion at the owned nodes, shape ``(n, d)``; None if there is none, or where no
            system has been solved yet.
        """
        bulk, dim = self._operator.bulk, self._operator.bulk.rigid.dim
        pairs = active_pairs(steps, states, dim)
        present = Elimination(pairs, self._active_sets.number(pairs))
        is_whole = bulk.rigid.has_no_inertia
        is_whole = is_whole or (len(pairs) > 0 and self._active_sets.are_coupled(pairs))
        if not is_whole and self._preconditioner.point is None:
            return None
        constant = [state._replace(columns=state.pairs.gradients) for state in states]
        stiffness = self.tangent.nodal_stiffness()[:, None]
        generator = np.random.default_rng([seed, bulk.comm.rank])
        if is_whole:
            weights = np.repeat(stiffness, dim, axis=1).ravel()
            forces = generator.standard_normal((_NUM_FORCES, len(weights))) * np.sqrt(weights)
            forces[:, bulk.given] = 0
            found = self._saddle.negative_curvature_direction(
                active_pairs(steps, constant, dim), forces, weights
            )
            return None if found is None else found.reshape(-1, dim)
        if pairs:
            self._contacts.choose(sum(step.num_active for step in steps))
            self._contacts.update(present)
        pairs = active_pairs(steps, constant, dim)
        self._operator.elimination = Elimination(pairs, present.active_version)
        numbers = generator.standard_normal((len(stiffness), dim))
        return self._krylov.negative_curvature_direction(np.sqrt(stiffness), numbers)

    def _condensed_system(
        self,
        steps: Sequence[ContactStep],
        states: Sequence[ContactContribution],
        inertia: bool,
        relief: InertiaRelief,
    ) -> CondensedSystem | None:
        """The system whose points may be decided on all at once. Collective.

        With inertia these are the points of small systems in which nothing is eliminated;
        elsewhere multipliers tell node by node. Without, where nodes feel each other far around
        and bodies may have no other hold, those of all deformable bodies.
        """
        bulk = self._operator.bulk
        if not inertia:
            condense = partial(self._contacts.condensed, relief=relief)
            return None if bulk.rigid.exists else condense
        if not self._saddle.may_be_small:
            return None
        pairs = active_pairs(steps, states, bulk.rigid.dim)
        self._active_sets.number(pairs)
        is_whole = pairs and self._active_sets.are_coupled(pairs)
        return self._saddle.condensed if is_whole else None

    @property
    def statistics(self) -> SolverStatistics:
        """Work so far. Local."""
        bulk, preconditioner = self._operator.bulk, self._preconditioner
        num_residuals, num_actions = bulk.num_assembled
        return SolverStatistics(
            preconditioner=str(preconditioner),
            is_strong=preconditioner.is_strong,
            wave_crossings=self._factors.crossings,
            num_iterations=self.num_iterations,
            num_local_iterations=self._krylov.num_local_iterations,
            num_builds=preconditioner.num_builds,
            num_schwarz_builds=self._contacts.num_builds,
            num_direct=self.num_direct,
            num_residuals=num_residuals,
            num_actions=num_actions,
            num_tangents=self.tangent.num_assembled,
            num_cells=bulk.num_cells,
        )

    def serialize(self, archive: Archive) -> None:
        """Serialize what a later step goes on with. Collective."""
        self._preconditioner.serialize(archive)
        self._active_sets.serialize(archive)
        self._contacts.serialize(archive, self._active_sets.version)
        self._operator.serialize(archive)
        self._factors.serialize(archive)
        self._failures.serialize(archive)

    def _solve_krylov(
        self, R: Floats, elimination: Elimination, rtol: float, *, is_local: bool = False
    ) -> Floats | None:
        """Solution, None where the method fails. One of few nodes tells nothing of the factors."""
        bulk = self._operator.bulk
        rtol = min(rtol, self._contacts.least_reduction)
        self._operator.elimination = elimination
        particular: Floats | float = 0.0
        if elimination.empty:
            r: Floats = -self._nodal(R)
        else:
            self._contacts.update(elimination)
            total: Floats = self._nodal(R).copy()
            particular, parts = elimination.particular(total.shape)
            # Near the constraints this part is smaller than what rtol leaves.
            force = _ROW_SUM * self.tangent.nodal_stiffness()[:, None] * particular
            squares = [float(np.vdot(force, force)), float(R @ R)]
            part, whole = map(math.sqrt, reductions.total(bulk.comm, squares))
            negligible = _NEGLIGIBLE * rtol * whole
            if part > negligible:
                total += self._operator.action(particular, negligible / part)
            r = -bulk.rigid.project(None, elimination.act(parts, total))
        if not is_local and rtol >= self.one_application_reduction:
            one: Floats = (particular + self._krylov.precondition_once(r)).ravel()
            return one
        x, iterations = self._krylov.solve(r, rtol, is_local=is_local)
        decades = -math.log10(rtol)
        if not (is_local or elimination.empty):
            self._contacts.judge(iterations, decades)
        if x is None:
            return None
        if not is_local:
            self._factors.count(iterations, decades, in_contact=not elimination.empty)
        elimination.constrain(x)
        du: Floats = (particular + x).ravel()
        return du

    def nodal_resistance(self) -> Floats:
        """What resists at each owned node, shape ``(n,)`` [N/m]. Collective.

        The matrix knows nothing of rigid bodies, whose nodes have the mean stiffness of others:
        there it is that or inertia, whichever is more.
        """
        stiffness, rigid = self.tangent.nodal_stiffness(), self._operator.bulk.rigid
        if not rigid.exists:
            return stiffness
        resistance, inertia = stiffness.copy(), self._nodal(self._inertia())[rigid.nodes, 0]
        resistance[rigid.nodes] = np.maximum(resistance[rigid.nodes], inertia)
        return resistance

    def _nodal(self, values: Floats) -> Floats:
        """Values of dofs by nodes, shape ``(n, d)``. Local."""
        return values.reshape(-1, self._operator.bulk.rigid.dim)

    def _solve_direct(
        self, R: Floats, steps: Sequence[ContactStep], pairs: Sequence[ActivePairs]
    ) -> tuple[Floats, list[Floats]]:
        self.num_direct += 1
        du, parts = self._saddle.solve(R, pairs)
        # Contact pairs without active nodes on any rank have no item.
        increments = iter(parts)
        none: Floats = np.empty(0)
        return du, [next(increments) if step.num_active else none for step in steps]
