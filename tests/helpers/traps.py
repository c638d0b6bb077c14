"""Floating-point traps: with them, a bad operation ends the process where it happens.

    NTS_TRAPS=1 python3 -m pytest ...

A division by zero and an overflow are trapped in all that runs in a test, an
invalid operation in the kernels and, as `FloatingPointError`, in NumPy. (To
compare with NaN, the gap of a node that faces nothing, is invalid as well, and
NumPy may do so.) Where PETSc builds a preconditioner, multigrid for instance,
where LAPACK computes singular values, and where VTK and Matplotlib draw, which
divide by zero, nothing is trapped. The values are for x86.
"""

import ctypes
import functools
import os
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from dolfinx_nts import _kernels, plotting
from dolfinx_nts.solvers.precond.preconditioner import BulkPreconditioner

__all__ = ["WANTED", "trapped"]

WANTED = os.environ.get("NTS_TRAPS") == "1"
if WANTED and platform.machine() != "x86_64":
    raise RuntimeError(f"expected x86_64 for NTS_TRAPS=1, given {platform.machine()}")

_INVALID, _DIVIDE_BY_ZERO, _OVERFLOW = 0x1, 0x4, 0x8
_ALL = _INVALID | _DIVIDE_BY_ZERO | _OVERFLOW


def _set(flags: int) -> int:
    """Set the trapped exceptions; return the previous ones."""
    libm = ctypes.CDLL("libm.so.6")
    former: int = libm.fegetexcept()
    # Exceptions raised before do not count.
    libm.feclearexcept(_ALL)
    libm.fedisableexcept(_ALL & ~flags)
    libm.feenableexcept(flags)
    return former


@contextmanager
def trapped(flags: int = _DIVIDE_BY_ZERO | _OVERFLOW) -> Iterator[None]:
    """Context manager that enables traps."""
    former = _set(flags)
    try:
        with np.errstate(all="raise", under="ignore"):
            yield
    finally:
        _set(former)


def untrapped(function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a function to run without traps."""

    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        former = _set(0)
        try:
            return function(*arguments, **named)
        finally:
            _set(former)

    return call


def strict(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a kernel to run with all traps if traps are enabled around it."""

    @functools.wraps(kernel)
    def call(*arguments: Any) -> Any:
        former = _set(0)
        _set(_ALL if former else 0)
        try:
            return kernel(*arguments)
        finally:
            _set(former)

    return call


if WANTED:
    BulkPreconditioner.build = untrapped(BulkPreconditioner.build)
    for name in ("cond", "svd"):
        setattr(np.linalg, name, untrapped(getattr(np.linalg, name)))
    for name in set(plotting.__all__) - {"Picture"}:
        setattr(plotting, name, untrapped(getattr(plotting, name)))
    for name in dir(_kernels):
        if not isinstance(kernel := getattr(_kernels, name), type) and callable(kernel):
            setattr(_kernels, name, strict(kernel))
