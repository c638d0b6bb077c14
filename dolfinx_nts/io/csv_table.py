"""Table of a run: a CSV file whose rows are on disk at once."""

import csv
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TextIO

from dolfinx_nts.common.archive import Archive

__all__ = ["Table"]


class Table:
    """A CSV file that grows by rows and can go on after one. Local.

    Args:
        path: The file.

    Attributes:
        size: Bytes at the last `sync`, after which a resumed table goes on.
    """

    def __init__(self, path: Path) -> None:
        """Name the file; nothing is created yet."""
        self._path, self.size = path, 0
        self._file: TextIO | None = None
        self._has_head = False

    def serialize(self, archive: Archive) -> None:
        """Serialize `size`. Collective.

        Args:
            archive: Takes the size of rank 0 or gives it to all.
        """
        self.size = archive.same("table_size", self.size)

    def open(self, resume: bool) -> None:
        """Replace the file, or cut it back to `size` and go on.

        Args:
            resume: Whether to go on.

        Raises:
            OSError: The file cannot be created.
            ValueError: The file to go on is shorter than `size`; it has not
                been changed.
        """
        self._has_head = resume
        if not resume:
            self._file = open(self._path, "w", newline="", encoding="utf-8")
            return
        size = self._path.stat().st_size if self._path.exists() else 0
        if size < self.size:
            raise ValueError(
                f"expected a table {self._path} of {self.size} bytes or more, which it had at "
                f"the checkpoint, given one of {size}"
            )
        os.truncate(self._path, self.size)
        self._file = open(self._path, "a", newline="", encoding="utf-8")

    def write(self, row: Mapping[str, float]) -> None:
        """Add a row, before the first one of a new file the names.

        Args:
            row: Values by name, the same names in each row.
        """
        assert self._file is not None
        rows = csv.writer(self._file)
        if not self._has_head:
            rows.writerow(row)
        rows.writerow(row.values())
        self._has_head = True
        self._file.flush()

    def sync(self) -> None:
        """Bring the rows to the disk itself."""
        assert self._file is not None
        os.fsync(self._file.fileno())
        self.size = os.fstat(self._file.fileno()).st_size

    def close(self) -> None:
        """Close the file, if it is open."""
        if self._file is not None:
            self._file.close()
