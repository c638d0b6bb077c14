"""Complete factors by MUMPS, with enough memory for delayed pivots."""

from typing import Any

from petsc4py import PETSc

__all__ = ["factorised", "signs"]

# Memory in excess of the estimate by MUMPS [%], tried one after the other. The estimate is based on
# the sparsity pattern; delayed pivots, as in the rows of multipliers, cause more fill-in.
_ROOM = (50, 200, 800, 3200)
# MUMPS parameters ICNTL: memory relaxation, root block on one rank (needed for the inertia), null
# pivot detection. INFOG: error code, numbers of negative and of null pivots.
_ROOM_PARAMETER, _LAST_BLOCK, _FINDS_NOTHING = 14, 13, 24
_OUTCOME, _NEGATIVE, _NUM_NOTHING = 1, 12, 28
# Error codes for which more memory helps: for integers, values and buffers.
_TOO_LITTLE = {-8, -9, -14, -15, -17, -18, -20}


def factorised(A: Any, *, is_symmetric: bool = False, finds_null: bool = False) -> Any:
    """Factorise a matrix. Collective.

    Args:
        A: The matrix.
        is_symmetric: Whether it is symmetric; `signs` are available then.
        finds_null: Whether null pivots are detected and skipped.

    Returns:
        PETSc preconditioner that solves with the factors. Its result is not finite if the
        factorisation failed.
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
    """Numbers of negative and of null pivots of a symmetric matrix. Local.

    The number of null pivots is 0 unless ``finds_null``. None if the factorisation failed.
    """
    factors = pc.getFactorMatrix()
    if factors.getMumpsInfog(_OUTCOME) < 0:
        return None
    return int(factors.getMumpsInfog(_NEGATIVE)), int(factors.getMumpsInfog(_NUM_NOTHING))
