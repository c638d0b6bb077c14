"""Files that are replaced as a whole, in one instant.

The new content is written to a second file, which then takes the name of the first. A reader,
and a program that is started again after it was killed, find either the former file or the new
one, never a part of one.
"""

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import h5py

__all__ = [
    "beside",
    "check_replaceable",
    "created_beside",
    "hdf5_file_image",
    "replace",
    "sync",
    "take_name",
    "unchanged",
]


def check_replaceable(*paths: Path) -> None:
    """Refuse names under which no file can be written. Local.

    Args:
        paths: Files, which need not exist.

    Raises:
        OSError: A folder has one of the names, or a file is write-protected.
    """
    for path in paths:
        if path.exists() and not (path.is_file() and os.access(path, os.W_OK)):
            raise OSError(f"expected a file that can be replaced, given {path}")


def hdf5_file_image(fill: Callable[[h5py.File], None]) -> memoryview:
    """Content of an HDF5 file, which is made in memory. Local.

    Args:
        fill: Writes into the file.

    Returns:
        The bytes of the file.
    """
    image = io.BytesIO()
    # The driver of HDF5 for files in memory takes four times as long.
    with h5py.File(image, "w") as file:
        fill(file)
    return image.getbuffer()


def replace(path: Path, image: bytes | memoryview, *, durable: bool = False) -> None:
    """Give a file a new content in one instant, or create it. Local.

    Args:
        path: The file; ``.new`` is added to its name for the second file.
        image: The new content.
        durable: Also wait until the disk has it, so that it survives a power failure.

    Raises:
        OSError: The content cannot be written, for instance because the disk is full. A file
            that existed before is unchanged.
    """
    with unchanged(path):
        with created_beside(path) as file:
            file.write(image)
        take_name(path, durable=durable)


def beside(path: Path) -> Path:
    """File in which the new content of another one is made. Local."""
    return path.with_name(f"{path.name}.new")


def created_beside(path: Path) -> BinaryIO:
    """Create the file in which the new content of another one is made. Local.

    It takes the place of one that a killed run has left, and of a symbolic link, whose target
    stays as it is.

    Args:
        path: The other file.

    Returns:
        The open file.

    Raises:
        OSError: It cannot be created, for instance because a folder has its name.
    """
    beside(path).unlink(missing_ok=True)
    return beside(path).open("xb")


def take_name(path: Path, *, durable: bool = False) -> None:
    """Give a file the content that lies beside it, in one instant. Local.

    Args:
        path: The file.
        durable: Also wait until the disk has the new content and the name.
    """
    if durable:
        sync(beside(path))
    os.replace(beside(path), path)
    if durable:
        sync(path.parent)


@contextmanager
def unchanged(path: Path, removes: bool = True) -> Iterator[None]:
    """Context after whose errors nothing lies beside a file. Local.

    Args:
        path: The file.
        removes: Whether this rank removes what lies there.

    Raises:
        OSError: That of the context. Where the file exists, it says that the file is unchanged.
    """
    try:
        yield
    except OSError as error:
        if removes:
            beside(path).unlink(missing_ok=True)
        kept = "; a file of this name from before is unchanged" if path.exists() else ""
        raise OSError(error.errno, f"{error.strerror}{kept}", str(path)) from None


def sync(*paths: Path) -> None:
    """Wait until the disk has what was written. Local.

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
