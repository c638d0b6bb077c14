r"""Complete linear system of a Newton iteration, factorised if Krylov methods fail.

The unknowns are the increments of all displacements and of the multipliers of all active pairs. On
each rank the multipliers come after the displacements:

    [ K + sum lambda_N dF/dq   F ] [ du       ]     [ R              ]
    [ G^T                      0 ] [ dlambda_N ] = - [ g_N - g_ref    ]

with the contact force F of the step and the gap gradient G at its end, so that
the matrix is not symmetric.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_nts.common.arrays import Array, Flags, Floats, Ints
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.linear.contact_blocks import ContactBlocks, rows_of, tangents_of
from dolfinx_nts.solvers.linear.elimination import ActivePairs
from dolfinx_nts.solvers.linear.reduced_systems import Reduced, WholeFactors, reduced, solved
from dolfinx_nts.solvers.precond.tangent import Tangent
from dolfinx_nts.solvers.rigid.rigid_motion import RigidColumns
from dolfinx_nts.solvers.statics.negative_curvature import lowest_ritz_vector

__all__ = ["SaddlePointSystem"]


# Compliance of the constraints, relative to the inverse of the largest entry of the matrix [-]. It
# makes the system regular if prescribed displacements make constraints dependent.
_COMPLIANCE = 1e-10
# Number of unknowns up to which dense factors are faster than MUMPS.
_DENSE = 200
# Norm of the gradient of a combination of constraints, relative to the largest one [-], below which
# constraints are linearly dependent, such as at many points of a rigid body.
_DEPENDENT = 1e-9
_NO_STIFFNESS = 1e-300  # stiffness of a rank without nodes, to avoid division by zero [N/m]


class _WholeSystem(NamedTuple):
    """Dense complete system of ``n`` unknowns.

    Attributes:
        matrix: The matrix, shape ``(n, n)``.
        right: Right-hand side, shape ``(n,)``.
        is_multiplier: Flags of the multipliers, shape ``(n,)``.
    """

    matrix: Floats
    right: Floats
    is_multiplier: Flags

    def solution(self) -> Floats:
        """Solve with dense factors; NaN if the matrix is singular. Local."""
        A, right, last = self.matrix, self.right, self.is_multiplier
        x = np.full(len(right), np.nan)
        gradients = A[last][:, ~last]
        try:
            independent, size, _ = np.linalg.svd(gradients, full_matrices=False)
            independent = independent[:, size > _DEPENDENT * size.max(initial=0.0)]
            k = independent.shape[1]
            forces = A[~last][:, last] @ independent
            compliance = independent.T @ A[last][:, last] @ independent
            system = np.block(
                [[A[~last][:, ~last], forces], [independent.T @ gradients, compliance]]
            )
            y = np.linalg.solve(system, np.concatenate([right[~last], independent.T @ right[last]]))
        except np.linalg.LinAlgError:
            return x
        x[~last], x[last] = y[: len(y) - k], independent @ y[len(y) - k :]
        return x

    def condensed(self, is_point: Flags, present: Floats) -> tuple[Floats, Floats] | None:
        mine = np.zeros(len(self.right), dtype=bool)
        mine[self.is_multiplier] = is_point
        A, right = self.matrix, self.right
        columns = A[~mine][:, mine]
        known = np.column_stack([right[~mine] + columns @ present, columns])
        try:
            motions = A[mine][:, ~mine] @ np.linalg.solve(A[~mine][:, ~mine], known)
        except np.linalg.LinAlgError:
            return None
        return motions[:, 1:], motions[:, 0] - right[mine]


class SaddlePointSystem:
    """Solver of the complete system by direct factorisation: dense, or MUMPS if it is large.

    Args:
        tangent: Matrix of the bodies.
        bulk: Residual of the bodies, with the motion of the rigid bodies.

    Attributes:
        comm: Communicator of the mesh.
    """

    def __init__(self, tangent: Tangent, bulk: Bulk) -> None:
        self._tangent, self._bulk = tangent, bulk
        self.comm: MPI.Comm = tangent.comm

    def solve(self, R: Floats, pairs: Sequence[ActivePairs]) -> tuple[Floats, list[Floats]]:
        """Newton increments of displacements and multipliers. Collective.

        If constraints are linearly dependent, multiplier increments without any force on the bodies
        are removed.

        Args:
            R: Residual on the owned dofs [N].
            pairs: Active pairs.

        Returns:
            du on the owned dofs [m], and the increments of the multipliers of each item of pairs,
            constraint by constraint [N].
        """
        A, right, counts = self._assembled(R, pairs)
        with_bodies = self._bulk.rigid.exists
        solve = self._with_rigid_bodies if with_bodies else _solution
        solution = solve(A, right, sum(counts))
        A.destroy()
        du, dlambda = np.split(solution, [len(solution) - sum(counts)])
        return du, np.split(dlambda, np.cumsum(counts)[:-1]) if counts else []

    @cached_property
    def may_be_small(self) -> bool:
        """Whether the deformable bodies have few enough unknowns for dense factors. Local.

        Collective at the first use.
        """
        rigid = self._bulk.rigid
        deformable = self._bulk.num_owned - rigid.dim * len(rigid.nodes)
        return bool(reductions.total(self.comm, deformable) <= _DENSE)

    def condensed(
        self, R: Floats, pairs: Sequence[ActivePairs], is_point: Flags, present: Floats
    ) -> tuple[Floats, Floats] | None:
        """System that is condensed to the contact points, see `CondensedSystem`."""
        whole = self._whole(R, pairs)
        return None if whole is None else whole.condensed(is_point, present)

    def negative_curvature_direction(
        self, pairs: Sequence[ActivePairs], forces: Floats, stiffness: Floats
    ) -> Floats | None:
        """Direction of negative curvature of the energy at an equilibrium. Collective.

        Args:
            pairs: Active pairs, whose forces act along the gap gradients.
            forces: Random forces on the owned dofs, shape ``(k, d n)`` [N].
            stiffness: Stiffness of the owned dofs, shape ``(d n,)`` [N/m].

        Returns:
            Displacements of the owned dofs of arbitrary size, or None.
        """
        n = forces.shape[1]
        A, right, counts = self._assembled(np.zeros(n), pairs)
        known = A.createVecLeft()
        system = self._reduced(A, right)[0] if self._bulk.rigid.exists else None
        matrix = A if system is None else system.matrix
        other = matrix.transpose(PETSc.Mat())
        matrix.axpy(1.0, other)
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        factors = WholeFactors(matrix, is_symmetric=True)
        num_multipliers = reductions.total(self.comm, sum(counts))

        def solve(force: Floats) -> Floats:
            """Displacements caused by a force."""
            known.array[:] = 0.0
            known.array[:n] = force
            if system is None:
                return factors.solve(known.array)[:n]
            short = system.rows.createVecRight()
            system.rows.multTranspose(known, short)
            short.array[:] = factors.solve(short.array)
            system.columns.mult(short, known)
            short.destroy()
            return np.array(known.array[:n])

        motion = None
        if (factors.num_negative or 0) > num_multipliers:
            motion = lowest_ritz_vector(self.comm, forces, stiffness, solve)
        factors.destroy()
        for item in (known, other, A, *(system or ())):
            item.destroy()
        return motion

    def _whole(self, R: Floats, pairs: Sequence[ActivePairs]) -> _WholeSystem | None:
        """Dense system on every rank if it is small, otherwise None. Collective."""
        A, right, counts = self._assembled(R, pairs)
        if not self._bulk.rigid.exists:
            found = _gathered(A, right, sum(counts)) if A.size[0] <= _DENSE else None
            A.destroy()
            return found
        system, forces = self._reduced(A, right)
        A.destroy()
        found = None
        if system.matrix.size[0] <= _DENSE:
            found = _gathered(system.matrix, forces.array, sum(counts))
        for item in (*system, forces):
            item.destroy()
        return found

    def _assembled(
        self, R: Floats, pairs: Sequence[ActivePairs]
    ) -> tuple[Any, Floats, Sequence[int]]:
        """Matrix, owned right-hand side, and number of constraints of each pair. Collective."""
        self._tangent.assemble_exact()
        rows, comm = self._tangent.rows, self._tangent.comm
        first, last = (rows.dim * end for end in rows.index_map.local_range)
        counts = [int(p.blocks.rank.sum()) for p in pairs]
        num_local = np.array(comm.allgather((last - first, sum(counts))))
        u_start = np.concatenate([[0], np.cumsum(num_local[:, 0])])
        shift = np.concatenate([[0], np.cumsum(num_local[:, 1])])

        def saddle(dofs: Array) -> Ints:
            """Index in the complete system of each displacement dof."""
            rank = np.searchsorted(u_start, dofs, side="right") - 1
            return np.asarray(dofs + shift[rank], dtype=np.int32)

        n = last - first + sum(counts)
        A = PETSc.Mat().create(comm)
        A.setSizes(((n, None), (n, None)))
        A.setType("aij")
        A.setUp()
        start, columns, values = rows.scalars()
        # The compliance does not affect the converged multipliers. The largest entry includes the
        # inertia of rigid bodies, unlike nodal stiffnesses.
        stiffest = float(np.abs(values).max(initial=_NO_STIFFNESS))
        compliance = reductions.least(comm, _COMPLIANCE / stiffest)
        here = (np.arange(first, last) + shift[comm.rank]).astype(np.int32)
        A.setValuesIJV(start.astype(np.int32), saddle(columns), values, addv=True, rowmap=here)
        multipliers = (last + shift[comm.rank] + np.arange(sum(counts))).astype(np.int32)
        begin = np.arange(len(multipliers) + 1, dtype=np.int32)
        diagonal = np.full(len(multipliers), -compliance)
        A.setValuesIJV(begin, multipliers, diagonal, addv=True, rowmap=multipliers)
        right = np.concatenate([-R, *(-p.excess[_active_rows(p.blocks)] for p in pairs)])
        done = 0
        for p in pairs:
            blocks = p.global_blocks()
            d = blocks.normal.shape[1]
            for nodes, tangent in tangents_of(blocks):
                dofs = saddle((d * nodes[:, None] + np.arange(d)).ravel())
                A.setValues(dofs, dofs, tangent, addv=True)
            ranks = map(int, blocks.rank)
            for (nodes, gradients, forces), rank in zip(rows_of(blocks), ranks, strict=True):
                own = multipliers[done : done + rank]
                dofs = saddle((d * nodes[:, None] + np.arange(d)).ravel())
                A.setValues(dofs, own, np.ascontiguousarray(forces[:rank].T), addv=True)
                A.setValues(own, dofs, gradients[:rank], addv=True)
                done += rank
        A.assemble()
        return A, right, counts

    def _with_rigid_bodies(self, A: Any, right: Floats, num_multipliers: int) -> Floats:
        """Solution with rigid motions as the unknowns of rigid bodies. Collective."""
        system, forces = self._reduced(A, right)
        x, amplitudes = A.createVecRight(), system.columns.createVecRight()
        amplitudes.array[:] = _solution(system.matrix, forces.array, num_multipliers)
        system.columns.mult(amplitudes, x)
        solution: Floats = x.array.copy()
        for item in (*system, forces, x, amplitudes):
            item.destroy()
        return solution

    def _reduced(self, A: Any, right: Floats) -> tuple[Reduced, Any]:
        """System with rigid motions as the unknowns of rigid bodies. Collective."""
        rigid, tangent = self._bulk.rigid, self._tangent
        added = tangent.added(tangent.clamping, is_exact=True) * np.ones(rigid.dim)
        columns = rigid.columns()
        system = reduced(A, columns, added.ravel(), self._stabilisation(columns))
        b, forces = A.createVecLeft(), system.rows.createVecRight()
        b.array[:] = right
        system.rows.multTranspose(b, forces)
        b.destroy()
        return system, forces

    def _stabilisation(self, bodies: Sequence[RigidColumns]) -> Floats:
        """Stabilising stiffness of unsupported rigid bodies, in their motions. Collective."""
        k, n = sum(len(body.turning) for body in bodies), self._bulk.num_owned
        resistance = np.zeros((k, k))
        if self._bulk.stabilisation is None:
            return resistance
        column = 0
        for body in bodies:
            for motion in body.end.T:
                x = np.zeros(n)
                x[body.dofs] = motion
                forces = self._bulk.stabilisation(x.reshape(-1, self._bulk.rigid.dim)).ravel()
                parts = [other.mean.T @ forces[other.dofs] for other in bodies]
                resistance[:, column] = np.concatenate(parts)
                column += 1
        total: Floats = reductions.total(self._tangent.comm, resistance)
        return total


def _active_rows(blocks: ContactBlocks) -> Flags:
    """Flags of the active rows of the constraints, shape ``(m, d)``. Local."""
    flags: Flags = np.arange(blocks.normal.shape[1]) < blocks.rank[:, None]
    return flags


def _solution(A: Any, right: Floats, num_multipliers: int) -> Floats:
    """Solve with complete factors; NaN if there are none. Collective.

    The last unknowns of each rank are multipliers.
    """
    if A.size[0] <= _DENSE:
        first, last = A.getOwnershipRange()
        return _gathered(A, right, num_multipliers).solution()[first:last]
    return solved(A, right)


def _gathered(A: Any, right: Floats, num_multipliers: int) -> _WholeSystem:
    """Dense system on every rank; the last unknowns of each rank are multipliers. Collective."""
    dense = A.convert("dense", PETSc.Mat())
    is_multiplier = np.arange(len(right)) >= len(right) - num_multipliers
    part = np.array(dense.getDenseArray()), np.array(right), is_multiplier
    dense.destroy()
    parts = A.comm.tompi4py().allgather(part)
    return _WholeSystem(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
