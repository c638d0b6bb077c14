"""Nonlinear elimination of the nodes around contacts.

At an impact, contact nodes move by a large fraction of a cell within a step, while all other nodes
move almost as before. Most of the nonlinearity is then at few nodes, but each Newton iteration
would assemble all cells. Here Newton's method first iterates on the nodes around contacts alone,
with all other nodes clamped: the nonlinear elimination of P. J. Lanzkron, D. J. Rose, J. T. Wilkes,
SIAM J. Sci. Comput. 17 (1996).
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from dolfinx import la

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, indices
from dolfinx_nts.contact.implicit.contact_step import ContactStep, contact_residual
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.fem.surroundings import add_surroundings
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.cell_sizes import CellSizes
from dolfinx_nts.solvers.convergence import Iterate
from dolfinx_nts.solvers.linear.krylov import LinearSolver

__all__ = ["NonlinearElimination"]

# Number of layers of cells around the contacts in the subdomain.
_LAYERS = 2
# Number of local Newton iterations [-], and their requested linear reduction [-]. More would not
# help, as the residual at the border of the subdomain remains until all nodes move.
_STEPS, _REDUCTION = 2, 0.1
# Constraint violation, relative to the size of the cells at the node [-], above which the
# elimination saves time; and largest fraction of nodes in the subdomain [-] for which it is cheap.
_FAR, _MOST_NODES = 0.015, 0.125
# Trust radius relative to the smallest cell [-].
_LONGEST = 0.5


class NonlinearElimination:
    """Newton's method on the nodes around contacts. Collective, as all its methods.

    Args:
        bulk: Residual of the bodies.
        solver: Solver of the linear systems.
        sizes: Sizes of the cells.
    """

    def __init__(self, bulk: Bulk, solver: LinearSolver, sizes: CellSizes) -> None:
        self._bulk, self._solver, self._sizes = bulk, solver, sizes
        self._marker = la.vector(bulk.u.function_space.dofmap.index_map)

    def eliminate(self, steps: Sequence[ContactStep], start: Iterate, X: Floats) -> int:
        """Solve for the nodes around contacts, if constraint violations are large.

        Args:
            steps: Contact attempts.
            start: The first iterate.
            X: Reference positions of the owned nodes, shape ``(n, 3)`` [m].

        Returns:
            Number of contact evaluations; 0 if the displacement is unchanged.
        """
        bulk = self._bulk
        if not reductions.anywhere(
            bulk.comm, any(map(self._are_violations_large, steps, start.states))
        ):
            return 0
        nodes = self._nodes(steps, start)
        counts = reductions.total(bulk.comm, [np.count_nonzero(nodes[: len(X)]), len(X)])
        if counts[0] > _MOST_NODES * counts[1]:
            return 0
        with _others_clamped(bulk, nodes):
            return self._move(nodes, steps, start, X)

    def _are_violations_large(self, step: ContactStep, state: ContactContribution) -> bool:
        """Whether constraint violations on this rank are large. Local."""
        node = step.state.nodes.nodes[state.pairs.node]
        return bool(np.any(state.violations > _FAR * self._sizes.nodal[node]))

    def _nodes(self, steps: Sequence[ContactStep], start: Iterate) -> Flags:
        """Flags of the local nodes around contacts, shape ``(l,)``."""
        marks: Floats = self._marker.array
        reached = np.zeros((self._bulk.num_owned // self._bulk.rigid.dim, 3))
        for step, state in zip(steps, start.states, strict=True):
            dofs = state.pairs.dofs
            step.candidates.scatter.add(reached, dofs, np.ones((*dofs.shape, 3)))
        marks.fill(0)
        marks[: len(reached)] = reached[:, 0]
        add_surroundings(self._marker, self._bulk.u.function_space, _LAYERS)
        flags: Flags = marks > 0
        return flags

    def _are_long(self, du: Floats) -> bool:
        """Whether an increment is longer than the trust radius, or not finite."""
        longest = reductions.largest(self._bulk.comm, _kernels.largest_size(du))
        return not longest <= _LONGEST * self._sizes.smallest

    def _move(self, nodes: Flags, steps: Sequence[ContactStep], start: Iterate, X: Floats) -> int:
        """Iterate with all nodes outside clamped; return the number of contact evaluations."""
        bulk, dim = self._bulk, self._bulk.rigid.dim
        u = bulk.u.x.array[: bulk.num_owned].reshape(-1, dim)
        R, states = start.R.copy(), start.states
        for number in range(1, _STEPS + 1):
            R[bulk.is_prescribed] = 0
            du = self._solver.solve_for(nodes[: len(u)], R, steps, states, _REDUCTION)
            if du is None or self._are_long(du):
                return number - 1
            u += du.reshape(u.shape)
            for step, state in zip(steps, states, strict=True):
                step.close_gaps(state, X + in_space(u), u)
            bulk.u.x.scatter_forward()
            if number == _STEPS:
                break
            R = bulk.forces()
            R[bulk.is_prescribed] = 0
            x, forces = X + in_space(u), R.reshape(-1, dim)
            states = tuple(step.evaluate(x, forces, number) for step in steps)
            R += contact_residual(steps, states, u.shape)
        return _STEPS


@contextmanager
def _others_clamped(bulk: Bulk, nodes: Flags) -> Iterator[None]:
    """Context in which all local nodes except the flagged ones, ``(l,)``, are clamped. Local."""
    dofmap, topology = bulk.u.function_space.dofmap, bulk.u.function_space.mesh.topology
    num_cells = topology.index_map(topology.dim).size_local
    moves = nodes[dofmap.list[:num_cells]].any(axis=1), nodes[: dofmap.index_map.size_local]
    before = bulk.leave_out(*(indices(~some) for some in moves))
    try:
        yield
    finally:
        bulk.leave_out(*before)
