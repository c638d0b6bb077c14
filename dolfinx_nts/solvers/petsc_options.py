"""Options that a user gives to PETSc, and which of them nothing has asked for."""

import ctypes
import itertools
import logging
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_nts.parallel import reductions

__all__ = ["PetscOptions"]

_logger = logging.getLogger("dolfinx_nts")

_number = itertools.count()  # numbers these objects, whose prefixes must differ
# Preconditioners of PETSc's own that it has on one rank only.
_SERIAL = {"icc", "ilu"}
# Those that have options for levels, of which a small mesh may have one only.
_MULTIGRID = {"gamg", "hmg", "mg", "ml"}
# petsc4py up to 3.22 does not tell which options were used; its library does.
_library = ctypes.CDLL(PETSc.__file__)


class PetscOptions:
    """Options of one linear solver, in PETSc's database.

    Args:
        comm: Communicator of the solver.
        options: Without prefix: ``ksp_...`` for the Krylov method, all
            others for the preconditioner of the bulk; None for none.

    Attributes:
        prefix: Of those for the Krylov method.
        bulk_prefix: Of those for the preconditioner of the bulk.
        bulk: The latter, without prefix.
        krylov: Whether there are any of the former.

    Raises:
        TypeError: The options are no mapping.
        ValueError: The preconditioner does not exist on several ranks, or a name has a dash.
    """

    def __init__(self, comm: MPI.Comm, options: Mapping[str, Any] | None) -> None:
        """Create the prefixes and put the options into the database."""
        if not (options is None or isinstance(options, Mapping)):
            raise TypeError(f"expected petsc_options by name in a dict, given {options!r}")
        self._comm, options = comm, dict(options or {})
        if dashed := [key for key in options if key.startswith("-")]:
            raise ValueError(f"expected petsc_options without a leading -, given {dashed}")
        self._given = options
        self.prefix = f"nts_{next(_number)}_"
        self.bulk_prefix = f"{self.prefix}bulk_"
        self.bulk = {key: value for key, value in options.items() if not key.startswith("ksp_")}
        self.krylov = len(self.bulk) < len(options)
        kind = self.bulk.get("pc_type")
        if comm.size > 1 and kind in _SERIAL and "pc_factor_mat_solver_type" not in self.bulk:
            raise ValueError(
                "expected a pc_type that exists on several ranks, as asm with sub_pc_type "
                f"{kind} does, given {kind} on {comm.size} ranks"
            )
        self._names = {
            f"{self.bulk_prefix if key in self.bulk else self.prefix}{key}": key for key in options
        }
        database = PETSc.Options()
        for name, key in self._names.items():
            database[name] = options[key]

    @contextmanager
    def understood(self) -> Iterator[None]:
        """Context in which PETSc reads the options. Collective.

        Raises:
            ValueError: PETSc refuses one of them.
        """
        try:
            yield
        except PETSc.Error as error:
            database = PETSc.Options()
            for name in self._names:
                database.delValue(name)
            reason = str(error).splitlines()[-1].partition("] ")[2]
            raise ValueError(
                f"expected petsc_options that PETSc understands, given {self._given}: {reason}"
            ) from None

    def check_used(self) -> None:
        """Tell which options nothing has asked for so far, and forget them. Collective.

        Raises:
            ValueError: There are some that a small mesh does not explain.
        """
        flags = np.array([_is_used(name) for name in self._names], dtype=bool)
        flags = reductions.anywhere(self._comm, flags)
        unused = [name for name, is_used in zip(self._names, flags, strict=True) if not is_used]
        database = PETSc.Options()
        for name in unused:
            database.delValue(name)  # PETSc would name it again at the end of the program
        kinds = {value for key, value in self.bulk.items() if key.endswith("pc_type")}
        excused = [name for name in unused if "mg_" in name and not kinds.isdisjoint(_MULTIGRID)]
        if excused and self._comm.rank == 0:
            text = (
                "nothing has asked for %s of petsc_options: harmless if multigrid needs fewer "
                "levels on this mesh, otherwise look for a misspelling"
            )
            _logger.warning(text, self._listed(excused))
        if wrong := [name for name in unused if name not in excused]:
            raise ValueError(
                "expected petsc_options that the Krylov method or the preconditioner of the bulk "
                f"asks for, given {self._listed(wrong)}"
            )

    def _listed(self, names: Iterable[str]) -> str:
        return ", ".join(self._names[name] for name in names)


def _is_used(name: str) -> bool:
    """Whether something on this rank has asked PETSc's database for an option."""
    found = ctypes.c_int(0)  # room for a PetscBool, whatever its size
    _library.PetscOptionsUsed(None, name.encode(), ctypes.byref(found))
    return bool(found.value)
