"""Compiles and loads kernels for batches of cells.

A compiler works while the program goes on, until the kernels are asked for.
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
# What the text of a library depends on beside FFCx's: headers, and what translates.
_RECIPE = [
    _FOLDER / name
    for name in (
        *("lanes.h", "line.h", "bilinear.h", "trilinear.h", "columns.h"),
        *("batched_source.py", "tensor_tables.py"),
    )
]
# With C++17 <cmath> takes a twentieth of a second more, for functions that kernels do not have.
_STANDARD = "-std=c++14"
_SINGLE = ["-DNTS_SINGLE", "-fsingle-precision-constant"]


class _Library(NamedTuple):
    """A library: what it is made of, how, and where it lies.

    Its name tells what goes into it, so that nobody translates for a library that is there.

    Attributes:
        text: The C that FFCx wrote for the form.
        columns: Place of a function in the kernels, see `batched_source`.
        command: Call of the compiler, without its files.
        path: Where the library lies, or will lie.
    """

    text: str
    columns: Columns | None
    command: Sequence[str]
    path: Path

    @classmethod
    def of(cls, module: Path, *, is_single: bool, columns: Columns | None) -> "_Library":
        """Library for the form in a module of FFCx.

        Raises:
            OSError: There is no text.
        """
        name = module.name.split(".")[0]
        text = module.with_name(f"{name}.c").read_text()
        compiler = os.environ.get("CXX") or sysconfig.get_config_var("CXX") or "c++"
        # Of matrices there are few; kernels of the others are used all the time.
        soon = [] if columns is None else SOON
        flags = [*OPTIMISED, *soon, *(_SINGLE if is_single else [])]
        command = [*shlex.split(compiler), *flags, _STANDARD, "-fPIC", "-shared"]
        recipe = (path.read_text() for path in _RECIPE)
        texts = [text, str(columns), " ".join(command), *recipe]
        digest = sha256("".join(texts).encode()).hexdigest()[:16]
        return cls(text, columns, command, module.with_name(f"{name}-{digest}.so"))


class _Compilation:
    """A compiler at work on a library, which is there completely or not at all.

    Raises:
        OSError: There is no compiler, or no place for the library.
        ValueError: The text is not what is expected.
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
            subprocess.CalledProcessError: The compiler does not understand the source.
        """
        _, errors = self._process.communicate()
        with self._folder:
            if code := self._process.returncode:
                raise subprocess.CalledProcessError(code, self._process.args, stderr=errors)
            self._made.replace(self._path)

    def stop(self) -> None:
        """End the compiler, as nobody has asked for the library."""
        self._process.kill()
        self._process.communicate()
        self._folder.cleanup()


# Compilers at work, by the path of the library.
_at_work: dict[Path, _Compilation] = {}


@atexit.register
def _stop_all() -> None:
    while _at_work:
        _at_work.popitem()[1].stop()


def begin_batched_kernels(
    form: fem.Form, *, is_single: bool = False, columns: Columns | None = None
) -> None:
    """Let a compiler begin on what `batched_kernels` or `matrix_kernels` will give. Local.

    Arguments are theirs. They also tell what fails.
    """
    if form.mesh.comm.rank == 0:
        with suppress(OSError, ValueError):
            module = Path(form.module.__file__)
            library = _Library.of(module, is_single=is_single, columns=columns)
            if not library.path.exists() and library.path not in _at_work:
                _at_work[library.path] = _Compilation(library)


def batched_kernels(form: fem.Form, *, is_single: bool = False) -> list[BatchKernel] | None:
    """Make kernels for batches of cells from what FFCx wrote for a form. Collective.

    Their library lies beside that which FFCx made, and is compiled once.

    Args:
        form: A linear form over cells.
        is_single: Whether the kernels compute in single precision.

    Returns:
        One kernel for each integral; None where FFCx's text is not what is expected, or there
        is no compiler that knows vectors.
    """
    library = _loaded_everywhere(form, is_single=is_single, columns=None)
    if library is None:
        return None
    lanes = ctypes.c_int.in_dll(library, "num_lanes").value
    return [
        BatchKernel(address, lanes, is_single) for address in _addresses(library, "batch", form)
    ]


def matrix_kernels(form: fem.Form, columns: Columns) -> list[int] | None:
    """Make kernels of a bilinear form from what FFCx wrote for its action. Collective.

    They have the interface of FFCx's kernels. Columns of a cell's matrix are actions on units,
    as many at once as a batch has cells.

    Args:
        form: The action on a function, a linear form over cells.
        columns: Place of the function in the kernels.

    Returns:
        Address of the kernel for each integral; None as of `batched_kernels`.
    """
    library = _loaded_everywhere(form, is_single=False, columns=columns)
    return None if library is None else _addresses(library, "matrix", form)


def _loaded_everywhere(
    form: fem.Form, *, is_single: bool, columns: Columns | None
) -> ctypes.CDLL | None:
    """Library for a form; None where a rank has none. Collective."""
    comm = form.mesh.comm
    library: ctypes.CDLL | None = None
    # The first rank compiles. Others find its library, or make theirs on another machine.
    for has_turn in (comm.rank == 0, comm.rank > 0):
        if has_turn:
            try:
                library = _loaded(
                    _Library.of(Path(form.module.__file__), is_single=is_single, columns=columns)
                )
            except (OSError, ValueError, subprocess.CalledProcessError) as error:
                _LOG.info(
                    "no kernels for batches of cells, which is harmless: those of FFCx take "
                    "two to four times as long (%s)",
                    getattr(error, "stderr", None) or error,
                )
        comm.Barrier()
    return library if reductions.everywhere(comm, library is not None) else None


def _loaded(library: _Library) -> ctypes.CDLL:
    """Load a library, which is made first if it is not there.

    Raises:
        OSError: There is no compiler, or the library cannot be loaded.
        ValueError: FFCx's text is not what is expected.
        subprocess.CalledProcessError: The compiler does not understand the source.
    """
    if not library.path.exists():
        (_at_work.pop(library.path, None) or _Compilation(library)).finish()
    return ctypes.CDLL(str(library.path))


def _addresses(library: ctypes.CDLL, name: str, form: fem.Form) -> list[int]:
    """Addresses of functions of a library, one for each integral over cells."""
    number = form.ufcx_form.form_integral_offsets[1]
    functions = [getattr(library, f"{name}_{i}") for i in range(number)]
    return [ctypes.cast(function, ctypes.c_void_p).value or 0 for function in functions]
