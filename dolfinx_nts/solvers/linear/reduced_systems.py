"""Complete linear systems: factors by MUMPS and reduction to six unknowns per rigid body."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats
from dolfinx_nts.solvers.linear.block_csr import starts
from dolfinx_nts.solvers.precond import mumps
from dolfinx_nts.solvers.rigid.rigid_motion import RigidColumns

__all__ = ["Reduced", "WholeFactors", "reduced", "solved"]


class WholeFactors:
    """Complete factors of a matrix by MUMPS. Collective, as all its methods.

    Args:
        A: The matrix.
        is_symmetric: Whether it is symmetric; `num_negative` is available then.
    """

    def __init__(self, A: Any, *, is_symmetric: bool = False) -> None:
        self._x, self._b = A.createVecs()
        self._pc = mumps.factorised(A, is_symmetric=is_symmetric)

    @property
    def num_negative(self) -> int | None:
        """Number of negative eigenvalues of a symmetric matrix, None without factors."""
        signs = mumps.signs(self._pc)
        return None if signs is None else signs[0]

    def solve(self, right: Floats) -> Floats:
        """Owned part of the solution for the owned part of a right-hand side, both ``(n,)``.

        It is not finite if there are no factors.
        """
        self._b.array[:] = right
        self._pc.apply(self._b, self._x)
        solution: Floats = np.array(self._x.array)
        return solution

    def destroy(self) -> None:
        """Free the memory."""
        for item in (self._pc, self._b, self._x):
            item.destroy()


def solved(A: Any, right: Floats) -> Floats:
    """Factorise a matrix and solve one system. Collective.

    Args:
        A: The matrix.
        right: Owned part of the right-hand side, shape ``(n,)``.

    Returns:
        Owned part of the solution, shape ``(n,)``; not finite if there are no factors.
    """
    factors = WholeFactors(A)
    solution = factors.solve(right)
    factors.destroy()
    return solution


class Reduced(NamedTuple):
    """System whose unknowns are rigid motions, displacements of all other nodes, and multipliers.

    Attributes:
        matrix: The matrix.
        rows: Transpose of the matrix that maps right-hand sides of the complete system to this one.
        columns: Matrix that maps solutions of this system to solutions of the complete one.
    """

    matrix: Any
    rows: Any
    columns: Any


def reduced(
    A: Any, bodies: Sequence[RigidColumns], clamping: Floats, resistance: Floats
) -> Reduced:
    """Reduce a system with nodal unknowns of rigid bodies. Collective.

    Args:
        A: Matrix of the complete system.
        bodies: Motions of the rigid bodies; their amplitudes are unknowns of rank 0.
        clamping: Clamping stiffness of the owned dofs in the matrix, which is removed, ``(d n,)``
            [N/m].
        resistance: Additional stiffness in the motions of rigid bodies.
    """
    comm = A.comm.tompi4py()
    first, last = A.getOwnershipRange()
    is_kept = np.ones(last - first, dtype=bool)
    is_kept[np.concatenate([body.dofs for body in bodies])] = False
    ends = np.cumsum([0, *(len(body.turning) for body in bodies)])
    num_first = int(ends[-1]) if comm.rank == 0 else 0
    counts = comm.allgather(num_first + int(np.count_nonzero(is_kept)))
    kept = sum(counts[: comm.rank]) + num_first + np.arange(counts[comm.rank] - num_first)
    length = is_kept.astype(np.int64)
    for body in bodies:
        length[body.dofs] = len(body.turning)
    start = starts(length)

    def mapping(motions: Sequence[Floats]) -> Any:
        """Matrix from amplitudes of motions, and all other unknowns, to the complete unknowns."""
        column, value = np.zeros(start[-1], dtype=np.int64), np.ones(start[-1])
        column[start[:-1][is_kept]] = kept
        for body, motion, begin in zip(bodies, motions, ends, strict=False):
            number = np.arange(motion.shape[1])
            entries = start[body.dofs, None] + number
            column[entries], value[entries] = begin + number, motion
        size = (last - first, None), (counts[comm.rank], None)
        return PETSc.Mat().createAIJ(size, csr=(_ints(start), _ints(column), value), comm=comm)

    rows = mapping([body.mean for body in bodies])
    columns = mapping([body.end for body in bodies])
    matrix = rows.transposeMatMult(A.matMult(columns))
    matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    for body, begin in zip(bodies, ends, strict=False):
        stiffness = -body.mean.T @ (clamping[body.dofs, None] * body.end)
        if comm.rank == 0:
            stiffness += body.turning
        of_motions = _ints(begin + np.arange(len(stiffness)))
        matrix.setValues(of_motions, of_motions, stiffness, addv=True)
    if comm.rank == 0:
        every = _ints(np.arange(len(resistance)))
        matrix.setValues(every, every, resistance, addv=True)
    matrix.assemble()
    return Reduced(matrix, rows, columns)


def _ints(numbers: Array) -> Array:
    return np.asarray(numbers, dtype=PETSc.IntType)
