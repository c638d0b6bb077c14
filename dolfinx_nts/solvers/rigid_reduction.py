"""Whole linear systems with rigid bodies: six unknowns each in the place of their nodes'."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats
from dolfinx_nts.solvers.block_csr import starts
from dolfinx_nts.solvers.rigid_motion import RigidColumns

__all__ = ["Reduced", "reduced"]


class Reduced(NamedTuple):
    """A system whose unknowns are rigid motions, those of all other nodes, and multipliers.

    Attributes:
        matrix: The matrix.
        rows: Takes right-hand sides of the whole system to those of this one, transposed.
        columns: Takes solutions of this system to those of the whole one.
    """

    matrix: Any
    rows: Any
    columns: Any


def reduced(A: Any, bodies: Sequence[RigidColumns], held: Floats, resistance: Floats) -> Reduced:
    """Reduce a system in which nodes of rigid bodies have unknowns of their own. Collective.

    Args:
        A: Matrix of the whole system.
        bodies: Motions of the rigid bodies; their amounts are unknowns of the first rank.
        held: Stiffness of the owned dofs in the matrix that the system does not have, ``(d n,)``
            [N/m].
        resistance: What the system has in the motions of rigid bodies beside the matrix.
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
        """Matrix that takes amounts of motions and the other unknowns to the whole ones."""
        column, value = np.zeros(start[-1], dtype=np.int64), np.ones(start[-1])
        column[start[:-1][is_kept]] = kept
        for body, motion, begin in zip(bodies, motions, ends, strict=False):
            amounts = np.arange(motion.shape[1])
            entries = start[body.dofs, None] + amounts
            column[entries], value[entries] = begin + amounts, motion
        size = (last - first, None), (counts[comm.rank], None)
        return PETSc.Mat().createAIJ(size, csr=(_ints(start), _ints(column), value), comm=comm)

    rows = mapping([body.mean for body in bodies])
    columns = mapping([body.end for body in bodies])
    matrix = rows.transposeMatMult(A.matMult(columns))
    matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    for body, begin in zip(bodies, ends, strict=False):
        stiffness = -body.mean.T @ (held[body.dofs, None] * body.end)
        if comm.rank == 0:
            stiffness += body.turning
        amounts = _ints(begin + np.arange(len(stiffness)))
        matrix.setValues(amounts, amounts, stiffness, addv=True)
    if comm.rank == 0:
        every = _ints(np.arange(len(resistance)))
        matrix.setValues(every, every, resistance, addv=True)
    matrix.assemble()
    return Reduced(matrix, rows, columns)


def _ints(numbers: Array) -> Array:
    return np.asarray(numbers, dtype=PETSc.IntType)
