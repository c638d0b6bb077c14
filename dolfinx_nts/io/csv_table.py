"""Table of a run: a CSV file in which each row can be read as soon as it is written."""

import csv
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TextIO

from dolfinx_nts.common.archive import Archive

__all__ = ["Table"]


class Table:
    """CSV file that grows by rows, and that a resumed run continues.

    Local, as all its methods except `serialize`; only rank 0 opens it.

    Args:
        path: The file.

    Attributes:
        path: The file.
        size: Length of the file when `sync` was called last [bytes]. A resumed run cuts the
            file to it.
    """

    def __init__(self, path: Path) -> None:
        """Remember the name of the file; `open` creates it."""
        self.path, self.size = path, 0
        self._file: TextIO | None = None
        self._has_head = False

    def serialize(self, archive: Archive) -> None:
        """Serialize `size`. Collective.

        Args:
            archive: Takes the size that rank 0 has, or gives it to all ranks.
        """
        self.size = archive.same("table_size", self.size)

    def open(self, resume: bool) -> None:
        """Begin a new file, or cut the existing one to `size` and continue it.

        Args:
            resume: Whether to continue the existing file.

        Raises:
            OSError: The file cannot be created.
            ValueError: The file to continue is shorter than `size`. It has not been changed.
        """
        self._has_head = resume
        if not resume:
            self._file, self.size = open(self.path, "w", newline="", encoding="utf-8"), 0
            return
        size = self.path.stat().st_size if self.path.exists() else 0
        if size < self.size:
            raise ValueError(
                f"expected a table {self.path} of {self.size} bytes or more, which it had at "
                f"the checkpoint, given one of {size}"
            )
        os.truncate(self.path, self.size)
        self._file = open(self.path, "a", newline="", encoding="utf-8")

    def write(self, row: Mapping[str, float]) -> None:
        """Add a row; the first row of a new file comes after one with the names.

        Args:
            row: Values by name, with the same names in each row.

        Raises:
            OSError: The row cannot be written, for instance because the disk is full.
        """
        assert self._file is not None
        rows = csv.writer(self._file)
        if not self._has_head:
            rows.writerow(row)
        rows.writerow(row.values())
        self._has_head = True
        self._file.flush()

    def sync(self) -> None:
        """Wait until the disk has the rows, and set `size`."""
        assert self._file is not None
        os.fsync(self._file.fileno())
        self.size = os.fstat(self._file.fileno()).st_size

    def close(self) -> None:
        """Close the file, if it is open."""
        if self._file is not None:
            self._file.close()
