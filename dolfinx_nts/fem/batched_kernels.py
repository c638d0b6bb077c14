"""Compilation and loading of kernels for batches of cells.

The compiler runs in the background until the kernels are requested.
"""

import atexit
import ctypes
import logging
import os
import shlex
import subprocess
import sysconfig
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from dolfinx import fem

from dolfinx_nts._kernels import BatchKernel
from dolfinx_nts.fem.batched_source import Columns, batched_source
from dolfinx_nts.fem.jit import OPTIMISED, SOON
from dolfinx_nts.parallel import reductions

__all__ = ["batched_kernels", "begin_batched_kernels", "matrix_kernels"]

_LOG = logging.getLogger(__name__)
_FOLDER = Path(__file__).parent
# Files on which the source of a library depends, in addition to that of FFCx.
_RECIPE = [
    _FOLDER / name
    for name in (
        *("lanes.h", "line.h", "bilinear.h", "trilinear.h", "columns.h"),
        *("batched_source.py", "tensor_tables.py"),
    )
]
# C++14, as <cmath> of C++17 takes 0.05 s longer to compile, for functions that kernels do not use.
_STANDARD = "-std=c++14"
# Number of assigned values in a kernel [-] above which `SOON` is used, as the compile time at -O3
# grows faster than the kernel: an Ogden law with 5 800 values takes 36 s of CPU time at -O3 and 13
# s with `SOON`, and 16 and 15 us per batch.
_MOST_VALUES = 5000
_SINGLE = ["-DNTS_SINGLE", "-fsingle-precision-constant"]


class _Library(NamedTuple):
    """Source, compiler call and path of a library.

    Its name contains a hash of these data, so that an existing library is never compiled again.

    Attributes:
        text: C code of the form, written by FFCx.
        columns: Position of a function in the kernels, see `batched_source`.
        command: Call of the compiler, without its files.
        path: Path of the library.
    """

    text: str
    columns: Columns | None
    command: Sequence[str]
    path: Path

    @classmethod
    def of(cls, module: Path, *, is_single: bool, columns: Columns | None) -> "_Library":
        """Shared library of the form, from its FFCx module.

        Raises:
            OSError: The C code does not exist.
        """
        name = module.name.split(".")[0]
        text = module.with_name(f"{name}.c").read_text()
        compiler = os.environ.get("CXX") or sysconfig.get_config_var("CXX") or "c++"
        # `SOON` compiles faster, to slower code. It is used for matrices, which are assembled
        # rarely, and for long forms, whose full optimisation takes minutes.
        is_long = text.count(" = ") > _MOST_VALUES
        soon = [] if columns is None and not is_long else SOON
        flags = [*OPTIMISED, *soon, *(_SINGLE if is_single else [])]
        command = [*shlex.split(compiler), *flags, _STANDARD, "-fPIC", "-shared"]
        recipe = (path.read_text() for path in _RECIPE)
        texts = [text, str(columns), " ".join(command), *recipe]
        digest = sha256("".join(texts).encode()).hexdigest()[:16]
        return cls(text, columns, command, module.with_name(f"{name}-{digest}.so"))


class _Compilation:
    """Running compiler of a library, whose file is created when it is complete.

    Raises:
        OSError: There is no compiler, or the folder is not writable.
        ValueError: The C code does not have the expected form.
    """

    def __init__(self, library: _Library) -> None:
        source = batched_source(library.text, library.columns)
        self._path, self._folder = (
            library.path,
            tempfile.TemporaryDirectory(dir=library.path.parent),
        )
        text, self._made = (Path(self._folder.name) / f"batch.{kind}" for kind in ("cpp", "so"))
        text.write_text(source)
        include = f"-I{_FOLDER}"
        command = [*library.command, include, str(text), "-o", str(self._made), "-lm"]
        try:
            self._process = subprocess.Popen(
                command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
            )
        except OSError:
            self._folder.cleanup()
            raise

    def finish(self) -> None:
        """Wait for the library.

        Raises:
            subprocess.CalledProcessError: The compiler rejects the source.
        """
        _, errors = self._process.communicate()
        with self._folder:
            if code := self._process.returncode:
                raise subprocess.CalledProcessError(code, self._process.args, stderr=errors)
            self._made.replace(self._path)

    def stop(self) -> None:
        """Stop the compiler of a library that is not needed."""
        self._process.kill()
        self._process.communicate()
        self._folder.cleanup()


