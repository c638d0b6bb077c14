"""Checkpoints: the state of a run in an HDF5 file, from which the run can continue.

Nodal values are stored by the input numbers of the nodes, so that a run can continue on any number
of ranks. Each rank writes and reads its part; no rank needs memory for the whole state. A new
checkpoint replaces the old one atomically, so that a complete checkpoint exists at any time.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, TypeVar

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Array, GlobalInts
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.checkpoint_file import FORMAT, CheckpointFile, Kind, digest
from dolfinx_nts.io.checksum import checksum
from dolfinx_nts.io.fingerprint import fingerprint
from dolfinx_nts.io.shared_file import write_hdf5
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import on_root
from dolfinx_nts.parallel.slabs import Slab, Slabs, fetch_rows

__all__ = ["HasState", "Reader", "load", "save"]

T = TypeVar("T", float, int, bool, Array)


class HasState(Protocol):
    """Object with a state in addition to the stepper's."""

    def serialize(self, archive: Archive) -> None:
        """Serialize the state. Collective."""


def save(path: Path, stepper: Stepper, *others: HasState) -> None:
    """Write a checkpoint of the current state. Collective.

    Args:
        path: The file.
        stepper: Stepper whose state is written.
        others: Other objects whose state belongs to the run.

    Raises:
        OSError: The file cannot be written, for instance because the disk is full. A checkpoint
            that existed before is unchanged.
    """
    scene = json.dumps(fingerprint(stepper))
    archive = _Writer(stepper)
    for part in (stepper, *others):
        part.serialize(archive)
    attributes = {"format": FORMAT, "scene": scene, "sha256": archive.digest(scene)}
    write_hdf5(archive.comm, path, archive.arrays, attributes, durable=True)


def load(path: Path, stepper: Stepper, *others: HasState) -> None:
    """Restore the state of a checkpoint. Collective.

    Args:
        path: The file.
        stepper: Stepper of the same scene, on any number of ranks.
        others: The objects passed to `save`, in the same order.

    Raises:
        ValueError: The file is not a checkpoint, is damaged, or belongs to another scene. Nothing
            has been changed.
    """
    comm = stepper.u.function_space.mesh.comm
    with CheckpointFile(comm, path) as file:
        scene, expected = file.scene, fingerprint(stepper)
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
        archive = Reader(stepper, file)
        for part in (stepper, *others):
            part.serialize(archive)


class _Writer(Archive):
    """Archive that collects the data written by this rank."""

    def __init__(self, stepper: Stepper) -> None:
        self.comm: MPI.Intracomm = stepper.u.function_space.mesh.comm
        self.arrays: dict[str, list[Slab]] = {}
        self.local("partition", [_partition(stepper)])

    def digest(self, scene: str) -> str:
        """Digest of the whole checkpoint on rank 0."""
        kinds, sums = {}, {}
        for name, (slab,) in self.arrays.items():
            kinds[name] = Kind(slab.shape, slab.dtype.str)
            rows = slab.values if slab.values.ndim else slab.values[None]
            sums[name] = checksum(slab.begin + np.arange(len(rows)), rows)
        kinds_of, sums_of = (self.comm.gather(found) for found in (kinds, sums))
        if kinds_of is None or sums_of is None:
            return ""
        kinds = {name: kind for part in kinds_of for name, kind in part.items()}
        totals = {name: sum(part.get(name, 0) for part in sums_of) % 2**64 for name in kinds}
        return digest(scene, kinds, totals)

    def same(self, name: str, value: T) -> T:
        if self.comm.rank == 0:
            self.arrays[name] = [Slab.whole(np.array(value))]
        return value

    def nodal(self, name: str, ids: GlobalInts, values: Array) -> Array:
        slabs = Slabs(self.comm, ids)
        self.arrays[f"{name}/nodes"] = [slabs.numbers()]
        self.arrays[f"{name}/values"] = [slabs.slab(values)]
        return values

    def local(self, name: str, arrays: Sequence[Array] | None) -> Sequence[Array] | None:
        for i, array in enumerate(arrays or ()):
            own = f"local/{name}/{self.comm.rank}/{i}"
            self.arrays[own] = [Slab.whole(np.array(array))]
        return arrays


class Reader(Archive):
    """Archive that returns the values of a checkpoint. Collective.

    Args:
        stepper: Stepper to be restored.
        file: The checkpoint.
    """

    restores = True

    def __init__(self, stepper: Stepper, file: CheckpointFile) -> None:
        self._file = file
        self._is_same_partition = True
        saved = self.local("partition", None)
        same = saved is not None and np.array_equal(saved[0], _partition(stepper))
        self._is_same_partition = reductions.everywhere(file.comm, same)

    def same(self, name: str, value: T) -> T:
        """Number or array that is the same on all ranks."""
        saved = on_root(self._file.comm, lambda: self._file.array(name))
        return saved if isinstance(value, np.ndarray) else type(value)(saved.item())

    def nodal(self, name: str, ids: GlobalInts, values: Array) -> Array:
        """Values of owned nodes."""
        known, rows = (self._file.block(f"{name}/{of}") for of in ("nodes", "values"))
        found = fetch_rows(self._file.comm, ids, known, rows)
        return found.astype(values.dtype, copy=False)

    def local(self, name: str, arrays: Sequence[Array] | None) -> Sequence[Array] | None:
        """Arrays of this rank; None if the partition has changed."""
        if not self._is_same_partition:
            return None
        found: list[Array] = []
        while (own := f"local/{name}/{self._file.comm.rank}/{len(found)}") in self._file:
            found.append(self._file.array(own))
        return found or None


def _partition(stepper: Stepper) -> Array:
    """Digest of the local numbering, by which local arrays are reused."""
    V = stepper.u.function_space
    nodes = V.dofmap.index_map.local_to_global(
        np.arange(len(reference_positions(V)), dtype=np.int32)
    )
    text = hashlib.sha256(nodes.tobytes() + stepper.node_ids.tobytes()).digest()
    return np.frombuffer(text, dtype=np.uint8)
