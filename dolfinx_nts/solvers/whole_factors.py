"""Complete factors of a whole system, with as much room as its pivots turn out to need."""

from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx_nts.common.arrays import Floats

__all__ = ["solved"]

# Memory beyond what MUMPS estimates from the places of the entries alone [%], one after another.
# Pivots on the rows of multipliers, whose diagonal is nearly nothing, are delayed, and fill more.
_ROOM = (50, 200, 800, 3200)
# Number of MUMPS's parameter for it, and of that which tells how it went.
_ROOM_PARAMETER, _OUTCOME = 14, 1
# Outcomes [-] with which more room helps: of integers, of values, and of buffers.
_TOO_LITTLE = {-8, -9, -14, -15, -17, -18, -20}


def solved(A: Any, right: Floats) -> Floats:
    """Solve a system with factors that serve once, by MUMPS. Collective.

    Args:
        A: The matrix.
        right: Owned part of the right-hand side, shape ``(n,)``.

    Returns:
        Owned part of the solution, shape ``(n,)``; not finite where there are no factors.
    """
    x, b = A.createVecs()
    b.array[:] = right
    for room in _ROOM:
        ksp = PETSc.KSP().create(A.comm)
        ksp.setOperators(A)
        ksp.setType("preonly")
        pc = ksp.getPC()
        pc.setType("lu")
        pc.setFactorSolverType("mumps")
        pc.setFactorSetUpSolverType()
        pc.getFactorMatrix().setMumpsIcntl(_ROOM_PARAMETER, room)
        ksp.solve(b, x)
        outcome = pc.getFactorMatrix().getMumpsInfog(_OUTCOME)
        ksp.destroy()
        if outcome not in _TOO_LITTLE:
            break
    solution: Floats = np.array(x.array)
    for item in (b, x):
        item.destroy()
    return solution
