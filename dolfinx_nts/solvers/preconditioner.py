"""Preconditioner of the bulk: an approximate inverse that serves for many steps."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from petsc4py import PETSc

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Array, Flags, Floats
from dolfinx_nts.solvers import mumps
from dolfinx_nts.solvers.block_ilu import BlockILU, SinglePrecisionOperator
from dolfinx_nts.solvers.complete_factors import CompleteFactors
from dolfinx_nts.solvers.petsc_options import PetscOptions
from dolfinx_nts.solvers.shells import use_shell
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["BulkPreconditioner"]

_logger = logging.getLogger("dolfinx_nts")

# Kinds of factors: incomplete ones, those with fill, complete ones in single and in double
# precision, complete ones of the derivative itself, and multigrid.
_ILU0, _ILU1, _LU_SINGLE, _LU, _LDL_DERIVATIVE, _MULTIGRID = range(6)
# Unknowns up to which a complete factorisation is cheaper than multigrid.
_DIRECT_UP_TO = 50_000
# Options of multigrid: one sweep with incomplete factors smooths best (stiff bodies).
_MULTIGRID_OPTIONS = {
    "pc_type": "gamg",
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "asm",
    "mg_levels_sub_pc_type": "ilu",
}
# Preconditioners of PETSc that do with blocks of nodes what takes twice as long with
# scalars; of the others, many know scalars only.
_TAKE_BLOCKS = {"asm", "bjacobi", "ilu"}


class BulkPreconditioner:
    """Factors of the tangent of the bulk, and stronger ones where these do not suffice.

    The first are `BlockILU`, the next ones the same with fill, and the strong ones
    complete factors, or multigrid where unknowns are many. On one rank complete ones that follow
    slow iterations are first `CompleteFactors`, then those of MUMPS, which several ranks, and
    statics, have from the start. All of these are of a definite matrix near the derivative. Where
    it is far from it, as in plastic flow, those of the derivative itself are the last, as long as
    it is definite, too.
    What PETSc makes of the user's options takes the place of both incomplete ones.

    Args:
        tangent: Matrix of the bulk.
        options: Options of the user.

    Attributes:
        point: `Tangent.point` of the factors; None before the first.
        num_builds: Factorisations so far.

    ``str`` tells the kind of the factors, of the last ones where the next are not made yet.
    """

    def __init__(self, tangent: Tangent, options: PetscOptions) -> None:
        """Create the object, without factors before `build`."""
        self._tangent, self._options = tangent, options
        self._kinds = _kinds(tangent)
        self._factors: BlockILU | CompleteFactors | _PetscFactors | None = None
        self._strength, self._last_kind = 0, ""
        self.point: Sequence[Array] | None = None
        self.num_builds = 0

    def __str__(self) -> str:
        """Kind of the factors, empty before the first."""
        return self._last_kind if self._factors is None else str(self._factors)

    @property
    def is_ilu0(self) -> bool:
        """Whether the factors are the first ones of the project's own choice."""
        return self._kind == _ILU0 and not self._options.bulk

    @property
    def is_strong(self) -> bool:
        """Whether complete ones or multigrid have taken over."""
        return self._kind > _ILU1

    @property
    def is_complete(self) -> bool:
        """Whether they are complete ones in double precision of a matrix near the derivative."""
        return self._kind == _LU

    @property
    def may_be_strengthened(self) -> bool:
        """Whether slow iterations are a reason for stronger factors.

        Those that the user has chosen have to fail before others take over.
        """
        return not (self._is_strongest or self._options.bulk)

    @property
    def has_responses(self) -> bool:
        """Whether `responses` are good and affordable: of factors with fill, or complete ones."""
        return _MULTIGRID not in self._kinds and self._kind != _ILU0

    def build(self) -> None:
        """Assemble and factorise the tangent, or the matrix near it. Collective."""
        self._tangent.assemble_nearby()
        self._factors = self._factors or self._new_factors()
        while not self._factors.build():
            self.strengthen()
            self._factors = self._new_factors()
        self.point = self._tangent.point
        self.num_builds, self._last_kind = self.num_builds + 1, str(self._factors)

    def strengthen(self, *, fully: bool = False) -> bool:
        """Let the next `build` make stronger factors; returns whether there are any. Local.

        Args:
            fully: Whether to make complete ones in double precision, or multigrid, at once: single
                precision is too coarse where inertia does little.
        """
        if self._is_strongest:
            return False
        is_of_user = self._options.bulk and not self.is_strong
        if is_of_user and self._tangent.rows.index_map.comm.rank == 0:
            text = (
                "%s of petsc_options fails, and stronger factors take its place: harmless for the "
                "results, but leave the option out, or choose another one, to save time"
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
        """Whether the factors are incomplete ones, which can be `restricted`. Local."""
        return isinstance(self._factors, BlockILU)

    @contextmanager
    def restricted(self, nodes: Flags) -> Iterator[None]:
        """Context in which incomplete factors solve for some owned nodes alone. Collective.

        Args:
            nodes: Which ones, shape ``(n,)``.
        """
        assert isinstance(self._factors, BlockILU)
        self._factors.restrict(nodes)
        try:
            yield
        finally:
            self._factors.restrict(None)

    def responses(self, forces: Floats) -> Floats:
        """Solutions of the factors for many right-hand sides. Collective.

        Args:
            forces: One column each, at the owned dofs, shape ``(d n, k)``, by columns.

        Returns:
            The solutions, the same shape.
        """
        assert self.has_responses and self._factors is not None
        return self._factors.solve_all(forces)

    def serialize(self, archive: Archive) -> None:
        """Serialize the state of which the factors are, and that of the matrix. Collective."""
        tangent = self._tangent
        shared = archive.same("factors_are_last", self.point is tangent.point)
        strength = archive.same("strength_of_factors", self._strength)
        last = archive.local("tangent", tangent.point)
        point = last if shared else archive.local("factors", self.point)
        if not archive.giving or (last is tangent.point and point is self.point):
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
        """Kind of the present factors."""
        return self._kinds[self._strength]

    def _new_factors(self) -> "BlockILU | CompleteFactors | _PetscFactors":
        """Factors of the present kind, without values. Collective."""
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
    """Kinds of factors of a tangent, each one stronger than those before. Local."""
    if tangent.num_unknowns > _DIRECT_UP_TO:
        return _ILU0, _ILU1, _MULTIGRID
    rounded = (_LU_SINGLE,) if tangent.comm.size == 1 else ()
    return _ILU0, _ILU1, *rounded, _LU, _LDL_DERIVATIVE


class _PetscFactors:
    """Preconditioner of PETSc, a new one for each matrix.

    PETSc would otherwise go on with what it has chosen for the first matrix,
    which a resumed run does not know.

    Args:
        make: Makes it for the present matrix; returns it and what its shells need.
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
    """Complete factors of the derivative where it is definite, elsewhere those near it. Collective.

    Where it is not, they would let the soft motions of an instability grow without bounds. Free
    bodies may turn under the forces that press them together: there contact resists.
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
    """Multigrid whose finest level works in single precision. Collective.

    Iterations take half as long again with PETSc's products and factors on
    this level, which are scalar and in double precision.
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
    """Preconditioner of a matrix, for the operator near which it is. Collective."""
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
    """Context in which PETSc's database has some options."""
    database = PETSc.Options(prefix)
    for key, value in values.items():
        database[key] = value
    try:
        yield
    finally:
        for key in values:
            database.delValue(key)
