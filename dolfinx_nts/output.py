"""Recorder: fields for ParaView and a table of the balances of a run."""

import csv
import logging
import os
import time
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TextIO

from mpi4py import MPI

import numpy as np

from dolfinx_nts.contact import ContactWork
from dolfinx_nts.diagnostics import Diagnostics
from dolfinx_nts.newton import ConvergenceError
from dolfinx_nts.report import StepReport
from dolfinx_nts.stepper import Stepper
from dolfinx_nts.timing import Timings
from dolfinx_nts.xdmf import FieldFile

__all__ = ["Recorder"]

_logger = logging.getLogger("dolfinx_nts")

_CONSERVED = {
    "total_energy": "J",
    "linear_momentum": "kg m/s",
    "angular_momentum": "kg m^2/s",
}


class Recorder:
    """Writes ``name.xdmf`` with ``name.h5``, and ``name.csv``.

    Use it in a ``with`` block: entering writes the present state as the
    first row and fields, leaving closes the files, also after an exception.
    Files of the same name are replaced. Each row is on disk at once, so
    that a killed run leaves whole rows. Collective, as all methods but
    ``summary``.

    Columns of the table, in SI units: ``step``, ``dt``, those of `Balance`,
    ``newton_iterations``, and the change of the total energy since the
    first row by cause: ``energy_bulk``, ``energy_loads``,
    ``energy_supports``, ``energy_damping``, ``energy_persistent_contact``,
    ``energy_activation``, ``energy_facet_change``, ``energy_friction``,
    ``energy_solver``. Each is summed on its own; ``energy_unaccounted``
    is the rest: round-off, unless the state is set between steps.

    Args:
        name: Path of the files without suffix, in an existing folder.
        stepper: Midpoint, EnergyMomentum or QuasiStatic.
        every: Steps from one state of the fields to the next; the first
            and the last state are always there.

    Attributes:
        diagnostics: Diagnostics of the stepper.

    Raises:
        ValueError: ``every`` is less than 1.
    """

    def __init__(self, name: str | Path, stepper: Stepper, *, every: int = 1) -> None:
        """Check the arguments; nothing is created yet."""
        if every < 1:
            raise ValueError(f"expected fields every 1 step or more, given {every}")
        self.diagnostics = Diagnostics(stepper)
        self._name, self._stepper, self._every = str(name), stepper, every
        self._comm: MPI.Comm = stepper.u.function_space.mesh.comm
        self._timings: Timings = stepper.timings
        self._fields: FieldFile | None = None
        self._table: TextIO | None = None

    def __enter__(self) -> "Recorder":
        """Open the files and write the present state.

        Raises:
            OSError: The folder does not exist, or a file cannot be
                created or replaced; nothing has been created.
        """
        self._time, self._seconds = time.perf_counter(), dict(self._timings.seconds)
        with self._timings.phase("output"):
            self._first = self._last = self.diagnostics.balance()
            self._step = self._stepper.step
            self._iterations: list[int] = []
            self._bulk = self._loads = self._supports = self._damping = self._solver = 0.0
            self._contact = ContactWork()
            self._drift = dict.fromkeys(_CONSERVED, 0.0)
            error: OSError | None = None
            if self._comm.rank == 0:
                try:
                    self._table = _open_table(self._name)
                except OSError as failure:
                    error = failure
            if error := self._comm.bcast(error):
                raise error
            with ExitStack() as files:
                if self._table:
                    files.enter_context(self._table)
                self._fields = FieldFile(Path(f"{self._name}.xdmf"), self._stepper)
                files.callback(self._fields.close)
                self._fields.write()
                self._write_row(0.0, 0)
                self._files = files.pop_all()
        return self

    def write(self, step: StepReport) -> None:
        """Add the row of a step and, when it is their turn, the fields.

        Args:
            step: Report of the step that the stepper has just done.

        Raises:
            ValueError: The recorder is not open, or a step is left out.
        """
        if self._fields is None:
            raise ValueError("expected an open recorder, given one outside its with block")
        if not step.step == self._stepper.step == self._step + 1:
            raise ValueError(
                f"expected every step right after it was done, now step {self._step + 1}, "
                f"given step {step.step} when {self._stepper.step} are done"
            )
        with self._timings.phase("output"):
            self._bulk += self.diagnostics.bulk_defect()
            self._contact += step.contact_work
            self._loads += step.load_work
            self._supports += step.support_work
            self._damping += step.damping_work
            self._solver += step.solver_work
            self._step, self._last = step.step, self.diagnostics.balance()
            self._iterations.append(step.newton_iterations)
            self._write_row(step.dt, step.newton_iterations)
            if len(self._iterations) % self._every == 0:
                self._fields.write()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the last fields, unless ranks may be apart, and close."""
        with self._timings.phase("output"):
            fields, self._fields = self._fields, None
            with self._files:
                if fields and (error is None or isinstance(error, ConvergenceError)):
                    fields.write()
        self._time = time.perf_counter() - self._time
        if self._comm.rank == 0:
            _logger.info("%s", self.summary())

    def summary(self) -> str:
        """Steps, iterations, drifts and wall time, after the ``with`` block.

        Local; the times are those of this rank.
        """
        its, first = self._iterations, self._first
        phases = {
            name: seconds - self._seconds.get(name, 0.0)
            for name, seconds in self._timings.seconds.items()
        }
        phases["other"] = self._time - sum(phases.values())
        mean, most = np.mean(its or [0]), max(its, default=0)
        lines = [f"{self._name}: {len(its)} steps from t = {first.time:g} to {self._last.time:g} s"]
        lines += [f"Newton iterations: {sum(its)}, mean {mean:.2f}, max {most}"]
        lines += self._stepper.describe()
        for name, unit in _CONSERVED.items():
            size = np.linalg.norm(getattr(first, name))
            drift = f"largest change {self._drift[name]:.1e} {unit}"
            lines += [f"{name.replace('_', ' ')}: {size:.6g} {unit}, {drift}"]
        times = ", ".join(f"{name} {seconds:.1f}" for name, seconds in phases.items())
        return "\n".join([*lines, f"wall time: {self._time:.1f} s ({times})"])

    def _write_row(self, dt: float, newton_iterations: int) -> None:
        first, last, contact = self._first, self._last, self._contact
        for name in _CONSERVED:
            change = float(np.linalg.norm(getattr(last, name) - getattr(first, name)))
            self._drift[name] = max(self._drift[name], change)
        causes = {
            "energy_bulk": self._bulk,
            "energy_loads": self._loads,
            "energy_supports": self._supports,
            "energy_damping": self._damping,
            "energy_persistent_contact": contact.persistent,
            "energy_activation": contact.activation,
            "energy_facet_change": contact.facet_change,
            "energy_friction": contact.friction,
            "energy_solver": self._solver,
        }
        rest = last.total_energy - first.total_energy - sum(causes.values())
        row = {
            "step": self._step,
            "time": last.time,
            "dt": dt,
            **last.columns(),
            "newton_iterations": newton_iterations,
            **causes,
            "energy_unaccounted": rest,
        }
        if self._table:
            table = csv.writer(self._table)
            if not self._iterations:
                table.writerow(row)
            table.writerow(row.values())
            self._table.flush()


def _open_table(name: str) -> TextIO:
    """Open the table, after a look whether all files can be written."""
    if not (folder := Path(name).parent).is_dir():
        raise FileNotFoundError(f"expected an existing folder, given {folder}")
    for path in (Path(f"{name}.{suffix}") for suffix in ("h5", "xdmf", "csv")):
        if path.exists() and not (path.is_file() and os.access(path, os.W_OK)):
            raise OSError(f"expected a file that can be replaced, given {path}")
    return open(f"{name}.csv", "w", newline="", encoding="utf-8")
