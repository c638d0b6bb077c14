"""Check of the required packages, with instructions for their installation."""

from importlib.util import find_spec

__all__ = ["check_installation"]

# Providers of DOLFINx with PETSc.
_SOURCES = (
    "conda install -c conda-forge fenics-dolfinx petsc4py (any Linux, macOS), "
    "apt-get install python3-dolfinx-real python3-petsc4py-real (Debian, Ubuntu), or "
    "pip install dolfinx-solver-real (Linux x86_64, Python 3.12 or newer)"
)


def check_installation() -> None:
    """Check that MPI, DOLFINx and PETSc for Python are installed. Local.

    Raises:
        ImportError: One of them is missing.
    """
    needed = ("mpi4py", "dolfinx", "petsc4py")
    missing = [name for name in needed if find_spec(name) is None]
    if missing:
        given = " and ".join(missing)
        raise ImportError(
            f"expected DOLFINx with PETSc for real numbers, given a Python without {given}: "
            f"{_SOURCES}"
        )


check_installation()
