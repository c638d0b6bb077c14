"""Compiles and loads kernels for batches of cells."""

import ctypes
import logging
import os
import shlex
import subprocess
import sysconfig
import tempfile
from hashlib import sha256
from pathlib import Path

from dolfinx import fem

from dolfinx_nts._kernels import BatchKernel
from dolfinx_nts.fem.batched_source import batched_source
from dolfinx_nts.fem.jit import OPTIMISED
from dolfinx_nts.parallel import reductions

__all__ = ["batched_kernels"]

_LOG = logging.getLogger(__name__)
_HEADERS = [Path(__file__).with_name(name) for name in ("lanes.h", "trilinear.h")]
_SINGLE = ["-DNTS_SINGLE", "-fsingle-precision-constant"]


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
    comm = form.mesh.comm
    kernels: list[BatchKernel] | None = None
    # The first rank compiles. Others find its library, or make theirs on another machine.
    for has_turn in (comm.rank == 0, comm.rank > 0):
        if has_turn:
            try:
                kernels = _kernels(Path(form.module.__file__), is_single=is_single)
            except (OSError, ValueError, subprocess.CalledProcessError) as error:
                _LOG.info(
                    "no kernels for batches of cells, which is harmless: those of FFCx take "
                    "two to four times as long (%s)",
                    getattr(error, "stderr", None) or error,
                )
        comm.Barrier()
    return kernels if reductions.everywhere(comm, kernels is not None) else None


def _kernels(module: Path, *, is_single: bool) -> list[BatchKernel]:
    """Kernels of the form in a module of FFCx.

    Raises:
        OSError: There is no text, no compiler, or the library cannot be loaded.
        ValueError: The text is not what is expected.
        subprocess.CalledProcessError: The compiler does not understand the result.
    """
    name = module.name.split(".")[0]
    source = batched_source(module.with_name(f"{name}.c").read_text())
    compiler = os.environ.get("CXX") or sysconfig.get_config_var("CXX") or "c++"
    flags = [*OPTIMISED, *(_SINGLE if is_single else [])]
    command = [*shlex.split(compiler), *flags, "-std=c++17", "-fPIC", "-shared"]
    texts = [source, " ".join(command), *(header.read_text() for header in _HEADERS)]
    digest = sha256("".join(texts).encode()).hexdigest()[:16]
    path = module.with_name(f"{name}-{digest}.so")
    if not path.exists():
        _compile(command, source, path)
    library = ctypes.CDLL(str(path))
    lanes = ctypes.c_int.in_dll(library, "num_lanes").value
    number = source.count('extern "C" void batch_')
    functions = [getattr(library, f"batch_{i}") for i in range(number)]
    return [
        BatchKernel(ctypes.cast(function, ctypes.c_void_p).value or 0, lanes, is_single)
        for function in functions
    ]


def _compile(command: list[str], source: str, path: Path) -> None:
    """Compile a library, which is there completely or not at all."""
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        text, library = Path(folder) / "batch.cpp", Path(folder) / "batch.so"
        text.write_text(source)
        include = f"-I{_HEADERS[0].parent}"
        subprocess.run(
            [*command, include, str(text), "-o", str(library), "-lm"],
            check=True,
            capture_output=True,
            text=True,
        )
        library.replace(path)
