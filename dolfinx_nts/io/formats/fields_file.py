"""File with the fields of a run that refers to HDF5 files in a folder next to it."""

import re
from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.fields import RunFields
from dolfinx_nts.io.fields_folder import FieldsFolder
from dolfinx_nts.io.states import States
from dolfinx_nts.parallel.communication import on_root

__all__ = ["FieldsFile"]


class FieldsFile(ABC):
    """Writes the fields of a run and the number of the body of each cell.

    Cells of degree 2 are divided into cells of degree 1 between their nodes: eight in space, four
    in the plane. Collective, as are all methods except `check`.

    Args:
        path: The file. The folder next to it has its name with ``_fields`` in the place of the
            suffix.
        stepper: Stepper whose states are written.
        fields: Fields of each state.
    """

    # Pattern of the names of files that belong to the run.
    _own: ClassVar[re.Pattern[str]]

    def __init__(self, path: Path, stepper: Stepper, fields: RunFields) -> None:
        self._stepper = stepper
        self._comm: MPI.Intracomm = stepper.u.function_space.mesh.comm
        self._rows_of = States(stepper, fields).rows
        self._folder = FieldsFolder(path, self._own)
        self._steps: set[int] = set()

    def check(self) -> None:
        """Check that the files can be written. Local.

        Raises:
            OSError: A file or the folder cannot be replaced.
        """
        self._folder.check()

    def serialize(self, archive: Archive) -> None:
        """Serialize the steps whose states have been written.

        Args:
            archive: Archive that stores the steps, or returns the steps that `open` expects.
        """
        steps = np.array(sorted(self._steps), dtype=np.int64)
        self._steps = set(map(int, archive.same("field_steps", steps)))

    @abstractmethod
    def open(self, resume: bool) -> None:
        """Write the mesh, and remove the states that do not belong to the run.

        Args:
            resume: Whether to continue the states up to the current step. Otherwise all states
                of an earlier run are removed. If a state is damaged or missing, a warning is
                logged, and all are moved to another folder.

        Raises:
            OSError: The files cannot be written.
        """

    @abstractmethod
    def write(self, now: CurrentState) -> None:
        """Write the current state, at once or later, unless this was done before.

        Args:
            now: Current state of the stepper.

        Raises:
            OSError: States cannot be written, for instance because the disk is full. The
                earlier ones are unchanged.
        """

    def flush(self) -> None:
        """Wait until the disk has all states, so that they survive a power failure."""
        on_root(self._comm, self._folder.sync)

    @abstractmethod
    def close(self) -> None:
        """Complete the files at the end of a run."""

    @abstractmethod
    def leave(self) -> None:
        """Write buffered states after an error, unless ranks are in different steps."""
