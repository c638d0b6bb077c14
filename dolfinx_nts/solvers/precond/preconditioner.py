"""Preconditioner of the bulk: factors of the tangent that are kept for many steps."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Array, Flags, Floats
from dolfinx_nts.solvers.linear.block_csr import BlockCSR
from dolfinx_nts.solvers.linear.petsc_options import PetscOptions
from dolfinx_nts.solvers.linear.shells import use_shell
from dolfinx_nts.solvers.precond import mumps
from dolfinx_nts.solvers.precond.block_ilu import BlockILU, SinglePrecisionOperator
from dolfinx_nts.solvers.precond.tangent import Tangent

__all__ = ["BulkPreconditioner", "CompleteFactors"]

_logger = logging.getLogger("dolfinx_nts")

# Kinds of factors, from weak to strong: ILU(0) and ILU(1) in single precision, complete LU factors
# in single and in double precision, LDL factors of the derivative itself, and multigrid.
_ILU0, _ILU1, _LU_SINGLE, _LU, _LDL_DERIVATIVE, _MULTIGRID = range(6)
# Number of unknowns up to which a complete factorisation is cheaper than multigrid.
_DIRECT_UP_TO = 50_000
# Options of multigrid: one sweep of ILU(0) is the best smoother for stiff bodies.
_MULTIGRID_OPTIONS = {
    "pc_type": "gamg",
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "asm",
    "mg_levels_sub_pc_type": "ilu",
}
# PETSc preconditioners that get matrices of nodal blocks, which halves their time; many others
# support scalar entries only.
_TAKE_BLOCKS = {"asm", "bjacobi", "ilu"}


class CompleteFactors:
    """Complete LU factors of a matrix on one rank, see `cpp/nts/solvers/complete_factors.h`.

    Args:
        rows: All rows of the matrix; their values may change.
        X: Positions of the nodes, for the nested dissection, shape ``(n, 3)`` [m].

    ``str`` is the kind of the factors.
    """

    def __init__(self, rows: BlockCSR, X: Floats) -> None:
        self._rows = rows
        self._factors = _kernels.CompleteFactors(rows.start, rows.column, X)

    def __str__(self) -> str:
        return "LU in single precision"

    def build(self) -> bool:
        """Factorise the current values; return whether the factors exist. Local."""
        rows = self._rows
        exist: bool = self._factors.factorise(rows.start, rows.column, rows.value)
        return exist

    def solve(self, b: Floats) -> Floats:
        """Solution for b, nodal vectors of shape ``(n, d)``. Local."""
        x = np.empty_like(b)
        self._factors.apply(b, x)
        return x

    def solve_all(self, b: Floats) -> Floats:
        """Solve for the columns of an array, shape ``(d n, k)``, by columns. Local."""
        x = np.empty_like(b)
        self._factors.apply(*(v.T.reshape(b.shape[1], -1, self._rows.dim) for v in (b, x)))
        return x


class BulkPreconditioner:
    """Factors of the bulk tangent, replaced by stronger ones after slow convergence.

    ILU(0) is followed by ILU(1), then by complete factors, or by multigrid for many unknowns. After
    slow iterations on one rank the complete factors are first `CompleteFactors`, then
    MUMPS; on several ranks, and in statics, always MUMPS. All of these are factors of a
    definite matrix near the derivative. If it is far from the derivative, as in plastic flow,
    factors of the derivative itself are the last choice, as long as it is definite. A
    preconditioner from the user's options replaces ILU(0) and ILU(1).

    Args:
        tangent: Matrix of the bulk.
        options: Options of the user.

    Attributes:
        point: `Tangent.point` of the factors; None before the first.
        num_builds: Number of factorisations so far.

    ``str`` returns the kind of the factors, or of the last ones until new ones are computed.
    """

    def __init__(self, tangent: Tangent, options: PetscOptions) -> None:
        self._tangent, self._options = tangent, options
        self._kinds = _kinds(tangent)
        self._factors: BlockILU | CompleteFactors | _PetscFactors | None = None
        self._strength, self._last_kind = 0, ""
        self.point: Sequence[Array] | None = None
        self.num_builds = 0

    def __str__(self) -> str:
        return self._last_kind if self._factors is None else str(self._factors)

    @property
    def is_ilu0(self) -> bool:
        """Whether the factors are ILU(0), without options of the user."""
        return self._kind == _ILU0 and not self._options.bulk

    @property
    def is_strong(self) -> bool:
        """Whether the factors are complete ones or multigrid."""
        return self._kind > _ILU1

    @property
    def is_complete(self) -> bool:
        """Whether the factors are LU in double precision of the definite approximate tangent."""
        return self._kind == _LU

    @property
    def is_of_derivative(self) -> bool:
        """Whether the factors are factors of the derivative itself, the strongest complete ones."""
        return self._kind == _LDL_DERIVATIVE

    @property
    def may_be_strengthened(self) -> bool:
        """Whether slow iterations are a reason for stronger factors.

        The user's choice is replaced only after a failure.
        """
        return not (self._is_strongest or self._options.bulk)

    @property
    def has_responses(self) -> bool:
        """Whether `responses` are accurate and cheap enough: with ILU(1) and complete factors."""
        return _MULTIGRID not in self._kinds and self._kind != _ILU0

    def build(self) -> None:
        """Assemble and factorise the tangent, or the nearby matrix. Collective."""
        self._tangent.assemble_nearby()
        self._factors = self._factors or self._new_factors()
        while not self._factors.build():
            self.strengthen()
            self._factors = self._new_factors()
        self.point = self._tangent.point
        self.num_builds, self._last_kind = self.num_builds + 1, str(self._factors)

    def strengthen(self, *, fully: bool = False) -> bool:
        """Let the next `build` compute stronger factors; return whether there are any. Local.

        Args:
            fully: Whether to go to LU in double precision, or multigrid, directly: single precision
                is too inaccurate if inertia is small.
        """
        if self._is_strongest:
            return False
        is_of_user = self._options.bulk and not self.is_strong
        if is_of_user and self._tangent.rows.index_map.comm.rank == 0:
            text = (
                "the preconditioner %s of petsc_options fails, and stronger factors replace it: "
                "harmless for the results, but omit the option, or choose another one, to save "
                "time"
            )
            _logger.warning(text, str(self))
        fully |= bool(self._options.bulk)
        at_once = fully and not self.is_strong
        most = self._kinds.index(_MULTIGRID if _MULTIGRID in self._kinds else _LU)
        self._strength = most if at_once else self._strength + 1
        self._factors = None
        return True

    def solve(self, b: Floats) -> Floats:
        """Solution for b, nodal vectors of shape ``(n, d)``. Collective."""
        assert self._factors is not None
        return self._factors.solve(b)

    @property
    def is_incomplete(self) -> bool:
        """Whether the factors are incomplete ones, which support `restricted`. Local."""
        return isinstance(self._factors, BlockILU)

    @contextmanager
    def restricted(self, nodes: Flags) -> Iterator[None]:
        """Context in which incomplete factors solve for some owned nodes only. Collective.

        Args:
            nodes: Flags of these nodes, shape ``(n,)``.
        """
        assert isinstance(self._factors, BlockILU)
        self._factors.restrict(nodes)
        try:
            yield
        finally:
            self._factors.restrict(None)

    def responses(self, forces: Floats) -> Floats:
        """Solutions for many right-hand sides. Collective.

        Args:
            forces: One column each, at the owned dofs, shape ``(d n, k)``, in column-major order.

        Returns:
            The solutions, the same shape.
        """
        assert self.has_responses and self._factors is not None
        return self._factors.solve_all(forces)

    def serialize(self, archive: Archive) -> None:
        """Serialize the states of the factors and of the last matrix. Collective."""
        tangent = self._tangent
        shared = archive.same("factors_are_last", self.point is tangent.point)
        strength = archive.same("strength_of_factors", self._strength)
        last = archive.local("tangent", tangent.point)
        point = last if shared else archive.local("factors", self.point)
        if not archive.restores or (last is tangent.point and point is self.point):
            return
        self._strength, self.point, self._factors = strength, None, None
        tangent.forget()
        if point is not None:
            with tangent.at(point):
                self.build()
        if last is not None and last is not point:
            tangent.restore(last)

    @property
    def _is_strongest(self) -> bool:
        return self._kind == self._kinds[-1]

    @property
    def _kind(self) -> int:
        """Kind of the current factors."""
        return self._kinds[self._strength]

    def _new_factors(self) -> "BlockILU | CompleteFactors | _PetscFactors":
        """Factors of the current kind, without values. Collective."""
        tangent, options, kind = self._tangent, self._options, self._kind
        if kind == _LU_SINGLE:
            return CompleteFactors(tangent.rows, tangent.X)
        if self.is_strong:
            if kind == _MULTIGRID:
                return _PetscFactors(lambda: _multigrid(tangent, f"{options.prefix}strong_"))
            make = {_LU: _lu_factors, _LDL_DERIVATIVE: _derivative_factors}[kind]
            return _PetscFactors(lambda: make(tangent))
        if options.bulk:
            return _PetscFactors(lambda: _user_factors(tangent, options))
        return BlockILU(tangent.rows, fill=kind == _ILU1)


def _kinds(tangent: Tangent) -> Sequence[int]:
    """Kinds of factors of a tangent, from weak to strong. Local."""
    if tangent.num_unknowns > _DIRECT_UP_TO:
        return _ILU0, _ILU1, _MULTIGRID
    rounded = (_LU_SINGLE,) if tangent.comm.size == 1 else ()
    return _ILU0, _ILU1, *rounded, _LU, _LDL_DERIVATIVE


class _PetscFactors:
    """Preconditioner of PETSc, created again for each matrix.

    Otherwise PETSc would reuse data of the first matrix, and results of a resumed run would differ.

    Args:
        make: Creates the preconditioner for the current matrix; returns it and the contexts of its
            shells.
    """

    def __init__(self, make: Callable[[], tuple[Any, ...]]) -> None:
        self._make = make
        self._pc: Any = None

    def __str__(self) -> str:
        return str(self._pc.getType()).upper()

    def build(self) -> bool:
        if self._pc is not None:
            self._pc.destroy()
        self._pc, *self._contexts = self._make()
        self._x, self._b = self._pc.getOperators()[1].createVecs()
        return True

    def solve(self, b: Floats) -> Floats:
        self._b.array[:] = b.ravel()
        self._pc.apply(self._b, self._x)
        x: Floats = self._x.array.copy()
        return x.reshape(b.shape)

    def solve_all(self, b: Floats) -> Floats:
        """Solve with the factors of a matrix for the columns of an array. Collective."""
        size = (len(b), None), (None, b.shape[1])
        known = PETSc.Mat().createDense(size, array=b, comm=self._pc.comm)
        unknown = known.duplicate()
        self._pc.getFactorMatrix().matSolve(known, unknown)
        x: Floats = unknown.getDenseArray().copy()
        known.destroy()
        unknown.destroy()
        return x


def _user_factors(tangent: Tangent, options: PetscOptions) -> tuple[Any, ...]:
    """Preconditioner by the user's options. Collective."""
    kinds = {value for key, value in options.bulk.items() if key.endswith("pc_type")}
    others = any(key.endswith("mat_solver_type") for key in options.bulk)
    matrix = tangent.matrix(scalar=others or not kinds <= _TAKE_BLOCKS)
    with options.understood():
        return (_from_options(matrix, matrix, options.bulk_prefix),)


