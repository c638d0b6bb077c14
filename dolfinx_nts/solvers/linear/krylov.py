"""Linear systems of Newton's method, solved by a preconditioned Krylov method.

The operator is the exact tangent of bodies and contacts, projected on the constraints by
`elimination` and applied without a matrix. The preconditioner consists of factors of the matrix of
the bodies, which are kept for many steps, and of a contact correction. If the Krylov method fails,
the complete system is factorised.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.linear.active_sets import ActiveSets
from dolfinx_nts.solvers.linear.cone_problem import (
    CondensedSystem,
    has_cone_problem,
    solve_cone_problem,
)
from dolfinx_nts.solvers.linear.elimination import ActivePairs, Elimination, active_pairs
from dolfinx_nts.solvers.linear.petsc_options import PetscOptions
from dolfinx_nts.solvers.linear.projected_krylov import (
    KrylovMethod,
    Operator,
    Preconditioner,
    RigidPreconditioner,
)
from dolfinx_nts.solvers.linear.saddle_point import SaddlePointSystem
from dolfinx_nts.solvers.linear.statistics import SolverStatistics
from dolfinx_nts.solvers.precond.contact_corrections import ContactCorrections
from dolfinx_nts.solvers.precond.factor_age import FactorAge
from dolfinx_nts.solvers.precond.preconditioner import BulkPreconditioner
from dolfinx_nts.solvers.precond.tangent import Tangent
from dolfinx_nts.solvers.statics.inertia_relief import InertiaRelief

__all__ = ["KrylovFailures", "LinearSolver"]

# Admissible error of a right-hand side, relative to the requested reduction [-].
_NEGLIGIBLE = 0.03
# Estimate of the row sums of the tangent, relative to the diagonal [-].
_ROW_SUM = 3.0
# Number of random forces in the search for a direction of negative curvature.
_NUM_FORCES = 4

# Largest number of doublings of the skipped systems.
_MOST_DOUBLINGS = 5


class KrylovFailures:
    """Counts of consecutive failures with new strong factors, and of systems still to be skipped.

    Solutions that take longer than factors of the complete system count as failures.
    """

    def __init__(self) -> None:
        self._in_a_row = self._left = 0

    def count(self) -> None:
        """Record a failure: skip twice as many systems as after the last one. Local."""
        self._in_a_row = min(self._in_a_row + 1, _MOST_DOUBLINGS)
        self._left = 2**self._in_a_row

    def forget(self) -> None:
        """Record a success. Local."""
        self._in_a_row = self._left = 0

    def skip(self) -> bool:
        """Whether to skip Krylov iterations for the next system, which this call counts. Local."""
        is_left_out = self._left > 0
        self._left -= is_left_out
        return is_left_out

    def serialize(self, archive: Archive) -> None:
        """Serialize the numbers of failures and of systems to skip. Collective."""
        numbers = archive.same("hopeless_systems", np.array([self._in_a_row, self._left]))
        if archive.restores:
            self._in_a_row, self._left = map(int, numbers)


class LinearSolver:
    """Solver of the linear systems of Newton's method.

    Args:
        bulk: Residual of the bodies.
        tangent: Matrix of its derivative.
        inertia: Returns the lumped inertia in the tangent at the owned dofs, shape ``(d n,)``
            [N/m]; 0 in statics.
        options: PETSc options without prefix: ``ksp_...`` for the Krylov method, all others for the
            preconditioner of the bulk.

    Attributes:
        tangent: The matrix.
        num_direct: Number of complete systems factorised so far.

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
        """Requested reduction at which one application of the preconditioner suffices [-]. Local.

        It is the measured reduction of one iteration. NaN if unknown, with rigid bodies, and at
        large Courant numbers, where the error of ILU(0) would change contact everywhere.
        """
        has_rigid = self._operator.bulk.rigid.exists
        return math.nan if has_rigid else self._factors.one_application_reduction

    @property
    def num_iterations(self) -> int:
        """Number of Krylov iterations so far, without iterations in `solve_for`."""
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
            du on the owned dofs [m]; and the increments of the multipliers of each state,
            constraint by constraint [N], or None if the balance of nodal forces is the better
            estimate.

        Raises:
            ValueError: There are unused PETSc options.
        """
        pairs = active_pairs(steps, states, self._operator.bulk.rigid.dim)
        elimination = Elimination(pairs, self._active_sets.number(pairs))
        if pairs and self._active_sets.are_coupled(pairs):
            return self._solve_direct(R, steps, pairs)
        if self._operator.bulk.rigid.has_no_inertia or self._failures.skip():
            return self._solve_direct(R, steps, pairs)
        factors = self._factors
        is_new = factors.renew()
        num_active, before = sum(step.num_active for step in steps), self.num_iterations
        self._contacts.choose(num_active)
        while (du := self._solve_krylov(R, elimination, rtol)) is None:
            if self._contacts.choose(num_active):
                continue
            # After a failure new factors are tried, then stronger ones, then the complete system.
            if is_new and not self._preconditioner.strengthen():
                self._failures.count()
                return self._solve_direct(R, steps, pairs)
            factors.build()
            is_new, before = True, self.num_iterations
        if is_new and factors.are_slower_than_complete(self.num_iterations - before):
            self._failures.count()
        else:
            self._failures.forget()
        factors.strengthen_if_slow(is_new)
        if not (num_active and self._contacts.uses_complement):
            return du, None
        # With nearly incompressible materials the nodal balance is no estimate of multipliers
        # before convergence: unbalanced pressures exceed contact forces by far.
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
        """Increments of some nodes with incomplete factors, all other nodes clamped. Collective.

        Args:
            nodes: Flags of the owned nodes that are not clamped, shape ``(n,)``.
            R: Residual on the owned dofs, 0 at clamped ones [N].
            steps: Contact attempts.
            states: Their pairs.
            rtol: Reduction of the projected residual.

        Returns:
            du on the owned dofs [m]. None without incomplete factors, and if multipliers cannot be
            eliminated.
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
        """Contact states that satisfy all conditions in the linear system. Collective.

        Args:
            R: Residual on the owned dofs, shape ``(d n,)`` [N].
            steps: Contact attempts.
            states: Their pairs.
            inertia: Whether there is inertia.
            relief: Inertia relief of free bodies.

        Returns:
            The pairs with these states, None if there is no solution, see `cone_problem`.
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
        """Direction of negative curvature of the energy at the current equilibrium. Collective.

        Friction forces are kept constant. The existing factors are used, or factors of the complete
        system if such systems are factorised.

        Args:
            steps: Contact attempts.
            states: Their pairs, in equilibrium.
            seed: Seed of the random forces.

        Returns:
            The direction at the owned nodes, shape ``(n, d)``; None if there is none, or if no
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
            forces[:, bulk.is_prescribed] = 0
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
        """Linear system that can be condensed to contact points, or None. Collective.

        With inertia it is the complete system, if it is small and multipliers cannot be eliminated.
        In statics, where points interact over long distances and bodies may have no other support,
        it is the system of the deformable bodies.
        """
        bulk = self._operator.bulk
        if not inertia:
            condense = partial(self._contacts.condensed, relief=relief, immobile=self._rigid_nodes)
            return None if bulk.rigid.has_unknowns else condense
        if not self._saddle.may_be_small:
            return None
        pairs = active_pairs(steps, states, bulk.rigid.dim)
        self._active_sets.number(pairs)
        is_whole = pairs and self._active_sets.are_coupled(pairs)
        return self._saddle.condensed if is_whole else None

    @cached_property
    def _rigid_nodes(self) -> GlobalInts:
        """Global numbers of the nodes of rigid bodies of all ranks. Collective at the first use."""
        rows, rigid = self.tangent.rows, self._operator.bulk.rigid
        if not rigid.exists:
            return np.empty(0, dtype=np.int64)
        numbers = rows.index_map.local_to_global(rigid.nodes.astype(np.int32))
        return joined(self.tangent.comm, numbers)

    @property
    def statistics(self) -> SolverStatistics:
        """Iterations, factorisations and settings of the solver so far. Local."""
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
        """Serialize the state that later steps depend on. Collective."""
        self._preconditioner.serialize(archive)
        self._active_sets.serialize(archive)
        self._contacts.serialize(archive, self._active_sets.version)
        self._operator.serialize(archive)
        self._factors.serialize(archive)
        self._failures.serialize(archive)

    def _solve_krylov(
        self, R: Floats, elimination: Elimination, rtol: float, *, is_local: bool = False
    ) -> Floats | None:
        """Solution, or None if the method fails.

        Local solves do not count for the age of the factors.
        """
        bulk = self._operator.bulk
        rtol = min(rtol, self._contacts.least_reduction)
        self._operator.elimination = elimination
        particular: Floats | float = 0.0
        if elimination.empty:
            r: Floats = -self._nodal(R)
        else:
            self._contacts.update(elimination)
            total: Floats = self._nodal(R).copy()
            particular, ghosted = elimination.particular(total.shape)
            # Near convergence the contribution of the particular solution is below the tolerance.
            force = _ROW_SUM * self.tangent.nodal_stiffness()[:, None] * particular
            squares = [float(np.vdot(force, force)), float(R @ R)]
            part, whole = map(math.sqrt, reductions.total(bulk.comm, squares))
            negligible = _NEGLIGIBLE * rtol * whole
            if part > negligible:
                total += self._operator.action(particular, negligible / part)
            r = -bulk.rigid.project(None, elimination.act(ghosted, total))
        if not is_local and rtol >= self.one_application_reduction:
            one: Floats = (particular + self._krylov.precondition_once(r)).ravel()
            return one
        most = self._factors.most_iterations
        x, iterations = self._krylov.solve(r, rtol, most=most, is_local=is_local)
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
        """Stiffness or inertia, if larger, of each owned node, shape ``(n,)`` [N/m]. Collective.

        The matrix does not contain rigid bodies. Nodes of rigid bodies have the mean stiffness of
        other nodes, or their inertia if it is larger.
        """
        stiffness, rigid = self.tangent.nodal_stiffness(), self._operator.bulk.rigid
        if not rigid.exists:
            return stiffness
        resistance, inertia = stiffness.copy(), self._nodal(self._inertia())[rigid.nodes, 0]
        resistance[rigid.nodes] = np.maximum(resistance[rigid.nodes], inertia)
        return resistance

    def _nodal(self, values: Floats) -> Floats:
        """Values of dofs, node by node, a view of shape ``(n, d)``. Local."""
        return values.reshape(-1, self._operator.bulk.rigid.dim)

    def _solve_direct(
        self, R: Floats, steps: Sequence[ContactStep], pairs: Sequence[ActivePairs]
    ) -> tuple[Floats, list[Floats]]:
        self.num_direct += 1
        du, parts = self._saddle.solve(R, pairs)
        # Contact pairs without active nodes on any rank have no item in the list.
        increments = iter(parts)
        none: Floats = np.empty(0)
        return du, [next(increments) if step.num_active else none for step in steps]
