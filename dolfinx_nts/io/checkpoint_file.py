"""Checkpoint file, read by all ranks together."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from mpi4py import MPI

import h5py
import numpy as np

from dolfinx_nts.common.arrays import Array, GlobalInts
from dolfinx_nts.io.checksum import checksum
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import on_root
from dolfinx_nts.parallel.errors import agreed

__all__ = ["FORMAT", "CheckpointFile", "Kind", "digest"]

FORMAT = "dolfinx_nts checkpoint 4"
# Largest block that a rank reads in one piece to verify checksums [bytes].
_MOST = 2**22


class Kind(NamedTuple):
    """Shape and type of an array in a checkpoint."""

    shape: tuple[int, ...]
    dtype: str


class CheckpointFile:
    """Checkpoint that is open for reading, in a ``with`` block. Collective, as its methods.

    Args:
        comm: Communicator of the ranks that read it.
        path: The file.

    Attributes:
        comm: Communicator of the ranks that read it.
        scene: The `fingerprint` of its scene.

    Raises:
        ValueError: The file is not a complete checkpoint.
    """

    def __init__(self, comm: MPI.Comm, path: Path) -> None:
        self.comm = comm
        text, sha256, kinds = on_root(comm, lambda: _described(path))
        with agreed(comm, f"read {path}"):
            try:
                with h5py.File(path, "r") as file:
                    sums = _sums(comm, file, kinds)
            except Exception as error:  # damaged files make h5py raise errors of many kinds
                raise ValueError(f"expected a checkpoint, given {path}: {error}") from None
        sums = reductions.total(comm, sums)
        if digest(text, kinds, dict(zip(kinds, map(int, sums), strict=True))) != sha256:
            raise ValueError(f"expected a whole checkpoint, given {path}, whose values are damaged")
        self.scene: dict[str, str] = json.loads(text)
        self._file = h5py.File(path, "r")

    def __enter__(self) -> "CheckpointFile":
        return self

    def __exit__(self, *error: object) -> None:
        """Close the file."""
        self._file.close()

    def __contains__(self, name: str) -> bool:
        """Whether there is an array of this name. Local."""
        return name in self._file

    def array(self, name: str) -> Array:
        """Read an array. Local.

        Raises:
            ValueError: There is none of this name.
        """
        return np.asarray(self._found(name)[()])

    def block(self, name: str) -> Array:
        """Read this rank's share of the rows of an array. Local.

        Raises:
            ValueError: There is none of this name.
        """
        rows = self._found(name)
        begin, end = (len(rows) * r // self.comm.size for r in (self.comm.rank, self.comm.rank + 1))
        return np.asarray(rows[begin:end])

    def _found(self, name: str) -> Any:
        if name not in self._file:
            raise ValueError(f"expected a checkpoint of this version, given one without {name}")
        return self._file[name]


def _described(path: Path) -> tuple[str, str, dict[str, Kind]]:
    """Scene and digest of a checkpoint, and its arrays by name. Local."""
    if not path.is_file():
        raise ValueError(
            f"expected a checkpoint, given {path}, where there is no file; "
            "Recorder(name, stepper, checkpoint_every=) writes name.checkpoint.h5"
        )
    kinds: dict[str, Kind] = {}

    def add(name: str | bytes, item: Any) -> None:
        if isinstance(name, bytes):  # not UTF-8
            raise ValueError(f"it has {name!r}, a name that is not text")
        if isinstance(item, h5py.Dataset):
            kinds[name] = Kind(item.shape, item.dtype.str)

    try:
        with h5py.File(path, "r") as file:
            attributes = dict(file.attrs)
            if attributes.get("format") == FORMAT:
                file.visititems(add)
                scene, sha256 = str(attributes["scene"]), str(attributes["sha256"])
        size = sum(_row_size(kind) * len(_rows(kind)) for kind in kinds.values())
        if size > path.stat().st_size:
            raise ValueError("its arrays are longer than the file")
    except Exception as error:  # damaged files make h5py raise errors of many kinds
        raise ValueError(f"expected a checkpoint, given {path}: {error}") from None
    if attributes.get("format") != FORMAT:
        raise ValueError(f"expected a {FORMAT}, given {path}, an HDF5 file of another kind")
    return scene, sha256, kinds


def _rows(kind: Kind) -> range:
    return range(kind.shape[0] if kind.shape else 1)


def _row_size(kind: Kind) -> int:
    size = np.dtype(kind.dtype).itemsize
    for length in kind.shape[1:]:
        size *= length
    return size


def _chunks(kinds: Mapping[str, Kind]) -> Iterator[tuple[int, str, GlobalInts]]:
    """Blocks of arrays that are read together: number and name of the array, and the rows."""
    for number, (name, kind) in enumerate(kinds.items()):
        rows, size = _rows(kind), max(1, _MOST // max(1, _row_size(kind)))
        for begin in rows[::size]:
            yield number, name, np.array(rows[begin : begin + size])


def _sums(comm: MPI.Comm, file: h5py.File, kinds: Mapping[str, Kind]) -> Array:
    """Checksums of the blocks that this rank verifies, one for each array. Local."""
    sums = np.zeros(len(kinds), dtype=np.uint64)
    for turn, (number, name, rows) in enumerate(_chunks(kinds)):
        if turn % comm.size == comm.rank:
            values = file[name]
            part = values[rows[0] : rows[-1] + 1] if values.shape else np.array([values[()]])
            sums[number] += np.uint64(checksum(rows, part))
    return sums


def digest(scene: str, kinds: Mapping[str, Kind], sums: Mapping[str, int]) -> str:
    """Digest of a whole checkpoint. Local.

    Args:
        scene: Text of the scene.
        kinds: Shape and type of its arrays by name.
        sums: Their checksums by name.
    """
    text = hashlib.sha256(scene.encode())
    for name in sorted(kinds):
        shape, dtype = kinds[name]
        text.update(f"{name} {np.dtype(dtype).str} {tuple(shape)} {sums[name]}".encode())
    return text.hexdigest()