def _lu_factors(tangent: Tangent) -> tuple[Any, ...]:
    """Complete factors by MUMPS. Collective."""
    return (mumps.factorised(tangent.matrix(scalar=True)),)


def _derivative_factors(tangent: Tangent) -> tuple[Any, ...]:
    """Factors of the derivative if it is definite, otherwise of the nearby matrix. Collective.

    Indefinite factors would amplify the soft modes of an instability without bounds. The bulk
    tangent of free bodies may have negative eigenvalues, for rotations that contact resists.
    """
    tangent.assemble_exact()
    matrix = tangent.matrix(scalar=True)
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    pc = mumps.factorised(matrix, is_symmetric=True, finds_null=True)
    signs = mumps.signs(pc)
    if signs is not None and sum(signs) <= tangent.num_free:
        return (pc,)
    pc.destroy()
    tangent.assemble_nearby()
    return _lu_factors(tangent)


def _multigrid(tangent: Tangent, prefix: str) -> tuple[Any, ...]:
    """Multigrid with single precision on the finest level. Collective.

    With PETSc's scalar products and factors in double precision on this level, iterations take 50 %
    longer.
    """
    operator = SinglePrecisionOperator(tangent.rows)
    with _options(prefix, _MULTIGRID_OPTIONS):
        pc = _from_options(operator.matrix(), tangent.matrix(scalar=True), prefix)
    finest = pc.getMGLevels() - 1
    factors = BlockILU(tangent.rows)
    if finest > 0 and factors.build():
        use_shell(pc.getMGSmoother(finest).getPC(), factors)
    return pc, operator, factors


def _from_options(operator: Any, matrix: Any, prefix: str) -> Any:
    """Preconditioner with the factors of a matrix for a nearby operator. Collective."""
    pc = PETSc.PC().create(matrix.comm)
    pc.setOptionsPrefix(prefix)
    pc.setOperators(operator, matrix)
    pc.setUseAmat(operator is not matrix)
    pc.setFromOptions()
    pc.setUp()
    pc.setUpOnBlocks()
    return pc


@contextmanager
def _options(prefix: str, values: Mapping[str, Any]) -> Iterator[None]:
    """Context in which PETSc's database contains some options."""
    database = PETSc.Options(prefix)
    for key, value in values.items():
        database[key] = value
    try:
        yield
    finally:
        for key in values:
            database.delValue(key)
