"""Operator and preconditioner of the projected tangent, for PETSc."""

from collections.abc import Mapping, Sequence
from typing import Any

from petsc4py import PETSc

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Array
from dolfinx_nts.solvers.block_ilu import BlockILU, SinglePrecisionOperator
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.contact_schwarz import ContactSchwarz
from dolfinx_nts.solvers.elimination import Elimination
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["Operator", "Preconditioner"]

# Unknowns up to which the stronger one is a complete factorisation.
_DIRECT_UP_TO = 50_000
# On several ranks the order of the unknowns decides: reverse Cuthill-McKee, the
# order of DOLFINx on one rank, needs 7 iterations for 8 decades, without it 12.
_ON_RANKS = {
    "pc_asm_overlap": 1,
    "sub_pc_type": "ilu",
    "sub_pc_factor_mat_ordering_type": "rcm",
}
# One sweep with incomplete factors smooths best (elasticity of stiff bodies).
_MULTIGRID = {
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "asm",
    "mg_levels_sub_pc_type": "ilu",
}


class Operator:
    """Context of the shell matrix: projected tangent.

    Right-hand sides and products have no part in the directions that
    nodes give up, and such a part of what is multiplied has no effect.

    Args:
        bulk: Forms of the bodies.

    Attributes:
        bulk: The forms.
        elimination: Contacts of this Newton iteration.
    """

    def __init__(self, bulk: Bulk) -> None:
        """Start without contact."""
        self.bulk = bulk
        self.elimination = Elimination((), ())

    def mult(self, _matrix: Any, x: Any, y: Any) -> None:
        """Z~^T (K + C) Z x."""
        z = x.array_r.reshape(-1, 3).copy()
        parts = self.elimination.constrain(z)
        y.array[:] = self.elimination.act(parts, self.bulk.action(z)).ravel()


