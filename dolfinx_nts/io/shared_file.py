"""HDF5 files that all ranks write together.

Rank 0 creates the layout of the file with contiguous arrays without values, and broadcasts their
offsets. Then each rank writes its rows by MPI, without HDF5, so that a parallel build of h5py is
not needed. No rank gathers the data. The file is replaced atomically, see `atomic_file.replace`.
"""

import errno
import io
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

from mpi4py import MPI

import h5py
import numpy as np

from dolfinx_nts.io.atomic_file import created_temporary, take_name, temporary, unchanged
from dolfinx_nts.parallel.communication import on_root
from dolfinx_nts.parallel.errors import agreed
from dolfinx_nts.parallel.slabs import Slab

__all__ = ["write_hdf5"]


def write_hdf5(
    comm: MPI.Intracomm,
    path: Path,
    arrays: Mapping[str, Sequence[Slab]],
    attributes: Mapping[str, str | float | Sequence[float]],
    *,
    durable: bool = False,
) -> None:
    """Create an HDF5 file or replace it atomically. Collective.

    Args:
        comm: Communicator.
        path: The file; ``.new`` is added to its name until it is complete.
        arrays: Datasets by name, each the concatenation of its slabs. A name may contain slashes
            for groups. A rank may omit arrays without rows on it.
        attributes: Attributes of the file; rank 0 provides them.
        durable: Whether to wait until the content is on the disk, so that it survives a power
            failure.

    Raises:
        OSError: The content cannot be written, for instance because the disk is full. A file
            that existed before is unchanged.
    """
    mine = {name: (_shape(slabs), slabs[0].dtype.str) for name, slabs in arrays.items()}
    every: list[Any] | None = comm.gather(mine)
    image = _SparseImage()

    def lay_out() -> dict[str, int]:
        shapes = {name: shape for part in every or () for name, shape in part.items()}
        offsets = _create_layout(image, shapes, attributes)
        with created_temporary(path) as file:
            file.truncate(image.size)
        return offsets

    with unchanged(path, comm.rank == 0):
        offsets = on_root(comm, lay_out)
        pieces = chain(image.pieces, _pieces(arrays, offsets))
        _write(comm, temporary(path), pieces, durable)
        on_root(comm, lambda: take_name(path, durable=durable))


def _shape(slabs: Sequence[Slab]) -> tuple[int, ...]:
    """Shape of the concatenation of slabs."""
    first = slabs[0].shape
    return (len(slabs) * first[0], *first[1:]) if first else ()


def _create_layout(
    image: "_SparseImage", shapes: Mapping[str, tuple[tuple[int, ...], str]], attributes: Any
) -> dict[str, int]:
    """Create the layout of an HDF5 file; returns the offsets of its arrays [bytes]."""
    offsets = {}
    parents = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    parents.set_create_intermediate_group(True)
    in_one_piece = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    in_one_piece.set_obj_track_times(False)  # files with the same content are identical
    in_one_piece.set_layout(h5py.h5d.CONTIGUOUS)
    in_one_piece.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    in_one_piece.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    with h5py.File(image, "w") as file:
        for name, (shape, dtype) in shapes.items():
            kind = h5py.h5t.py_create(np.dtype(dtype), logical=True)
            space = h5py.h5s.create_simple(shape) if shape else h5py.h5s.create(h5py.h5s.SCALAR)
            dataset = h5py.h5d.create(
                file.id, name.encode(), kind, space, dcpl=in_one_piece, lcpl=parents
            )
            # An empty array has no offset.
            offsets[name] = dataset.get_offset() or 0
        file.attrs.update(attributes)
    return offsets


def _pieces(
    arrays: Mapping[str, Sequence[Slab]], offsets: Mapping[str, int]
) -> Iterator[tuple[int, Any]]:
    """Blocks written by this rank: offsets in the file [bytes], and data."""
    for name, slabs in arrays.items():
        for number, slab in enumerate(slabs):
            values = np.ascontiguousarray(slab.values)
            if values.size:
                size = values.dtype.itemsize * int(np.prod(values.shape[1:], dtype=int))
                row = number * slab.length + slab.begin
                yield offsets[name] + size * row, values.reshape(-1).view(np.uint8)


def _write(
    comm: MPI.Intracomm, path: Path, pieces: Iterable[tuple[int, Any]], durable: bool
) -> None:
    """Write bytes into a file. Collective."""
    if comm.size == 1:
        with path.open("r+b") as alone:
            for offset, data in pieces:
                _put(alone, offset, data)
        return
    # Opened by MPI, which also supports file systems that are not coherent between hosts.
    with agreed(comm, f"open {path}"), _as_os_error(path):
        file = MPI.File.Open(comm, path, MPI.MODE_WRONLY)
    try:
        with agreed(comm, f"write {path}"):
            for offset, data in pieces:
                with _as_os_error(path, offset, data):
                    file.Write_at(offset, data)
        if durable:
            file.Sync()
    finally:
        file.Close()


@contextmanager
def _as_os_error(path: Path, offset: int = 0, data: Any = b"") -> Iterator[None]:
    """Context that converts errors of MPI to errors of the operating system. Local.

    Many MPI libraries do not report the reason. Repeating the write without MPI reveals it.
    """
    try:
        yield
    except MPI.Exception as error:
        if not path.parent.is_dir():
            reason = "a rank has no access to this folder, but all ranks write the file together"
            raise OSError(errno.EIO, reason) from None
        try:
            with path.open("r+b") as file:
                _put(file, offset, data)
        except OSError as known:
            raise OSError(known.errno, known.strerror) from None
        free = shutil.disk_usage(path.parent).free
        reason = f"{error.error_string}, with {free} bytes free in this folder"
        raise OSError(errno.EIO, reason) from None


def _put(file: BinaryIO, offset: int, data: Any) -> None:
    """Write bytes into a file. Local."""
    file.seek(offset)
    file.write(data)


class _SparseImage(io.RawIOBase):
    """Sparse file in memory for HDF5. Local, as all its methods.

    Attributes:
        pieces: Written data by offset [bytes].
        size: Length of the file [bytes].
    """

    def __init__(self) -> None:
        super().__init__()
        self.pieces: list[tuple[int, bytes]] = []
        self.size, self._at = 0, 0

    def seek(self, offset: int, whence: int = 0) -> int:
        """Set the position relative to start, current position or end."""
        self._at = offset + (0, self._at, self.size)[whence]
        return self._at

    def tell(self) -> int:
        """Current position."""
        return self._at

    def write(self, data: Any) -> int:
        """Store data."""
        self.pieces.append((self._at, bytes(data)))
        self._at += len(self.pieces[-1][1])
        self.size = max(self.size, self._at)
        return len(self.pieces[-1][1])

    def readinto(self, buffer: Any) -> int:
        """Read data; unwritten bytes are zero."""
        view, first = memoryview(buffer).cast("B"), self._at
        view[:] = bytes(len(view))
        for offset, data in self.pieces:
            begin, end = max(first, offset), min(first + len(view), offset + len(data))
            if begin < end:
                view[begin - first : end - first] = data[begin - offset : end - offset]
        self._at += len(view)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the length of the file."""
        self.size = self._at if size is None else size
        return self.size
