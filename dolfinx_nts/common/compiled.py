"""Use of the compiled module of the installed package in a source folder without one.

``pip install .`` in a clone compiles into the installed package, but a script that is run in the
clone imports the sources there. These use the installed module if it was compiled from the same
sources.
"""

import sys
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path

__all__: list[str] = []

# File in the installed package: digest and name of each C++ source.
_SOURCES = "_kernels.sha256"


def _installed(folder: Path) -> Path:
    """Folder of the installed package if it was compiled from these sources. Local.

    Raises:
        ImportError: No package is installed, or it was compiled from other sources.
    """
    install = f"run 'pip install .' in {folder.parent}"
    try:
        other = Path(str(distribution("dolfinx_nts").locate_file("dolfinx_nts")))
    except PackageNotFoundError:
        raise ImportError(
            f"expected the compiled module of dolfinx_nts, given its sources in {folder} alone: "
            f"{install}, or start the script by 'environment/run python3 ...' there"
        ) from None
    record = other / _SOURCES
    if not record.exists() or record.read_text() != _digests(folder / "cpp"):
        raise ImportError(
            f"expected a compiled module of the sources in {folder}, given one of other sources "
            f"in {other}: {install} again, or run the script outside of this folder"
        )
    return other


def _digests(folder: Path) -> str:
    """Digest and name of each C++ source in a folder, as CMake writes them."""
    files = (p for p in folder.rglob("*") if p.suffix in (".h", ".cpp"))
    names = sorted(file.relative_to(folder).as_posix() for file in files)
    return "".join(f"{sha256((folder / name).read_bytes()).hexdigest()} {name}\n" for name in names)


if find_spec("dolfinx_nts._kernels") is None:
    sys.modules["dolfinx_nts"].__path__.append(str(_installed(Path(__file__).parents[1])))
