"""PETSc options of the user, and a check for unused ones."""

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

_number = itertools.count()  # makes the prefixes of these objects unique
# Preconditioners that PETSc itself implements on one rank only.
_SERIAL = {"icc", "ilu"}
# Preconditioners with options for levels; a small mesh may have a single level.
_MULTIGRID = {"gamg", "hmg", "mg", "ml"}
# Options that Newton's method sets in each iteration.
_OF_NEWTON = ("ksp_rtol", "ksp_atol", "ksp_divtol", "ksp_max_it")
# petsc4py up to 3.22 has no access to the used options; the PETSc library has.
_library = ctypes.CDLL(PETSc.__file__)


class PetscOptions:
    """Options of one linear solver, in PETSc's database.

    Args:
        comm: Communicator of the solver.
        options: Options without prefix: ``ksp_...`` for the Krylov method, all others for the
            preconditioner of the bulk; None for none.

    Attributes:
        prefix: Prefix of the options of the Krylov method.
        bulk_prefix: Prefix of the options of the preconditioner of the bulk.
        bulk: Options of this preconditioner, without prefix.
        krylov: Whether there are options of the Krylov method.

    Raises:
        TypeError: The options are not a mapping.
        ValueError: The preconditioner does not exist on several ranks, or is in Python without a
            class; a name is not a string or has a dash; or Newton's method sets the option.
    """

    def __init__(self, comm: MPI.Comm, options: Mapping[str, Any] | None) -> None:
        if not (options is None or isinstance(options, Mapping)):
            raise TypeError(f"expected petsc_options by name in a dict, given {options!r}")
        self._comm, options = comm, dict(options or {})
        if strange := [key for key in options if not isinstance(key, str)]:
            raise ValueError(f"expected petsc_options with names as str, given {strange}")
        if set_here := [key for key in options if key in _OF_NEWTON]:
            raise ValueError(
                f"expected petsc_options without {', '.join(_OF_NEWTON)}, which Newton's method "
                f"sets, given {set_here}"
            )
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
        if kind == "python" and "pc_python_type" not in self.bulk:
            raise ValueError(
                "expected petsc_options with a class as pc_python_type, such as "
                f"'my_module.MyClass', for pc_type python, given {options}"
            )
        self._names = {
            f"{self.bulk_prefix if key in self.bulk else self.prefix}{key}": key for key in options
        }
        database = PETSc.Options()
        for name, key in self._names.items():
            database[name] = options[key]

    @contextmanager
    def understood(self) -> Iterator[None]:
        """Context with the options in PETSc's database. Collective.

        Raises:
            ValueError: PETSc refuses one of them.
        """
        try:
            yield
        except PETSc.Error as error:
            database = PETSc.Options()
            for name in self._names:
                database.delValue(name)
            lines = str(error).splitlines()
            reason = lines[-1].partition("] ")[2] or lines[0]
            # An error of a preconditioner in Python, which PETSc reports by its own place only.
            cause = error.__cause__ or error.__context__
            if cause is not None:
                reason = f"{type(cause).__name__}: {cause}"
            raise ValueError(
                f"expected petsc_options that PETSc understands, given {self._given}: {reason}"
            ) from cause

    def check_used(self) -> None:
        """Raise if options have not been used so far; later calls do nothing. Collective.

        Raises:
            ValueError: There are unused options, and the small size of the mesh is not the reason.
        """
        flags = np.array([_is_used(name) for name in self._names], dtype=bool)
        flags = reductions.anywhere(self._comm, flags)
        unused = [name for name, is_used in zip(self._names, flags, strict=True) if not is_used]
        database = PETSc.Options()
        for name in unused:
            database.delValue(name)  # otherwise PETSc warns of it again at the end of the program
        kinds = {value for key, value in self.bulk.items() if key.endswith("pc_type")}
        excused = [name for name in unused if "mg_" in name and not kinds.isdisjoint(_MULTIGRID)]
        if excused and self._comm.rank == 0:
            text = (
                "%s of petsc_options was not used: harmless if multigrid needs fewer levels on "
                "this mesh, otherwise check the spelling"
            )
            _logger.warning(text, self._listed(excused))
        if wrong := [name for name in unused if name not in excused]:
            raise ValueError(
                "expected petsc_options that the Krylov method or the preconditioner of the bulk "
                f"uses, given {self._listed(wrong)}"
            )

    def _listed(self, names: Iterable[str]) -> str:
        return ", ".join(self._names[name] for name in names)


def _is_used(name: str) -> bool:
    """Whether an option has been read from PETSc's database on this rank."""
    found = ctypes.c_int(0)  # large enough for a PetscBool
    _library.PetscOptionsUsed(None, name.encode(), ctypes.byref(found))
    return bool(found.value)
