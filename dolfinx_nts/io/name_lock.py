"""Lock that prevents other runs from writing to files of the same name.

The operating system releases the lock when the process ends for any reason. A file left by a killed
process does not lock. Files of other programs are left unchanged, and symbolic links are not
followed.
"""

import errno
import fcntl
import logging
import os
import re
import socket
import stat
import time
from pathlib import Path

__all__ = ["NameLock"]

_logger = logging.getLogger("dolfinx_nts")

# Longest text that identifies the holder of a lock [bytes].
_LONGEST = 500
# Text of a file that is a lock of this package.
_OWN = re.compile(r"process \d+ on \S+ since ")


class NameLock:
    """File that is locked during a run. Local, as all its methods; only rank 0 acquires the lock.

    Args:
        path: The file, which exists while the lock is held and names its holder.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: int | None = None

    def take(self) -> None:
        """Acquire the lock, or warn if the file system has no locks.

        Raises:
            OSError: Another run holds it, the file is not a lock of this package, or it cannot be
                created.
        """
        now = time.strftime("%Y-%m-%d %H:%M:%S")
        text = f"process {os.getpid()} on {socket.gethostname()} since {now}".encode()
        while self._file is None:
            try:
                file, is_new = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666), True
            except FileExistsError:
                try:
                    file, is_new = self._existing(), False
                except FileNotFoundError:  # removed by another run that has just ended
                    continue
            try:
                self._lock(file, is_new)
                # Another run that has just ended may have removed the file in the meantime.
                if self._is_there(file):
                    os.pwrite(file, text, 0)
                    os.truncate(file, len(text))
                    self._file = file
            finally:
                if self._file is None:
                    os.close(file)

    def _existing(self) -> int:
        """Open the existing file."""
        try:
            # Non-blocking, in case the file is a pipe.
            file = os.open(self._path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
        except OSError as error:
            if error.errno == errno.ELOOP:
                raise self._foreign("is a symbolic link") from None
            raise
        if not stat.S_ISREG(os.fstat(file).st_mode):
            os.close(file)
            raise self._foreign("is no file")
        return file

    def _lock(self, file: int, is_new: bool) -> None:
        """Lock an open file, unless it belongs to another program."""
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.pread(file, _LONGEST, 0).decode(errors="replace")
            if not _OWN.match(holder):
                holder = "another process"
            raise OSError(
                f"expected files that no other run writes to, given "
                f"{self._path.with_suffix('')}, which belong to {holder}; choose another "
                "name, or end that process on its host"
            ) from None
        except OSError as error:
            _logger.warning(
                "%s cannot be locked: %s; this is harmless as long as you start no second "
                "run that writes to files of this name",
                self._path,
                error.strerror,
            )
        if not (is_new or _OWN.match(os.pread(file, _LONGEST, 0).decode(errors="replace"))):
            raise self._foreign("was not made by a run")

    def _foreign(self, why: str) -> OSError:
        return OSError(
            f"expected no file {self._path}, which a run makes and removes, given one that {why}: "
            "choose another name for the run, or remove that file if nobody needs it"
        )

    def release(self) -> None:
        """Release the lock, if it is held, and remove the file."""
        if self._file is not None:
            self._path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = None

    def _is_there(self, file: int) -> bool:
        """Whether the path still refers to the open file."""
        try:
            return os.path.samestat(os.fstat(file), self._path.lstat())
        except FileNotFoundError:
            return False
