"""Checkpoints: the state of a run in an HDF5 file, from which the run can go on.

Values of nodes are stored by the numbers of the nodes in the mesh as read, so that a run can
continue on any number of ranks. Rank 0 collects everything and needs the memory for the whole
state. A new checkpoint takes the place of the former one in one instant, so there is a whole
one at any time.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from mpi4py import MPI

import h5py
import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Array, GlobalInts
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.atomic_file import hdf5_image, replace
from dolfinx_nts.io.fingerprint import fingerprint
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import gathered, on_root, scattered

__all__ = ["HasState", "Reader", "load", "read", "save"]

T = TypeVar("T", float, int, bool, Array)

_FORMAT = "dolfinx_nts checkpoint 1"


class HasState(Protocol):
    """Object that has a state beside that of the stepper."""

    def serialize(self, archive: Archive) -> None:
        """Serialize the state. Collective."""


def save(path: Path, stepper: Stepper, *others: HasState) -> None:
    """Write the present state to a checkpoint, or replace one. Collective.

    Args:
        path: The file.
        stepper: Stepper whose state is written.
        others: Objects whose state belongs to the run too.

    Raises:
        OSError: The file cannot be written, for instance because the disk is full. A checkpoint
            that existed before is unchanged.
    """
    scene = fingerprint(stepper)
    archive = _Writer(stepper)
    for part in (stepper, *others):
        part.serialize(archive)

    def write() -> None:
        text = json.dumps(scene)
        digest = _digest(text, archive.values)
        image = hdf5_image(archive.values, format=_FORMAT, scene=text, sha256=digest)
        replace(path, image, durable=True)

    on_root(archive.comm, write)


def load(path: Path, stepper: Stepper, *others: HasState) -> None:
    """Bring a stepper into the state of a checkpoint. Collective.

    Args:
        path: The file.
        stepper: Stepper of the same scene, on any number of ranks.
        others: The objects that were given to `save`, in the same order.

    Raises:
        ValueError: The file is no checkpoint, is damaged, or belongs to another scene. Nothing
            has been changed.
    """
    comm = stepper.u.function_space.mesh.comm
    expected = fingerprint(stepper)

    def matching() -> dict[str, Array]:
        values, scene = read(path)
        if scene != expected:
            raise ValueError(
                f"expected a checkpoint of this scene, given {path}, in which "
                + "; ".join(
                    f"{name} is {scene.get(name, 'missing')} "
                    f"instead of {expected.get(name, 'missing')}"
                    for name in sorted(scene.keys() | expected.keys())
                    if scene.get(name) != expected.get(name)
                )
            )
        return values

    values: dict[str, Array] = {}
    # Only rank 0 needs the values; the others learn of an error.
    on_root(comm, lambda: values.update(matching()))
    archive = Reader(stepper, values)
    for part in (stepper, *others):
        part.serialize(archive)


class _Writer(Archive):
    """Archive that collects values on rank 0."""

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


class Reader(Archive):
    """Archive that gives the values which rank 0 has read. Collective.

    Args:
        stepper: Stepper that gets them.
        values: On rank 0 the values by name.
    """

    giving = True

    def __init__(self, stepper: Stepper, values: dict[str, Array]) -> None:
        """Find out whether the partition is that of the checkpoint."""
        self.comm: MPI.Comm = stepper.u.function_space.mesh.comm
        self._values = values
        self._is_same_partition = True
        saved = self.local("partition", None)
        same = saved is not None and np.array_equal(saved[0], _partition(stepper))
        self._is_same_partition = reductions.everywhere(self.comm, same)

    def same(self, name: str, value: T) -> T:
        """Give a number or an array that is the same on all ranks."""
        saved = on_root(self.comm, lambda: self._find(name))
        return saved if isinstance(value, np.ndarray) else type(value)(saved.item())

    def nodal(self, name: str, ids: GlobalInts, values: Array) -> Array:
        """Give values of owned nodes."""
        on_root(self.comm, lambda: (self._find(f"{name}/nodes"), None)[1])
        all_ids = self._values.get(f"{name}/nodes", np.empty(0, dtype=np.int64))
        rows = self._values.get(f"{name}/values", np.empty(0))
        return scattered(self.comm, ids, all_ids, rows).astype(values.dtype, copy=False)

    def local(self, name: str, arrays: Sequence[Array] | None) -> Sequence[Array] | None:
        """Give arrays of this rank."""
        if not self._is_same_partition:
            return None
        parts = None
        if self.comm.rank == 0:
            parts = [self._parts(f"local/{name}/{rank}") for rank in range(self.comm.size)]
        own: Sequence[Array] | None = self.comm.scatter(parts)
        return own

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
    """Digest of the local numbering; it decides whether local arrays can be used again."""
    V = stepper.u.function_space
    nodes = V.dofmap.index_map.local_to_global(
        np.arange(len(V.tabulate_dof_coordinates()), dtype=np.int32)
    )
    text = hashlib.sha256(nodes.tobytes() + stepper.node_ids.tobytes()).digest()
    return np.frombuffer(text, dtype=np.uint8)


def _digest(scene: str, values: dict[str, Array]) -> str:
    """Digest by which a reader notices that something has changed."""
    digest = hashlib.sha256(scene.encode())
    for name in sorted(values):
        array = values[name]
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def read(path: Path) -> tuple[dict[str, Array], dict[str, str]]:
    """Read a checkpoint. Local.

    Args:
        path: The file.

    Returns:
        Values by name, and the `fingerprint` of the scene.

    Raises:
        ValueError: The file is not a whole checkpoint.
    """
    values: dict[str, Array] = {}

    def collect(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            values[name] = item[()] if item.shape else np.asarray(item[()])

    try:
        with h5py.File(path, "r") as file:
            attributes = dict(file.attrs)
            if attributes.get("format") == _FORMAT:
                file.visititems(collect)
                scene = attributes["scene"]
                is_whole = _digest(scene, values) == attributes["sha256"]
    except Exception as error:  # damaged files make h5py raise errors of many kinds
        raise ValueError(f"expected a checkpoint, given {path}: {error}") from None
    if attributes.get("format") != _FORMAT:
        raise ValueError(f"expected a {_FORMAT}, given {path}, an HDF5 file of another kind")
    if not is_whole:
        raise ValueError(f"expected a whole checkpoint, given {path}, whose values are damaged")
    return values, json.loads(scene)
