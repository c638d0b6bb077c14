"""Folder with the values of the fields of a run."""

import itertools
import os
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from mpi4py import MPI

from dolfinx_nts.io.atomic_file import check_replaceable, sync
from dolfinx_nts.io.shared_file import write_hdf5
from dolfinx_nts.parallel.slabs import Slab

__all__ = ["FieldsFolder"]


class FieldsFolder:
    """Folder ``run_fields`` next to ``run.xdmf`` or ``run.vtkhdf``.

    Files in it are created atomically. All methods except `write` are for rank 0.

    Args:
        index: The file that refers to the folder.
        own: Pattern of the file names of the run; other files are left unchanged.

    Attributes:
        path: The folder.
    """

    def __init__(self, index: Path, own: re.Pattern[str]) -> None:
        self.path = index.with_name(f"{index.stem}_fields")
        self._index, self._own = index, own
        self._unsynced: list[Path] = []

    def check(self) -> None:
        """Check that the folder and its files can be written.

        Raises:
            OSError: One of them cannot be replaced.
        """
        folder = self.path
        if folder.exists() and not (folder.is_dir() and os.access(folder, os.W_OK)):
            raise OSError(f"expected a folder in which files can be replaced, given {folder}")
        check_replaceable(self._index, *self.files(self._own))

    def files(self, names: re.Pattern[str]) -> list[Path]:
        """Files of the folder with matching names."""
        files = self.path.iterdir() if self.path.is_dir() else ()
        return [path for path in files if names.fullmatch(path.name)]

    def begin(self, kept: Collection[str]) -> None:
        """Create the folder, and remove own files except ``kept``."""
        self._unsynced = []
        for path in self.files(self._own):
            if path.name not in kept:
                path.unlink()
        self.path.mkdir(exist_ok=True)

    def write(
        self,
        comm: MPI.Intracomm,
        name: str,
        arrays: Mapping[str, Sequence[Slab]],
        attributes: Mapping[str, float | Sequence[float]],
    ) -> None:
        path = self.path / name
        write_hdf5(comm, path, arrays, attributes)
        if comm.rank == 0:
            self._unsynced.append(path)

    def sync(self) -> None:
        """Wait until the disk has all files, so that they survive a power failure."""
        sync(*self._unsynced, self.path, self._index, self._index.parent)
        self._unsynced = []

    def move_aside(self) -> str:
        """Rename the folder; returns a text with the new name."""
        if not self.path.exists():
            return f"as there is no folder {self.path}"
        names = (f"{self.path.name}.damaged{n}" for n in itertools.count(1))
        aside = next(p for p in map(self.path.with_name, names) if not p.exists())
        self.path.rename(aside)
        return f"and the earlier ones were moved to {aside}"
