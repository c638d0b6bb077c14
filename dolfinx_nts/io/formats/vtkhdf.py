"""VTKHDF file with the fields of a run, and the HDF5 files that hold their values.

ParaView and VTK open ``run.vtkhdf``. The values are in the folder ``run_fields``: the mesh in
``grid.h5``, and consecutive states together, such as steps 51 to 80 in
``000000051-000000080.h5``. States are buffered for a second at most, or until they need much
memory, and then written together, which takes a tenth of the time. Files are created atomically,
so that a killed program leaves complete states.

All ranks write their rows, in the input numbering of the mesh. The content does not depend on the
partition, and a run on another number of ranks can continue the files.
"""

import logging
import re
import time
from pathlib import Path

from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.atomic_file import hdf5_file_image, replace
from dolfinx_nts.io.fields import RunFields, mesh_arrays
from dolfinx_nts.io.formats.fields_file import FieldsFile
from dolfinx_nts.io.formats.vtkhdf_index import Block, Field, grid_arrays, write_index
from dolfinx_nts.parallel.communication import on_root
from dolfinx_nts.parallel.errors import all_come
from dolfinx_nts.parallel.slabs import Slab

__all__ = ["VtkHdfFile"]

_logger = logging.getLogger("dolfinx_nts")

_GRID = "grid.h5"
_BLOCK = re.compile(r"\d{9}-\d{9}\.h5")
# A killed program leaves a temporary file with the suffix ``.new``.
_OWN = re.compile(r"(\d{9}-\d{9}|grid)\.h5(\.new)?")
# Longest time for which a state is buffered: in seconds [s], and relative to the time of the last
# writing [-], since the index grows; and largest memory of a rank for buffered states [bytes].
_LATEST, _RARELY, _MOST = 1.0, 30.0, 2**26


class VtkHdfFile(FieldsFile):
    """Writes the fields of a run as VTKHDF, ``run.vtkhdf``; see the module and `FieldsFile`."""

    _own = _OWN

    def __init__(self, path: Path, stepper: Stepper, fields: RunFields) -> None:
        super().__init__(path, stepper, fields)
        self._path = path
        self._grid: dict[str, Field] = {}
        self._blocks: list[Block] = []
        # Buffered states with step and time, and deadline for writing them [s].
        self._buffered: list[tuple[int, float, dict[str, Slab]]] = []
        self._due = 0.0
        # Written states, whose memory is reused.
        self._former: list[dict[str, Slab]] = []

    def open(self, resume: bool) -> None:
        cell = self._stepper.u.function_space.mesh.topology.cell_name()
        arrays = grid_arrays(mesh_arrays(self._stepper), cell)
        self._grid = {name: Field.of(slab) for name, slab in arrays.items()}
        self._buffered, self._due = [], 0.0
        self._steps = on_root(self._comm, lambda: self._begin(resume))
        self._folder.write(self._comm, _GRID, {name: [slab] for name, slab in arrays.items()}, {})

    def write(self, now: CurrentState) -> None:
        step = self._stepper.step
        if step in self._steps:
            return
        former = self._former.pop() if self._former else None
        self._buffered.append((step, self._stepper.t, self._rows_of(now, former)))
        self._steps.add(step)
        if on_root(self._comm, self._must_write):
            self._write_buffered()

    def flush(self) -> None:
        self._write_buffered()
        super().flush()

    def close(self) -> None:
        self._write_buffered()

    def leave(self) -> None:
        if self._buffered and all_come(self._comm, f"write the last fields of {self._path}"):
            self._write_buffered()

    def _write_buffered(self) -> None:
        """Write the buffered states."""
        buffered, self._buffered = self._buffered, []
        if not buffered:
            return
        start = time.monotonic()
        steps, times, states = zip(*buffered, strict=True)
        name = f"{steps[0]:09d}-{steps[-1]:09d}.h5"
        slabs = {of: [state[of] for state in states] for of in states[0]}
        self._folder.write(self._comm, name, slabs, {"steps": steps, "times": times})
        fields = {of: Field.of(slab) for of, slab in states[0].items()}
        self._former = list(states)
        block = Block(self._reference(name), steps, times, fields)
        on_root(self._comm, lambda: self._add(block, start))

    # --- on rank 0 --------------------------------------------------------

    def _must_write(self) -> bool:
        """Whether the buffered states must be written now."""
        _, _, state = self._buffered[-1]
        size = len(self._buffered) * sum(slab.values.nbytes for slab in state.values())
        return time.monotonic() >= self._due or size >= _MOST

    def _add(self, block: Block, start: float) -> None:
        """Add a block to the index; its writing began at the time ``start`` [s]."""
        self._blocks.append(block)
        self._write_index()
        now = time.monotonic()
        self._due = now + max(_LATEST, _RARELY * (now - start))

    def _begin(self, resume: bool) -> set[int]:
        """Remove outdated states; return the steps of the remaining ones."""
        self._blocks = self._found() if resume else []
        # References to states are removed before the states.
        if self._blocks:
            self._write_index()
        else:
            self._path.unlink(missing_ok=True)
        self._folder.begin({_GRID, *(Path(block.file).name for block in self._blocks)})
        return {step for block in self._blocks for step in block.steps}

    def _found(self) -> list[Block]:
        """Blocks of states up to the current step; none if states are missing."""
        blocks, last = [], self._stepper.step
        for path in sorted(self._folder.files(_BLOCK)):
            if int(path.name[:9]) > last:
                continue
            try:
                blocks.append(Block.read(path))
            except Exception as error:  # of many kinds
                return self._rewrite(f"{path} cannot be read: {error}")
        there = {step for block in blocks for step in block.steps}
        if missing := {step for step in self._steps if step <= last} - there:
            return self._rewrite(f"{self._folder.path} lacks the fields of step {min(missing)}")
        return blocks

    def _rewrite(self, reason: str) -> list[Block]:
        # Other programs have changed the files of fields; the checkpoint itself is complete.
        moved = self._folder.move_aside()
        _logger.warning("%s; the fields begin at this step, %s", reason, moved)
        return []

    def _write_index(self) -> None:
        grid = self._reference(_GRID)
        image = hdf5_file_image(lambda file: write_index(file, grid, self._grid, self._blocks))
        replace(self._path, image)

    def _reference(self, name: str) -> str:
        """Path by which the index refers to a file in the folder."""
        return f"{self._folder.path.name}/{name}"
