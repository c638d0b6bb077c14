"""Atomic replacement of files.

The new content is written to a second file, which is then renamed. Readers find either the complete
old or the complete new file, also if the program was killed.
"""

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import h5py

__all__ = [
    "check_replaceable",
    "created_temporary",
    "hdf5_file_image",
    "replace",
    "sync",
    "take_name",
    "temporary",
    "unchanged",
]


def check_replaceable(*paths: Path) -> None:
    """Check that files can be created or replaced. Local.

    Args:
        paths: Files, which need not exist.

    Raises:
        OSError: A folder has one of the names, or a file is write-protected.
    """
    for path in paths:
        if path.exists() and not (path.is_file() and os.access(path, os.W_OK)):
            raise OSError(f"expected a file that can be replaced, given {path}")


def hdf5_file_image(fill: Callable[[h5py.File], None]) -> memoryview:
    """Content of an HDF5 file that is created in memory. Local.

    Args:
        fill: Writes the datasets.

    Returns:
        The bytes of the file.
    """
    image = io.BytesIO()
    # The driver of HDF5 for files in memory takes four times as long.
    with h5py.File(image, "w") as file:
        fill(file)
    return image.getbuffer()


def replace(path: Path, image: bytes | memoryview, *, durable: bool = False) -> None:
    """Create a file or replace its content atomically. Local.

    Args:
        path: The file; ``.new`` is added to its name for the second file.
        image: The new content.
        durable: Whether to wait until the content is on the disk, so that it survives a power
            failure.

    Raises:
        OSError: The content cannot be written, for instance because the disk is full. A file
            that existed before is unchanged.
    """
    with unchanged(path):
        with created_temporary(path) as file:
            file.write(image)
        take_name(path, durable=durable)


def temporary(path: Path) -> Path:
    """Temporary file with the new content of a file. Local."""
    return path.with_name(f"{path.name}.new")


def created_temporary(path: Path) -> BinaryIO:
    """Create the temporary file for the new content of a file. Local.

    It replaces a temporary file left by a killed run, or a symbolic link, whose target is
    unchanged.

    Args:
        path: The file to be replaced.

    Returns:
        The open file.

    Raises:
        OSError: It cannot be created, for instance because a folder has its name.
    """
    temporary(path).unlink(missing_ok=True)
    return temporary(path).open("xb")


def take_name(path: Path, *, durable: bool = False) -> None:
    """Replace a file by its temporary file atomically. Local.

    Args:
        path: The file.
        durable: Whether to wait until the disk has the new content and the name.
    """
    if durable:
        sync(temporary(path))
    os.replace(temporary(path), path)
    if durable:
        sync(path.parent)


@contextmanager
def unchanged(path: Path, removes: bool = True) -> Iterator[None]:
    """Context that removes the temporary file of a file after an error. Local.

    Args:
        path: The file.
        removes: Whether this rank removes the temporary file.

    Raises:
        OSError: The error of the context, with a note that an existing file is unchanged.
    """
    try:
        yield
    except OSError as error:
        if removes:
            temporary(path).unlink(missing_ok=True)
        kept = "; a file of this name from before is unchanged" if path.exists() else ""
        raise OSError(error.errno, f"{error.strerror}{kept}", str(path)) from None


def sync(*paths: Path) -> None:
    """Wait until the disk has all written data. Local.

    Args:
        paths: Files, and folders for the names of the files in them.

    Raises:
        OSError: The disk reports an error.
    """
    for path in paths:
        file = os.open(path, os.O_RDONLY)
        try:
            os.fsync(file)
        finally:
            os.close(file)
