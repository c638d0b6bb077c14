"""VTX file with the fields of a stepper: ADIOS2 for ParaView, written in parallel."""

from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from dolfinx_nts.compat import vtx_writer
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.fields import nodal_fields
from dolfinx_nts.parallel.communication import on_root

__all__ = ["VtxFile"]


class VtxFile:
    """The fields of `nodal_fields` and the number of the body of each node.

    All ranks write, nothing is gathered. Collective, as all its methods.

    Args:
        path: The file, ``.bp``, a folder; one that is there is replaced.
        stepper: What is run.

    Raises:
        OSError: Something else has the name of the file.
        RuntimeError: DOLFINx was built without ADIOS2.
    """

    def __init__(self, path: Path, stepper: Stepper) -> None:
        """Open the file and write the mesh."""
        self._stepper, self._written = stepper, -1
        V = stepper.u.function_space
        comm: MPI.Comm = V.mesh.comm
        # Carries values from the owned nodes to all.
        self._carrier = fem.Function(V)
        scalars, self._dofs = V.sub(0).collapse()
        self._functions = {
            name: fem.Function(V if values.ndim == 2 else scalars, name=name)
            for name, values in nodal_fields(stepper).items()
        }
        body = fem.Function(scalars, name="body")
        numbers = np.zeros(len(self._carrier.x.array) // 3)
        for number, b in reversed(list(enumerate(stepper.bodies))):
            numbers[b.nodes] = number
        body.x.array[:] = np.repeat(numbers, 3)[self._dofs]

        def check() -> None:
            if path.exists() and not path.is_dir():
                raise FileExistsError(f"expected a folder that can be replaced, given {path}")

        on_root(comm, check)
        functions = [*self._functions.values(), body]
        self._writer: Any = vtx_writer()(comm, path, functions, engine="BP4")

    def write(self) -> None:
        """Write the present state, unless it has been written."""
        if self._stepper.step == self._written:
            return
        self._written = self._stepper.step
        for name, values in nodal_fields(self._stepper).items():
            nodal = self._carrier.x.array.reshape(-1, 3)
            nodal[: len(values)] = values if values.ndim == 2 else values[:, None]
            self._carrier.x.scatter_forward()
            array = self._functions[name].x.array
            array[:] = nodal.ravel() if values.ndim == 2 else nodal.ravel()[self._dofs]
        self._writer.write(self._stepper.t)

    def flush(self) -> None:
        """Do nothing: each state is complete when it is written."""

    def abandon(self) -> None:
        """Leave the file as it is where the ranks may be apart. Local."""

    def close(self) -> None:
        """Close the file."""
        self._writer.close()
