"""Complete factors by MUMPS, with as much room as their pivots turn out to need."""

from typing import Any

from petsc4py import PETSc

__all__ = ["factorised", "signs"]

# Memory beyond what MUMPS estimates from the places of the entries alone [%], one after another.
# Pivots that are nearly nothing, as on the rows of multipliers, are delayed, and fill more.
_ROOM = (50, 200, 800, 3200)
# Numbers of MUMPS's parameters for it, for a last block on one rank, whose signs it knows, and for
# pivots that are nothing, and of those which tell how it went and how many pivots are negative and
# nothing.
_ROOM_PARAMETER, _LAST_BLOCK, _FINDS_NOTHING = 14, 13, 24
_OUTCOME, _NEGATIVE, _NUM_NOTHING = 1, 12, 28
# Outcomes [-] with which more room helps: of integers, of values, and of buffers.
_TOO_LITTLE = {-8, -9, -14, -15, -17, -18, -20}


def factorised(A: Any, *, is_symmetric: bool = False, finds_null: bool = False) -> Any:
    """Factorise a matrix. Collective.

    Args:
        A: The matrix.
        is_symmetric: Whether it is known to be symmetric; signs of pivots are known then.
        finds_null: Whether pivots that are nothing are found, and left out.

    Returns:
        Preconditioner of PETSc that solves with the factors. What it gives is not finite where
        there are none.
    """
    for room in _ROOM:
        pc = PETSc.PC().create(A.comm)
        pc.setOperators(A)
        pc.setType("cholesky" if is_symmetric else "lu")
        pc.setFactorSolverType("mumps")
        pc.setFactorSetUpSolverType()
        factors = pc.getFactorMatrix()
        factors.setMumpsIcntl(_ROOM_PARAMETER, room)
        if is_symmetric:
            factors.setMumpsIcntl(_LAST_BLOCK, 1)
        if finds_null:
            factors.setMumpsIcntl(_FINDS_NOTHING, 1)
        pc.setUp()
        if factors.getMumpsInfog(_OUTCOME) not in _TOO_LITTLE or room == _ROOM[-1]:
            break
        pc.destroy()
    return pc


def signs(pc: Any) -> tuple[int, int] | None:
    """Numbers of negative pivots of a symmetric matrix and of those that are nothing. Local.

    The latter are 0 unless they were to be found. None if there are no factors.
    """
    factors = pc.getFactorMatrix()
    if factors.getMumpsInfog(_OUTCOME) < 0:
        return None
    return int(factors.getMumpsInfog(_NEGATIVE)), int(factors.getMumpsInfog(_NUM_NOTHING))
