"""Recorder: fields for ParaView and a table of the balances of a run."""

import logging
import os
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import fields as fields_of
from pathlib import Path
from types import TracebackType
from typing import Literal

from mpi4py import MPI

import numpy as np

from dolfinx_nts import checkpoint
from dolfinx_nts.archive import Archive
from dolfinx_nts.compat import vtx_writer
from dolfinx_nts.contact_history import ContactWork
from dolfinx_nts.diagnostics import Balance, Diagnostics
from dolfinx_nts.interrupts import Interrupts
from dolfinx_nts.newton import ConvergenceError
from dolfinx_nts.ranks import on_root
from dolfinx_nts.report import StepReport
from dolfinx_nts.stepper import Stepper
from dolfinx_nts.sunk import SunkVertices
from dolfinx_nts.table import Table
from dolfinx_nts.timing import Timings
from dolfinx_nts.vtx import VtxFile
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
            self._first = self._last = self.diagnostics.balance()
            self._step = self._saved = self._stepper.step
            self._sunk = SunkVertices(self._stepper)
            self._count = self._newton = self._most = 0  # steps, iterations, most in a step
            self._bulk = self._loads = self._supports = self._damping = self._solver = 0.0
            self._contact = ContactWork()
            self._drift = dict.fromkeys(_CONSERVED, 0.0)
            self._table.size = 0
            resume = on_root(self._comm, lambda: self._resume and self._checkpoint.exists())
            if resume:
                checkpoint.load(self._checkpoint, self._stepper, self)
                self._saved = self._step
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

    def exchange(self, archive: Archive) -> None:
        """Exchange the sums of the table. Collective.

        Args:
            archive: Takes them or gives them.
        """
        self._step = archive.same("record/step", self._step)
        for name in ("_count", "_newton", "_most"):
            setattr(self, name, archive.same(f"record/{name[1:]}", getattr(self, name)))
        self._table.size = archive.same("record/table_size", self._table.size)
        for name in ("_bulk", "_loads", "_supports", "_damping", "_solver"):
            setattr(self, name, archive.same(f"record/{name[1:]}", getattr(self, name)))
        for name in self._drift:
            self._drift[name] = archive.same(f"record/drift/{name}", self._drift[name])
        for name, kind, value in (
            ("contact", ContactWork, self._contact),
            ("first", Balance, self._first),
            ("last", Balance, self._last),
        ):
            kept = {
                f.name: archive.same(f"record/{name}/{f.name}", getattr(value, f.name))
                for f in fields_of(kind)
            }
            setattr(self, f"_{name}", kind(**kept))

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
            self._count += 1
            self._newton += step.newton_iterations
            self._most = max(self._most, step.newton_iterations)
            self._write_row(step.dt, step.newton_iterations, step.rejected)
            due = self._count % self._every == 0
            if due if self._times is None else step.t in self._times:
                self._fields.write()
                self._sunk.look()
            if self._checkpoint_every is not None:
                signum = self._interrupts.received()
                if signum or self._count % self._checkpoint_every == 0:
                    self._save()
                if signum:
                    self._interrupts.take_effect(signum)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the last fields, unless ranks may be apart, and close."""
        with self._timings.phase("output"):
            with self._files:
                if self._fields and (error is None or isinstance(error, ConvergenceError)):
                    self._fields.write()
                    if self._checkpoint_every is not None and self._saved != self._step:
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
        checkpoint.save(self._checkpoint, self._stepper, self)
        self._saved = self._step

    def summary(self) -> str:
        """Steps, iterations, drifts and wall time, after the ``with`` block.

        Local; the times are those of this rank.
        """
        count, first = self._count, self._first
        phases = {
            name: seconds - self._seconds.get(name, 0.0)
            for name, seconds in self._timings.seconds.items()
        }
        phases["other"] = self._time - sum(phases.values())
        mean = self._newton / max(count, 1)
        lines = [f"{self._name}: {count} steps from t = {first.time:g} to {self._last.time:g} s"]
        lines += [f"Newton iterations: {self._newton}, mean {mean:.2f}, max {self._most}"]
        lines += self._stepper.describe()
        for name, unit in _CONSERVED.items():
            size = np.linalg.norm(getattr(first, name))
            drift = f"largest change {self._drift[name]:.1e} {unit}"
            lines += [f"{name.replace('_', ' ')}: {size:.6g} {unit}, {drift}"]
        for i, depth in self._sunk.deepest.items():
            if depth > 0:
                lines += [f"pair {i + 1}: vertices of segments up to {depth:.3g} m inside"]
        times = ", ".join(f"{name} {seconds:.1f}" for name, seconds in phases.items())
        return "\n".join([*lines, f"wall time: {self._time:.1f} s ({times})"])

    def _write_row(self, dt: float, newton_iterations: int = 0, rejected: int = 0) -> None:
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
            "rejected": rejected,
            **causes,
            "energy_unaccounted": rest,
            "external_work": self._loads + self._supports,
            "friction_dissipation": -contact.friction,
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
