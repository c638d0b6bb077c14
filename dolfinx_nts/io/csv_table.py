"""Table of a run: a CSV file whose rows can be read as soon as they are written."""

import csv
import hashlib
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Array

__all__ = ["Table"]


class Table:
    """CSV file that grows by rows, and that a resumed run continues.

    Local, as all its methods except `serialize`; only rank 0 opens it.

    Args:
        path: The file.

    Attributes:
        path: The file.
        size: Length of the table at the last `sync` [bytes], to which a resumed run truncates the
            file.
        digest: Digest of these bytes, with which a resumed run verifies its table.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: BinaryIO | None = None
        self._written, self._hash = 0, hashlib.sha256()
        self.size, self.digest = self._present()

    def serialize(self, archive: Archive) -> None:
        """Serialize `size` and `digest`. Collective.

        Args:
            archive: Archive that stores values of rank 0, or returns them on all ranks.
        """
        self.size = archive.same("table_size", self.size)
        self.digest = archive.same("table_digest", self.digest)

    def open(self, columns: Sequence[str], resume: bool) -> None:
        """Start a new file, or truncate the existing one to `size` and continue it.

        Args:
            columns: Names of the columns.
            resume: Whether to continue the existing file.

        Raises:
            OSError: The file cannot be created.
            ValueError: The existing file does not begin with the rows that it had, or has other
                columns. It is unchanged.
        """
        self._written, self._hash = 0, hashlib.sha256()
        if not resume:
            self._file = open(self.path, "wb")
            self.size, self.digest = self._present()
            return
        known = b""
        if self.path.exists():
            with open(self.path, "rb") as file:
                known = file.read(self.size)
        self._count(known)
        size, digest = self._present()
        if size < self.size:
            raise ValueError(
                f"expected a table {self.path} of {self.size} bytes or more, which it had at "
                f"the checkpoint, given one of {size} bytes"
            )
        if not np.array_equal(digest, self.digest):
            raise ValueError(
                f"expected a table {self.path} that begins with the rows which it had at the "
                "checkpoint, given other rows; restore the table, or start without resume"
            )
        self._check(columns, known)
        os.truncate(self.path, self.size)
        self._file = open(self.path, "ab")

    def write(self, row: Mapping[str, float]) -> None:
        """Add a row, preceded in a new file by a header with the names.

        Args:
            row: Values by name, with the same names in each row.

        Raises:
            OSError: The row cannot be written, for instance because the disk is full.
        """
        assert self._file is not None
        text = io.StringIO(newline="")
        if not self._written:
            csv.writer(text).writerow(row)
        # Numbers need no quotes; the writer of the standard library is slower.
        text.write(f"{','.join(map(str, row.values()))}\r\n")
        data = text.getvalue().encode()
        self._file.write(data)
        self._file.flush()
        self._count(data)

    def sync(self) -> None:
        """Wait until the disk has the rows, and set `size` and `digest`."""
        assert self._file is not None
        os.fsync(self._file.fileno())
        self.size, self.digest = self._present()

    def close(self) -> None:
        """Close the file, if it is open."""
        if self._file is not None:
            self._file.close()

    def _check(self, columns: Sequence[str], known: bytes) -> None:
        """Check the columns of the existing rows, if any."""
        lines = known.decode().splitlines()
        former = next(csv.reader(lines), list(columns))
        if former != list(columns):
            less, more = set(former) - set(columns), set(columns) - set(former)
            raise ValueError(
                f"expected the columns of {self.path}, given a run that lacks "
                f"{sorted(less)[:3] or 'none'} and adds {sorted(more)[:3] or 'none'}: record what "
                "the table has, or start without resume"
            )

    def _count(self, data: bytes) -> None:
        self._written += len(data)
        self._hash.update(data)

    def _present(self) -> tuple[int, Array]:
        """Length [bytes] and digest of all rows so far."""
        return self._written, np.frombuffer(self._hash.digest(), dtype=np.uint8)
