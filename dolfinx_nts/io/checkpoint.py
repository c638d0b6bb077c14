"""Checkpoints: the state of a run in an HDF5 file, and the way back.

Values of nodes are kept by the numbers of the mesh as read, so that any
number of ranks can go on. Rank 0 collects everything: it needs memory for the
whole state. The file is made in memory, written beside the last one and then
renamed, so that there is always a whole one.
"""

import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from mpi4py import MPI

import h5py
import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Array, GlobalInts
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.fingerprint import fingerprint
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import gathered, on_root, scattered

__all__ = ["load", "save"]

T = TypeVar("T", float, int, bool, Array)

_FORMAT = "dolfinx_nts checkpoint 1"


class HasState(Protocol):
    """Something with a state beside that of the stepper."""

    def serialize(self, archive: Archive) -> None:
        """Serialize the state."""


def save(path: Path, stepper: Stepper, *others: HasState) -> None:
    """Replace a checkpoint by one of the present state. Collective.

    Args:
        path: The file.
        stepper: What is run.
        others: What else belongs to the run.

    Raises:
        OSError: The file cannot be written, for instance as the disk is
            full; the last one is as it was.
    """
    scene = fingerprint(stepper)
    archive = _Writer(stepper)
    for part in (stepper, *others):
        part.serialize(archive)
    on_root(archive.comm, lambda: _replace(path, _file(archive.values, scene)))


def load(path: Path, stepper: Stepper, *others: HasState) -> None:
    """Bring a run into the state of a checkpoint. Collective.

    Args:
        path: The file.
        stepper: Stepper of the same scene, on any number of ranks.
        others: What was given to `save`.

    Raises:
        ValueError: The file is no checkpoint, damaged, or of another
            scene; nothing has been changed.
    """
    comm = stepper.u.function_space.mesh.comm
    here = fingerprint(stepper)

    def read() -> dict[str, Array]:
        values, there = _read(path)
        if there != here:
            raise ValueError(
                f"expected a checkpoint of this scene, given {path}, in which "
                + "; ".join(
                    f"{name} is {there.get(name, 'missing')}, here {here.get(name, 'missing')}"
                    for name in sorted(there.keys() | here.keys())
                    if there.get(name) != here.get(name)
                )
            )
        return values

    values: dict[str, Array] = {}
    # Rank 0 keeps them; the others only need to know that all is well.
    on_root(comm, lambda: values.update(read()))
    archive = _Reader(stepper, values)
    for part in (stepper, *others):
        part.serialize(archive)


class _Writer(Archive):
    """Collects values on rank 0."""

    def __init__(self, stepper: Stepper) -> None:
        self.comm: MPI.Comm = stepper.u.function_space.mesh.comm
        self.values: dict[str, Array] = {}
        self.local("partition", [_partition(stepper)])

    def same(self, name: str, value: T) -> T:
        self.values[name] = np.array(value)
        return value

    def nodal(self, name: str, ids: GlobalInts, values: Array) -> Array:
        self.values[f"{name}/nodes"], self.values[f"{name}/values"] = gathered(
            self.comm, ids, values
        )
        return values

    def local(self, name: str, arrays: Sequence[Array] | None) -> Sequence[Array] | None:
        for rank, part in enumerate(self.comm.gather(arrays) or ()):
            for i, array in enumerate(part or ()):
                self.values[f"local/{name}/{rank}/{i}"] = np.asarray(array)
        return arrays


class _Reader(Archive):
    """Hands out what rank 0 has."""

    giving = True

    def __init__(self, stepper: Stepper, values: dict[str, Array]) -> None:
        self.comm: MPI.Comm = stepper.u.function_space.mesh.comm
        self._values = values
        self._is_same_partition = True
        there = self.local("partition", None)
        same = there is not None and np.array_equal(there[0], _partition(stepper))
        self._is_same_partition = reductions.everywhere(self.comm, same)

    def same(self, name: str, value: T) -> T:
        kept = on_root(self.comm, lambda: self._find(name))
        return kept if isinstance(value, np.ndarray) else type(value)(kept.item())

    def nodal(self, name: str, ids: GlobalInts, values: Array) -> Array:
        on_root(self.comm, lambda: (self._find(f"{name}/nodes"), None)[1])
        all_ids = self._values.get(f"{name}/nodes", np.empty(0, dtype=np.int64))
        kept = self._values.get(f"{name}/values", np.empty(0))
        return scattered(self.comm, ids, all_ids, kept).astype(values.dtype, copy=False)

    def local(self, name: str, arrays: Sequence[Array] | None) -> Sequence[Array] | None:
        if not self._is_same_partition:
            return None
        parts = None
        if self.comm.rank == 0:
            parts = [self._parts(f"local/{name}/{rank}") for rank in range(self.comm.size)]
        kept: Sequence[Array] | None = self.comm.scatter(parts)
        return kept

    def _parts(self, name: str) -> list[Array] | None:
        found: list[Array] = []
        while (array := self._values.get(f"{name}/{len(found)}")) is not None:
            found.append(array)
        return found or None

    def _find(self, name: str) -> Array:
        if name not in self._values:
            raise ValueError(f"expected a checkpoint of this version, given one without {name}")
        return self._values[name]


def _partition(stepper: Stepper) -> Array:
    """Digest of the local nodes: the same numbering needs the same nodes."""
    V = stepper.u.function_space
    nodes = V.dofmap.index_map.local_to_global(
        np.arange(len(V.tabulate_dof_coordinates()), dtype=np.int32)
    )
    text = hashlib.sha256(nodes.tobytes() + stepper.node_ids.tobytes()).digest()
    return np.frombuffer(text, dtype=np.uint8)


def _digest(values: dict[str, Array]) -> str:
    """Tells whether all values are as they were written."""
    digest = hashlib.sha256()
    for name in sorted(values):
        array = values[name]
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _file(values: dict[str, Array], scene: dict[str, str]) -> bytes:
    """HDF5 file with the values. Local."""
    with h5py.File("checkpoint", "w", driver="core", backing_store=False) as file:
        for name, array in values.items():
            file[name] = array
        file.attrs.update(format=_FORMAT, scene=json.dumps(scene), sha256=_digest(values))
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def _replace(path: Path, image: bytes) -> None:
    """Put a file in the place of another, in one instant. Local."""
    beside = path.with_name(f"{path.name}.new")
    try:
        with open(beside, "wb") as file:
            file.write(image)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise OSError(
            error.errno, f"{error.strerror}; an earlier checkpoint is as it was", str(path)
        ) from None
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _read(path: Path) -> tuple[dict[str, Array], dict[str, str]]:
    """Values and scene of a file. Local.

    Raises:
        ValueError: It is no whole checkpoint.
    """
    values: dict[str, Array] = {}

    def keep(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            values[name] = item[()] if item.shape else np.asarray(item[()])

    try:
        with h5py.File(path, "r") as file:
            attributes = dict(file.attrs)
            if attributes.get("format") != _FORMAT:
                raise ValueError(
                    f"expected a {_FORMAT}, given {path}, an HDF5 file of another kind"
                )
            file.visititems(keep)
    except (OSError, RuntimeError) as error:
        raise ValueError(f"expected a checkpoint, given {path}: {error}") from None
    if _digest(values) != attributes["sha256"]:
        raise ValueError(f"expected a whole checkpoint, given {path}, whose values are damaged")
    return values, json.loads(attributes["scene"])