# Running compilers by the path of the library.
_at_work: dict[Path, _Compilation] = {}


@atexit.register
def _stop_all() -> None:
    while _at_work:
        _at_work.popitem()[1].stop()


def begin_batched_kernels(
    form: fem.Form, *, is_single: bool = False, columns: Columns | None = None
) -> None:
    """Start compiling the kernels of `batched_kernels` or `matrix_kernels`. Local.

    The arguments are those of these functions; errors are raised when the kernels are requested.
    """
    if form.mesh.comm.rank == 0:
        with suppress(OSError, ValueError):
            module = Path(form.module.__file__)
            library = _Library.of(module, is_single=is_single, columns=columns)
            if not library.path.exists() and library.path not in _at_work:
                _at_work[library.path] = _Compilation(library)


def batched_kernels(form: fem.Form, *, is_single: bool = False) -> list[BatchKernel] | None:
    """Create kernels for batches of cells from FFCx's code of a form. Collective.

    Their library is stored next to FFCx's and compiled once.

    Args:
        form: A linear form over cells.
        is_single: Whether the kernels compute in single precision.

    Returns:
        One kernel for each integral; None if FFCx's code does not have the expected form, or if no
        compiler supports vector types.
    """
    library = _loaded_everywhere(form, is_single=is_single, columns=None)
    if library is None:
        return None
    lanes = ctypes.c_int.in_dll(library, "num_lanes").value
    return [
        BatchKernel(address, lanes, is_single) for address in _addresses(library, "batch", form)
    ]


def matrix_kernels(form: fem.Form, columns: Columns) -> list[int] | None:
    """Create kernels of a bilinear form from FFCx's code of its action. Collective.

    They have the interface of FFCx's kernels. The columns of an element matrix are actions on unit
    vectors, in batches.

    Args:
        form: The action on a function, a linear form over cells.
        columns: Position of the function in the kernels.

    Returns:
        Address of the kernel for each integral; None as in `batched_kernels`.
    """
    library = _loaded_everywhere(form, is_single=False, columns=columns)
    return None if library is None else _addresses(library, "matrix", form)


def _loaded_everywhere(
    form: fem.Form, *, is_single: bool, columns: Columns | None
) -> ctypes.CDLL | None:
    """Library for a form; None if it is missing on any rank. Collective."""
    comm = form.mesh.comm
    library: ctypes.CDLL | None = None
    # The first rank compiles. All other ranks find its library, or on another machine compile their
    # own.
    for has_turn in (comm.rank == 0, comm.rank > 0):
        if has_turn:
            try:
                library = _loaded(
                    _Library.of(Path(form.module.__file__), is_single=is_single, columns=columns)
                )
            except (OSError, ValueError, subprocess.CalledProcessError) as error:
                _LOG.info(
                    "no kernels for batches of cells, which is harmless, but the kernels of FFCx "
                    "take two to four times as long (%s)",
                    getattr(error, "stderr", None) or error,
                )
        comm.Barrier()
    return library if reductions.everywhere(comm, library is not None) else None


def _loaded(library: _Library) -> ctypes.CDLL:
    """Load a library, after compiling it if necessary.

    Raises:
        OSError: There is no compiler, or the library cannot be loaded.
        ValueError: FFCx's code does not have the expected form.
        subprocess.CalledProcessError: The compiler rejects the source.
    """
    if not library.path.exists():
        (_at_work.pop(library.path, None) or _Compilation(library)).finish()
    return ctypes.CDLL(str(library.path))


def _addresses(library: ctypes.CDLL, name: str, form: fem.Form) -> list[int]:
    """Addresses of the functions of a library, one for each integral over cells."""
    number = form.ufcx_form.form_integral_offsets[1]
    functions = [getattr(library, f"{name}_{i}") for i in range(number)]
    return [ctypes.cast(function, ctypes.c_void_p).value or 0 for function in functions]
