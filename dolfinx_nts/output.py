"""Recorder: fields for ParaView and a table of the balances.

``name.xdmf`` with ``name.h5`` holds one time series with displacement,
velocity, the number of the body and, of the contact nodes, gap, contact
pressure and active; ``name.csv`` has one row a step, flushed at once, so
that a killed run leaves whole rows.
"""

import csv
import logging
import time
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO
from xml.etree import ElementTree

from mpi4py import MPI

import numpy as np
from dolfinx import fem, io

from dolfinx_nts.diagnostics import Balance, Diagnostics
from dolfinx_nts.integrators import EnergyMomentum, Midpoint, StepReport
from dolfinx_nts.newton import ConvergenceError

__all__ = ["Recorder"]

_logger = logging.getLogger("dolfinx_nts")


class Recorder:
    """Writes fields and balances of a run; use it in a ``with`` block.

    Entering writes the present state as the first row and fields; leaving
    closes the files, also after an exception. Files of the same name are
    replaced. Collective, as all methods but ``summary``.

    Columns of the table: ``step, time, dt``; the energies, momenta (about
    the origin), contact force, ``active_nodes`` and ``min_gap`` of
    `Balance`; ``newton_iterations``; and the change of the total energy
    since the first row by cause: ``energy_bulk`` (defect of the stress),
    ``energy_persistent_contact``, ``energy_activation``,
    ``energy_facet_change``, ``energy_solver`` (residual that Newton's
    method left), each summed on its own, and ``energy_unaccounted``, the
    rest: round-off, unless supports move or the state is set between
    steps. All in SI units.

    Args:
        name: Path of the files without suffix, in an existing folder.
        stepper: Midpoint or EnergyMomentum.
        every: Steps between two states of the fields; the first and the
            last state are always there.

    Attributes:
        diagnostics: The diagnostics of the stepper.

    Raises:
        FileNotFoundError: The folder does not exist.
        ValueError: ``every`` is not positive.
    """

    def __init__(
        self, name: str | Path, stepper: Midpoint | EnergyMomentum, *, every: int = 1
    ) -> None:
        """Check the arguments; nothing is created yet."""
        if every < 1:
            raise ValueError(f"expected fields every 1 or more steps, given {every}")
        self.diagnostics = Diagnostics(stepper)
        self._stepper, self._every, self._name = stepper, every, str(name)
        self._comm: MPI.Comm = stepper.u.function_space.mesh.comm
        folder = Path(self._name).parent
        if not self._comm.bcast(folder.is_dir()):
            raise FileNotFoundError(f"expected an existing folder for {name!s}, given {folder}")
        self._table: TextIO | None = None
        self._fields = _Fields(stepper)
        self._seconds = 0.0

    def __enter__(self) -> "Recorder":
        """Open the files and write the present state."""
        error = None
        if self._comm.rank == 0:
            try:
                self._table = open(f"{self._name}.csv", "w", newline="", encoding="utf-8")
            except OSError as failure:
                error = failure
        if error := self._comm.bcast(error):
            raise error
