"""Cache of compiled forms, safe against interrupted compilations and other processors.

FFCx creates an empty C file before it compiles a form, and a file ``.c.cached`` afterwards. A
process that finds the first file without the second one waits for the compiling process, even if
this was killed. Here the compiling process holds a lock, which the operating system releases when
the process ends for any reason.
"""

import fcntl
import platform
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

__all__ = ["interrupted_forms_compiled", "processor"]

# File in the cache; each form locks one byte of it.
_LOCKS = "dolfinx_nts.lock"
_CPUS = "/proc/cpuinfo"


@cache
def processor() -> str:
    """Digest of the instructions that the processor has. Local.

    Compiled code may crash on another processor with the same cache, such as another node of a
    cluster.
    """
    words = [platform.machine(), platform.processor()]
    with suppress(OSError), open(_CPUS) as cpus:
        # Lines of the first core: "flags" on x86-64, "Features" on ARM, "isa" on RISC-V.
        for line in cpus:
            name, _, value = line.partition(":")
            if name.strip() in ("flags", "Features", "isa"):
                words += sorted(value.split())
                break
    return sha256(" ".join(words).encode()).hexdigest()[:12]


@contextmanager
def interrupted_forms_compiled() -> Iterator[None]:
    """Context in which FFCx compiles forms again whose compilation was interrupted. Local.

    If several processes request a form, one compiles it and the others wait. Use it only with
    compiler flags specific to the package, as other programs compile without the lock. It has no
    effect if the file system has no locks.
    """
    jit: Any = import_module("ffcx.codegeneration.jit")
    look_up: Any = jit.get_cached_module
    with ExitStack() as lock:

        def get_cached_module(name: str, objects: Any, folder: Any, *rest: Any) -> Any:
            lock.close()  # The previous form is complete.
            source = Path(folder, f"{name}.c")
            if not _is_complete(source):
                with suppress(OSError):
                    lock.enter_context(_locked(source))
                    if not _is_complete(source):
                        source.unlink(missing_ok=True)
            return look_up(name, objects, folder, *rest)

        jit.get_cached_module = get_cached_module
        try:
            yield
        finally:
            jit.get_cached_module = look_up


def _is_complete(source: Path) -> bool:
    return source.with_suffix(".c.cached").exists()


@contextmanager
def _locked(source: Path) -> Iterator[None]:
    """Context that waits for the lock of a C file and holds it.

    Raises:
        OSError: The file system has no locks.
    """
    source.parent.mkdir(parents=True, exist_ok=True)
    with open(source.parent / _LOCKS, "a") as file:
        offset = int.from_bytes(sha256(source.name.encode()).digest()[:7], "big")
        fcntl.lockf(file, fcntl.LOCK_EX, 1, offset)
        yield
