"""File that a process which is killed at any instant leaves whole.

HDF5 changes a file in many places for one new dataset, and a file in which
some of the changes are missing cannot be read. So what it writes is kept
until `JournaledFile.commit`: what is new goes to the end of the file, where
nothing refers to it yet; what replaces something goes to a journal, then to
its place. The next one that opens the file goes on with a journal that is there.
"""

import os
import struct
from pathlib import Path

__all__ = ["JournaledFile"]

_ENTRY = struct.Struct("<qq")  # place in the file and length [bytes]


class JournaledFile:
    """Binary file with the methods that h5py needs. Local.

    Args:
        path: The file; the journal lies beside it.
        new: Begin with an empty file instead of the one that is there.

    Raises:
        OSError: The file cannot be opened.
    """

    def __init__(self, path: Path, *, new: bool) -> None:
        """Open the file; finish the last commit of a process that was killed."""
        self._journal = path.with_name(f"{path.name}.journal")
        if new:
            self._journal.unlink(missing_ok=True)
        self._file = os.open(path, os.O_RDWR | (os.O_CREAT | os.O_TRUNC if new else 0))
        if self._journal.exists():
            self._apply(self._entries())
        self._size = self._committed = os.fstat(self._file).st_size
        self._at = 0
        self._pending: list[tuple[int, bytes]] = []
        self._broken = False

    def commit(self) -> None:
        """Bring to the file what has been written since the last commit.

        Raises:
            OSError: The disk is full, for instance. What has been committed
                before is as it was, and nothing is written any more.
        """
        if self._broken:
            return
        try:
            self._commit()
        except OSError:
            self._broken = True
            raise

    def close(self) -> None:
        """Close the file; what has not been committed is lost."""
        os.close(self._file)

    def _commit(self) -> None:
        if self._size > self._committed:
            # A full disk shows here, before anything is changed.
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(self._file, 0, self._size)
            os.truncate(self._file, self._size)
        inside = [entry for entry in self._pending if entry[0] < self._committed]
        for place, data in self._pending:
            if place >= self._committed:
                self._put(place, data)
        if inside:
            beside = self._journal.with_name(f"{self._journal.name}.new")
            try:
                with open(beside, "wb") as journal:
                    for place, data in inside:
                        journal.write(_ENTRY.pack(place, len(data)) + data)
                os.replace(beside, self._journal)
            except OSError:
                beside.unlink(missing_ok=True)
                raise
            self._apply(inside)
        os.truncate(self._file, self._size)
        self._committed, self._pending = self._size, []

    def _apply(self, entries: list[tuple[int, bytes]]) -> None:
        for place, data in entries:
            self._put(place, data)
        self._journal.unlink()

    def _put(self, place: int, data: bytes) -> None:
        done = 0
        while done < len(data):
            done += os.pwrite(self._file, data[done:], place + done)

    def _entries(self) -> list[tuple[int, bytes]]:
        """Entries of the journal that is there."""
        text, at, entries = self._journal.read_bytes(), 0, []
        while at < len(text):
            place, length = _ENTRY.unpack_from(text, at)
            at += _ENTRY.size + length
            entries.append((place, text[at - length : at]))
        return entries

    # --- what h5py calls ------------------------------------------------

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place; returns it."""
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        self._at = start + offset
        return self._at

    def tell(self) -> int:
        """Present place."""
        return self._at

    def read(self, size: int) -> bytes:
        """Read, also what has not been committed."""
        first = self._at
        found = bytearray(os.pread(self._file, size, first).ljust(size, b"\0"))
        for place, data in self._pending:
            low, high = max(first, place), min(first + size, place + len(data))
            if low < high:
                found[low - first : high - first] = data[low - place : high - place]
        self._at += size
        return bytes(found)

    def write(self, data: bytes) -> int:
        """Keep what is written for the next commit."""
        self._pending.append((self._at, bytes(data)))
        self._at += len(data)
        self._size = max(self._size, self._at)
        return len(data)

    def truncate(self, size: int) -> int:
        """Set the size; takes effect with the next commit."""
        self._pending = [
            (place, data[: size - place]) for place, data in self._pending if place < size
        ]
        self._size = size
        return size

    def flush(self) -> None:
        """Do nothing: HDF5 calls it in the middle of what belongs together."""
