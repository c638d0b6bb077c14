"""Lock by which a run keeps other runs from writing to files of the same name.

The operating system holds the lock for the process that has taken it, and releases it when this
process ends in whatever way. A file that a killed process has left locks nothing.
"""

import fcntl
import logging
import os
import socket
import time
from pathlib import Path

__all__ = ["NameLock"]

_logger = logging.getLogger("dolfinx_nts")

# Longest text that tells who holds a lock [bytes].
_LONGEST = 500


class NameLock:
    """File that is locked during a run. Local, as all its methods; only rank 0 takes it.

    Args:
        path: The file, which is there while the lock is held; it tells who holds it.
    """

    def __init__(self, path: Path) -> None:
        """Remember the name of the file; `take` creates it."""
        self._path = path
        self._file: int | None = None

    def take(self) -> None:
        """Take the lock. Where the file system has no locks, a warning tells so.

        Raises:
            OSError: Another run holds it, or the file cannot be created.
        """
        while self._file is None:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                holder = os.read(file, _LONGEST).decode(errors="replace") or "another process"
                os.close(file)
                raise OSError(
                    f"expected files that no other run writes to, given "
                    f"{self._path.with_suffix('')}, which belong to {holder}; choose another "
                    "name, or end that process"
                ) from None
            except OSError as error:
                _logger.warning(
                    "%s cannot be locked: %s; this is harmless as long as you start no second "
                    "run that writes to files of this name",
                    self._path,
                    error.strerror,
                )
            # A run that has just ended may have removed the file in between.
            if self._is_there(file):
                self._file = file
            else:
                os.close(file)
        os.truncate(self._file, 0)
        now = time.strftime("%Y-%m-%d %H:%M:%S")
        text = f"process {os.getpid()} on {socket.gethostname()} since {now}"
        os.write(self._file, text.encode())

    def release(self) -> None:
        """Release the lock, if it is held, and remove the file."""
        if self._file is not None:
            self._path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = None

    def _is_there(self, file: int) -> bool:
        """Whether an open file still has its name."""
        try:
            return os.path.samestat(os.fstat(file), self._path.stat())
        except FileNotFoundError:
            return False
