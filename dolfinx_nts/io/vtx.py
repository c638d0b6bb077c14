"""VTX file with the fields of a run: written by ADIOS2 in parallel, for ParaView."""

from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.compat import vtx_writer
from dolfinx_nts.fem.components import dimension, nodal
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.fields import nodal_fields

__all__ = ["VtxFile"]


class VtxFile:
    """Writes the fields of `nodal_fields` and the number of the body of each node.

    All ranks write their own nodes, nothing is gathered. Collective, as all its methods except
    `check`.

    Args:
        path: The file, ``.bp``, which is a folder.
        stepper: Stepper whose states are written.

    Raises:
        RuntimeError: DOLFINx was built without ADIOS2.
    """

    def __init__(self, path: Path, stepper: Stepper) -> None:
        """Remember the name of the file; `open` creates it."""
        self._path, self._stepper = path, stepper
        self._make_writer = vtx_writer()
        self._last_step = -1

    def check(self) -> None:
        """Refuse a name under which nothing can be written. Local.

        Raises:
            OSError: A file that is no folder has the name.
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
        # Carries values from the owned nodes to all nodes of a rank.
        self._carrier = fem.Function(V)
        scalars, self._dofs = V.sub(0).collapse()
        self._functions = {
            name: fem.Function(V if values.ndim == 2 else scalars, name=name)
            for name, values in nodal_fields(self._stepper).items()
        }
        body = fem.Function(scalars, name="body")
        numbers = np.zeros(len(nodal(self._carrier)))
        for number, b in reversed(list(enumerate(self._stepper.bodies))):
            numbers[b.nodes] = number
        body.x.array[:] = np.repeat(numbers, dimension(V))[self._dofs]
        functions = [*self._functions.values(), body]
        self._writer: Any = self._make_writer(comm, self._path, functions, engine="BP4")
        self._last_step = -1

    def write(self) -> None:
        """Write the present state, unless that has been done."""
        if self._stepper.step == self._last_step:
            return
        self._last_step = self._stepper.step
        for name, values in nodal_fields(self._stepper).items():
            carried = nodal(self._carrier)
            d = carried.shape[1]
            carried[: len(values)] = values[:, :d] if values.ndim == 2 else values[:, None]
            self._carrier.x.scatter_forward()
            array = self._functions[name].x.array
            array[:] = carried.ravel() if values.ndim == 2 else carried.ravel()[self._dofs]
        self._writer.write(self._stepper.t)

    def flush(self) -> None:
        """Do nothing: each state is complete when it is written."""

    def close(self) -> None:
        """Close the file."""
        self._writer.close()
