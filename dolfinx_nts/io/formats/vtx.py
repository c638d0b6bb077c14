"""VTX file with the fields of a run: written by ADIOS2 in parallel, for ParaView."""

from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.compat import vtx_writer
from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.diagnostics.functions import NodalFunctions
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.fields import RunFields

__all__ = ["VtxFile"]


class VtxFile:
    """Writes the nodal fields of a run and the number of the body of each node.

    All ranks write their own nodes, nothing is gathered. Collective, as all its methods except
    `check`.

    Args:
        path: The file, ``.bp``, which is a folder.
        stepper: Stepper whose states are written.
        fields: Fields of each state.

    Raises:
        RuntimeError: DOLFINx was built without ADIOS2.
    """

    def __init__(self, path: Path, stepper: Stepper, fields: RunFields) -> None:
        self._path, self._stepper, self._fields = path, stepper, fields
        self._make_writer = vtx_writer()
        self._last_step = -1

    def check(self) -> None:
        """Check that a folder can be written under the name. Local.

        Raises:
            OSError: A file that is not a folder has the name.
        """
        if self._path.exists() and not self._path.is_dir():
            raise FileExistsError(f"expected a folder that can be replaced, given {self._path}")

    def serialize(self, archive: Archive) -> None:
        """Do nothing: a VTX file cannot be resumed."""

    def open(self, resume: bool) -> None:
        """Replace the file by one with the mesh.

        Args:
            resume: Always False, as a VTX file cannot be resumed.
        """
        V = self._stepper.u.function_space
        comm: MPI.Comm = V.mesh.comm
        self._functions = NodalFunctions(V)
        numbers = np.zeros(len(self._stepper.x))
        for number, b in reversed(list(enumerate(self._stepper.bodies))):
            numbers[b.nodes] = number
        body = self._functions.set("body", numbers[: len(self._stepper.node_ids)])
        functions = [*self._set(CurrentState(self._stepper)), body]
        self._writer: Any = self._make_writer(comm, self._path, functions, engine="BP4")
        self._last_step = -1

    def write(self, now: CurrentState) -> None:
        """Write the current state, unless it was written before.

        Args:
            now: Current state of the stepper.
        """
        if self._stepper.step == self._last_step:
            return
        self._last_step = self._stepper.step
        self._set(now)
        self._writer.write(self._stepper.t)

    def flush(self) -> None:
        """Do nothing: each state is complete when it is written."""

    def close(self) -> None:
        """Close the file."""
        self._writer.close()

    def leave(self) -> None:
        """Do nothing: no state is buffered."""

    def _set(self, now: CurrentState) -> list[fem.Function]:
        """Set the Functions to the values of the current state."""
        return [self._functions.set(name, v) for name, v in self._fields.nodal(now).items()]
