"""Recorder: fields for ParaView and a table of the balances of a run."""

import logging
import os
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

from mpi4py import MPI

from dolfinx_nts.common.timing import Timings
from dolfinx_nts.compat import vtx_writer
from dolfinx_nts.diagnostics.balance import Diagnostics
from dolfinx_nts.diagnostics.energy_ledger import EnergyLedger
from dolfinx_nts.diagnostics.reverse_penetration import ReversePenetration
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io import checkpoint
from dolfinx_nts.io.csv_table import Table
from dolfinx_nts.io.vtx import VtxFile
from dolfinx_nts.io.xdmf import FieldFile
from dolfinx_nts.parallel.communication import on_root
from dolfinx_nts.parallel.signals import Interrupts
from dolfinx_nts.solvers.newton import ConvergenceError

__all__ = ["Recorder"]

_logger = logging.getLogger("dolfinx_nts")


class Recorder:
    """Writes ``name.xdmf`` with ``name.h5``, and ``name.csv``.

    Use it in a ``with`` block: entering writes the present state as the
    first row and fields, leaving closes the files, also after an exception.
    Files of the same name are replaced. Each row is on disk at once, so
    that a killed run leaves whole rows. Collective, as all methods but
    ``summary``.

    Columns of the table, in SI units: ``step``, ``dt``, those of `Balance`,
    ``newton_iterations``, ``rejected``, and the change of the total energy
    since the first row by cause: ``energy_bulk``, ``energy_loads``,
    ``energy_supports``, ``energy_damping``, ``energy_persistent_contact``,
    ``energy_activation``, ``energy_facet_change``, ``energy_friction``,
    ``energy_solver``. Each is summed on its own; ``energy_unaccounted``
    is the rest: round-off, unless the state is set between steps. Besides,
    ``external_work`` of loads and supports, and ``friction_dissipation``, what
    friction has taken.

    With ``checkpoint_every``, checkpoints ``name.checkpoint.h5`` hold all that
    the run depends on. They are also written at the end, and on Ctrl-C or
    SIGTERM, which then take effect after the present step (a second one takes
    effect at once). With ``resume``, entering goes on from there, on any
    number of ranks: a script that is started again continues its run, and the
    files go on after the step of the checkpoint.

    Args:
        name: Path of the files without suffix, in an existing folder.
        stepper: What is run.
        every: Steps from one state of the fields to the next; the first
            and the last state are always there.
        times: Times at which the fields are written instead [s], those of
            a `StepControl` for instance.
        checkpoint_every: Steps from one checkpoint to the next.
        resume: Go on from the checkpoint, if there is one.
        fields: Kind of the file of fields: ``"xdmf"``, or ``"vtx"``, a
            folder ``name.bp`` that all ranks write, where DOLFINx has
            ADIOS2; it cannot be resumed.

    Attributes:
        diagnostics: Diagnostics of the stepper.

    Raises:
        RuntimeError: DOLFINx has no ADIOS2 for ``fields="vtx"``.
        ValueError: ``every`` or ``checkpoint_every`` is less than 1;
            ``fields`` is another kind, or one that cannot be resumed.
    """

    def __init__(
        self,
        name: str | Path,
        stepper: Stepper,
        *,
        every: int = 1,
        times: Sequence[float] | None = None,
        checkpoint_every: int | None = None,
        resume: bool = False,
        fields: Literal["xdmf", "vtx"] = "xdmf",
    ) -> None:
        """Check the arguments; nothing is created yet."""
        if fields not in ("xdmf", "vtx"):
            raise ValueError(f"expected fields 'xdmf' or 'vtx', given {fields!r}")
        if fields == "vtx":
            vtx_writer()
            if resume:
                raise ValueError("expected fields='xdmf' with resume, as VTX files cannot go on")
        if every < 1:
            raise ValueError(f"expected fields every 1 step or more, given {every}")
        if checkpoint_every is not None and checkpoint_every < 1:
            raise ValueError(f"expected checkpoints every 1 step or more, given {checkpoint_every}")
        self.diagnostics = Diagnostics(stepper)
        self._name, self._stepper, self._every = str(name), stepper, every
        self._comm: MPI.Comm = stepper.u.function_space.mesh.comm
        self._timings: Timings = stepper.timings
        self._times = None if times is None else {float(t) for t in times}
        self._checkpoint = Path(f"{name}.checkpoint.h5")
        self._checkpoint_every, self._resume = checkpoint_every, resume
        self._kind = fields
        self._fields: FieldFile | VtxFile | None = None
        self._table = Table(Path(f"{name}.csv"))

    def __enter__(self) -> "Recorder":
        """Open the files and write the present state, or resume.

        Raises:
            OSError: The folder does not exist, or a file cannot be
                created or replaced; nothing has been created.
            ValueError: The checkpoint is damaged or of another scene, or
                the table does not reach to its step; nothing has been
                changed.
        """
        self._time, self._seconds = time.perf_counter(), dict(self._timings.seconds)
        with self._timings.phase("output"):
            self._ledger = EnergyLedger(self._stepper.step, self.diagnostics.balance())
            self._sunk = ReversePenetration(self._stepper)
            self._table.size = 0
            resume = on_root(self._comm, lambda: self._resume and self._checkpoint.exists())
            if resume:
                checkpoint.load(self._checkpoint, self._stepper, self._ledger, self._table)
            self._saved = self._ledger.step
            on_root(self._comm, lambda: self._open_table(resume))
            with ExitStack() as files:
                files.callback(self._table.close)
                self._fields = self._open_fields(resume)
                files.callback(self._fields.abandon)
                if not resume:
                    self._fields.write()
                    self._write_row(0.0)
                if self._checkpoint_every is not None:
                    self._interrupts = files.enter_context(Interrupts(self._comm))
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
        due = self._ledger.step + 1
        if not step.step == self._stepper.step == due:
            raise ValueError(
                f"expected every step right after it was done, now step {due}, "
                f"given step {step.step} when {self._stepper.step} are done"
            )
        with self._timings.phase("output"):
            self._ledger.add(step, self.diagnostics.bulk_defect(), self.diagnostics.balance())
            self._write_row(step.dt, step.newton_iterations, step.rejected)
            count = self._ledger.num_steps
            is_turn = count % self._every == 0 if self._times is None else step.t in self._times
            if is_turn:
                self._fields.write()
                self._sunk.look()
            if self._checkpoint_every is not None:
                signum = self._interrupts.received()
                if signum or count % self._checkpoint_every == 0:
                    self._save()
                if signum:
                    self._interrupts.take_effect(signum)

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Write the last fields, unless ranks may be apart, and close."""
        with self._timings.phase("output"):
            with self._files:
                if self._fields and (error is None or isinstance(error, ConvergenceError)):
                    self._fields.write()
                    if self._checkpoint_every is not None and self._saved != self._ledger.step:
                        self._save()
                    self._fields.close()
            self._fields = None
        self._time = time.perf_counter() - self._time
        if self._comm.rank == 0:
            _logger.info("%s", self.summary())

    def _save(self) -> None:
        """Write a checkpoint, after all that it relies on."""
        assert self._fields is not None
        self._fields.flush()
        on_root(self._comm, self._table.sync)
        checkpoint.save(self._checkpoint, self._stepper, self._ledger, self._table)
        self._saved = self._ledger.step

    def summary(self) -> str:
        """Steps, iterations, drifts and wall time, after the ``with`` block.

        Local; the times are those of this rank.
        """
        ledger = self._ledger
        phases = {
            name: seconds - self._seconds.get(name, 0.0)
            for name, seconds in self._timings.seconds.items()
        }
        phases["other"] = self._time - sum(phases.values())
        time_span = f"from t = {ledger.first.time:g} to {ledger.last.time:g} s"
        lines = [f"{self._name}: {ledger.num_steps} steps {time_span}", ledger.iterations()]
        lines += [*self._stepper.describe(), *ledger.drifts()]
        for i, depth in self._sunk.deepest.items():
            if depth > 0:
                lines += [f"pair {i + 1}: vertices of segments up to {depth:.3g} m inside"]
        times = ", ".join(f"{name} {seconds:.1f}" for name, seconds in phases.items())
        return "\n".join([*lines, f"wall time: {self._time:.1f} s ({times})"])

    def _write_row(self, dt: float, newton_iterations: int = 0, rejected: int = 0) -> None:
        row = {
            "step": self._ledger.step,
            "time": self._ledger.last.time,
            "dt": dt,
            **self._ledger.last.columns(),
            "newton_iterations": newton_iterations,
            "rejected": rejected,
            **self._ledger.columns(),
        }
        on_root(self._comm, lambda: self._table.write(row))

    def _open_fields(self, resume: bool) -> FieldFile | VtxFile:
        if self._kind == "vtx":
            return VtxFile(Path(f"{self._name}.bp"), self._stepper)
        return FieldFile(Path(f"{self._name}.xdmf"), self._stepper, resume=resume)

    def _open_table(self, resume: bool) -> None:
        """Open the table, after a look whether all files can be written."""
        if not (folder := Path(self._name).parent).is_dir():
            raise FileNotFoundError(f"expected an existing folder, given {folder}")
        suffixes = ("csv", "h5", "xdmf") if self._kind == "xdmf" else ("csv",)
        for other in (Path(f"{self._name}.{suffix}") for suffix in suffixes):
            if other.exists() and not (other.is_file() and os.access(other, os.W_OK)):
                raise OSError(f"expected a file that can be replaced, given {other}")
        if not resume:
            self._checkpoint.unlink(missing_ok=True)
        self._table.open(resume)