class Preconditioner:
    """Context of the shell preconditioner: kept factors and a patch.

    The factors are of the bulk and age slowly; the patch is of the
    contacts of this Newton iteration (`cpp/nts/solvers/contact_schwarz.h`).

    Args:
        operator: The operator.
        tangent: Matrix of the bulk.
        prefix: Of the PETSc options of the bulk's factors. If there are
            any, PETSc makes the factors; otherwise `BlockILU`, until
            stronger ones are needed.

    Attributes:
        is_strong: Whether the factors are complete, or multigrid.
        point: `Tangent.point` of the factors; None before the first.
        num_builds: Factorisations so far.

    ``str`` tells the kind of factors.
    """

    def __init__(self, operator: Operator, tangent: Tangent, prefix: str) -> None:
        """Factorise nothing yet."""
        self._operator, self._tangent = operator, tangent
        self._pc = PETSc.PC().create(operator.bulk.comm)
        self._pc.setOptionsPrefix(prefix)
        self._wants_own = not PETSc.Options(prefix).getAll()
        self._own: BlockILU | None = None
        self._scalar: Any = None
        self._patch: ContactSchwarz | None = None
        self._kind = ""
        self._set: list[str] = []  # options that the user left open
        self.is_strong = False
        self.point: Sequence[Array] | None = None
        self.num_builds = 0

    def __str__(self) -> str:
        """Type of the factors, and what it is used with."""
        factors = self._pc.getType().upper() if self._own is None else self._own
        return f"kept {factors} of the bulk and a patch around the contacts"

    @property
    def num_patches(self) -> int:
        """Factorisations of the patch."""
        return 0 if self._patch is None else self._patch.num_builds

    def build(self) -> None:
        """Assemble and factorise the matrix near the tangent. Collective."""
        tangent = self._tangent
        tangent.assemble_nearby()
        if self._wants_own and not self.is_strong:
            if self._own is None:
                self._own = BlockILU(tangent.rows)
            if not self._own.build():
                self.strengthen()
        if self._own is None:
            self._factorise(tangent.matrix())
        self.point = tangent.point
        self.num_builds += 1

    def _factorise(self, matrix: Any) -> None:
        """Let PETSc factorise."""
        if self.is_strong:
            # What a first factorisation chose would last.
            self._pc.reset()
        elif matrix.comm.size == 1:
            self._use("ilu", {})
        else:
            self._use("asm", _ON_RANKS)
        operator = matrix
        if self.is_strong and self._pc.getType() in ("lu", "gamg"):
            # They want scalar entries.
            operator = matrix = self._scalar = matrix.convert("aij", self._scalar or PETSc.Mat())
            if self._pc.getType() == "gamg":
                matrix.setBlockSize(3)
                matrix.setNearNullSpace(self._tangent.rigid_modes())
        smooths = self._pc.getType() == "gamg" and self._wants_own
        if smooths:
            operator = SinglePrecisionOperator(self._tangent.rows).matrix()
        self._pc.setUseAmat(smooths)
        self._pc.setOperators(operator, matrix)
        self._pc.setUp()
        if smooths:
            self._smooth()

    def _smooth(self) -> None:
        """Let kept factors smooth on the finest level of multigrid, with kept rows.

        With PETSc's, scalar and in double precision, iterations take half as long again.
        """
        finest = self._pc.getMGLevels() - 1
        factors = BlockILU(self._tangent.rows)
        if finest > 0 and factors.build():
            pc = self._pc.getMGSmoother(finest).getPC()
            pc.setType("python")
            pc.setPythonContext(_Smoother(factors))

    def serialize(self, archive: Archive) -> None:
        """Serialize where factors and patch were made. Collective."""
        tangent = self._tangent
        shared = archive.same("factors_are_last", self.point is tangent.point)
        strong = archive.same("factors_are_strong", self.is_strong)
        last = archive.local("tangent", tangent.point)
        point = last if shared else archive.local("factors", self.point)
        if archive.giving and not (last is tangent.point and point is self.point):
            self._restore(point, last, strong)
        if self._patch is None and tangent.point is not None:
            self._patch = ContactSchwarz(tangent.rows)
        if self._patch is not None:
            self._patch.serialize(archive, tangent.num_assembled)

    def _restore(
        self,
        point: Sequence[Array] | None,
        last: Sequence[Array] | None,
        strong: bool,
    ) -> None:
        tangent = self._tangent
        self._pc.reset()
        self.is_strong, self.point = False, None
        tangent.forget()
        if point is not None:
            with tangent.at(point):
                self.build()
                if strong:
                    self.strengthen()
                    self.build()
        if last is not None and last is not point:
            tangent.restore(last)

    def strengthen(self) -> None:
        """Change to a complete factorisation or multigrid. Collective."""
        self.is_strong, self._own = True, None
        if 3 * self._tangent.rows.index_map.size_global <= _DIRECT_UP_TO:
            self._use("lu", {"pc_factor_mat_solver_type": "mumps"})
        else:
            self._use("gamg", _MULTIGRID)

    def _use(self, kind: str, defaults: Mapping[str, Any]) -> None:
        """Set type and options, but for what the user has set."""
        if kind == self._kind:
            return
        self._kind = kind
        options, prefix = PETSc.Options(), self._pc.getOptionsPrefix()
        for key in self._set:
            # Of another kind of factors, which may not know them.
            options.delValue(key)
        self._set = []
        self._pc.setType(kind)
        if options.getString(f"{prefix}pc_type", kind) == kind:
            for key, value in defaults.items():
                if not options.hasName(prefix + key):
                    options[prefix + key] = value
                    self._set.append(prefix + key)
        self._pc.setFromOptions()

    def prepare(self) -> None:
        """Bring the patch up to the present pairs and factors. Collective."""
        if self._patch is None:
            self._patch = ContactSchwarz(self._tangent.rows)
        self._patch.update(self._operator.elimination, self._tangent.num_assembled)

    def apply(self, _pc: Any, r: Any, z: Any) -> None:
        """Factors of the bulk, then the patch; called by PETSc."""
        if self._own is None:
            self._pc.apply(r, z)
        else:
            self._own.apply(r.array_r.reshape(-1, 3), z.array.reshape(-1, 3))
        if self._operator.elimination.empty:
            return
        assert self._patch is not None
        self._patch.correct(r.array_r.reshape(-1, 3), z.array.reshape(-1, 3))


class _Smoother:
    """Context of kept factors for PETSc."""

    def __init__(self, factors: BlockILU) -> None:
        self._factors = factors

    def apply(self, _pc: Any, r: Any, z: Any) -> None:
        self._factors.apply(r.array_r.reshape(-1, 3), z.array.reshape(-1, 3))
