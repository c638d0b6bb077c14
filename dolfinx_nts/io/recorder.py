"""Recorder: writes table, fields and checkpoints of a run."""

import logging
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, get_args

from mpi4py import MPI

from dolfinx_nts.common.arguments import as_call, chosen_times, whole
from dolfinx_nts.diagnostics.balance import Diagnostics
from dolfinx_nts.diagnostics.columns import OwnColumn, Parts, RunColumns
from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.diagnostics.energy_ledger import EnergyLedger
from dolfinx_nts.integrators.report import StepReport
from dolfinx_nts.integrators.statics.quasi_static import QuasiStatic
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io.fields import OwnField, RunFields
from dolfinx_nts.io.run_files import RunFiles
from dolfinx_nts.io.summary import Summary
from dolfinx_nts.model.rigid_body import guided
from dolfinx_nts.parallel.collective_calls import meet
from dolfinx_nts.parallel.signals import Interrupts
from dolfinx_nts.solvers.newton_report import ConvergenceError

__all__ = ["Recorder"]

_logger = logging.getLogger("dolfinx_nts")

FieldsKind = Literal["vtkhdf", "xdmf", "vtx"]


class Recorder:
    """Writes a table, the fields and checkpoints of a run.

    A recorder works in a ``with`` block. Entering the block creates the files, replaces files of
    the same name, and writes the initial state. `write` adds a step. Leaving the block, also by
    an exception, closes the files. All files can be read at any time, also after the program has
    been killed. Collective, as all methods except `summary`.

    The **table** ``name.csv`` has a row for each step. Its columns, in SI units, are ``step``,
    ``dt``, the columns of `Balance`, ``newton_iterations``, ``rejected``, and the change of the
    total energy since the first row by cause: ``energy_bulk``, ``energy_loads``,
    ``energy_supports``, ``energy_obstacles``, ``energy_damping``, ``energy_persistent_contact``,
    ``energy_activation``, ``energy_facet_change``, ``energy_friction``, ``energy_solver``,
    ``energy_surface_equilibrium`` and ``energy_refund``. Each cause is summed separately. The rest
    is ``energy_unaccounted``: round-off, unless the user sets the state between steps.
    ``external_work`` is the work of loads, supports and obstacles, ``friction_dissipation`` the
    energy dissipated by friction. Further columns describe parts of the scene, named
    ``kind_name_quantity``: `PairBalance` of each pair, ``ObstacleBalance`` of each obstacle,
    `Reaction` of each support and its work since the first row, the work of each load since then,
    and `BodyBalance` of each body.

    The **fields** ``name.vtkhdf`` can be opened with ParaView 5.13 and VTK 9.4 or newer. Their
    values are in the folder ``name_fields``, in one HDF5 file for the mesh and one for several
    states. States are buffered for about a second: a kill loses them, an error on all ranks does
    not. With ``fields="xdmf"`` the file is ``name.xdmf``, which older programs and meshio read
    too, and each state is written immediately to its own file.

    A **checkpoint** ``name.checkpoint.h5`` contains all data on which the run depends. With
    ``checkpoint_every`` it is replaced at these steps, at the end, and after Ctrl-C, SIGTERM or
    output to a closed pipe. Such a signal takes effect after the current step, a second one
    immediately; the log names the step of the checkpoint. Ignored signals stay ignored. With
    ``resume`` a restarted script continues from the checkpoint, on any number of ranks; rows and
    states after the step of the checkpoint are removed. The length of steps is taken from the
    checkpoint, unless the script has changed ``dt``.

    The log warns once if bulk and inertia have added more than a tenth of the total energy, except
    in statics.

    While the block is open, ``name.lock`` contains host and process of the run, and other runs
    with the same files are refused. The lock ends with the process.

    Args:
        name: Path of the files without suffix, in an existing folder.
        stepper: Stepper of the run.
        every: Number of steps between states of the fields. The first and the last state are
            always written.
        times: Times at which the fields are written instead [s], such as for a
            `StepControl`.
        checkpoint_every: Number of steps between checkpoints; None for no checkpoints.
        resume: Whether to continue from an existing checkpoint.
        columns_of: Parts of the scene with columns in the table: ``"pairs"``,
            ``"between"`` (forces between each two bodies), ``"obstacles"``, ``"supports"``,
            ``"loads"`` and ``"bodies"``, the last only on request.
        stress: Whether to write Cauchy stress, von Mises stress and strain energy density of the
            cells, and the equivalent plastic strain of plastic materials.
        own_columns: Functions by the name of a column, which return a number or a vector of
            three for a stepper, the same on all ranks. All ranks call them for each row.
        own_fields: Functions by the name of a field. Each is called with the stepper. It returns a
            DOLFINx Function with values at the nodes, or values at the owned nodes in the order of
            ``stepper.x``, shape ``(n,)`` or ``(n, 3)``, in the plane also ``(n, 2)``. A Function
            itself is possible, too; the user updates it.
        fields: Kind of the file of fields: ``"vtkhdf"``, ``"xdmf"`` or ``"vtx"``. The last is a
            folder ``name.bp``, which all ranks write and which cannot be resumed; it needs a
            DOLFINx with ADIOS2.

    Attributes:
        diagnostics: Energies, momenta and contact forces of the stepper.

    Raises:
        RuntimeError: ``fields`` is ``"vtx"`` and DOLFINx has no ADIOS2.
        TypeError: ``columns_of`` is not a list.
        ValueError: ``every`` or ``checkpoint_every`` is less than 1; ``columns_of`` has another
            word; ``fields`` is another kind, or one that cannot be resumed or has no stress; a
            name in ``own_fields`` has letters that Python names cannot have; ``name`` is a
            folder, or has a colon, a backslash or characters that cannot be printed.

    Example:
        >>> with nts.Recorder("run", stepper, every=10, checkpoint_every=50) as record:
        ...     for step in stepper.run(until=0.05):
        ...         record.write(step)
        >>> print(record.summary())
        run: 5 steps from t = 0 to 0.05 s
        total energy: 250 J, ...
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
        columns_of: Collection[Parts] = ("pairs", "between", "obstacles", "supports", "loads"),
        stress: bool = False,
        own_columns: Mapping[str, OwnColumn] | None = None,
        own_fields: Mapping[str, OwnField] | None = None,
        fields: FieldsKind = "vtkhdf",
    ) -> None:
        if isinstance(columns_of, str):
            raise TypeError(f"expected a list of parts as columns_of, given {columns_of!r}")
        self._options = _Options(
            name=str(name),
            every=every,
            times=None if times is None else chosen_times(times),
            checkpoint_every=checkpoint_every,
            resume=resume,
            columns_of=tuple(columns_of),
            stress=stress,
            own_columns=tuple(own_columns or ()),
            own_fields=tuple(own_fields or ()),
            fields=fields,
        )
        self._stepper = stepper
        self.diagnostics = Diagnostics(stepper)
        self._columns = RunColumns(self.diagnostics, columns_of, own_columns)
        self._files = RunFiles(str(name), stepper, fields, RunFields(stepper, stress, own_fields))
        comm: MPI.Comm = stepper.u.function_space.mesh.comm
        self._comm = comm
        self._interrupts = Interrupts(comm)
        self._open: ExitStack | None = None
        self._summary: Summary | None = None
        self._last: StepReport | None = None
        self._has_warned = False

    def __repr__(self) -> str:
        """Constructor call of an equal recorder, with the class of the stepper."""
        options = asdict(self._options)
        return as_call(self, name=options.pop("name"), stepper=type(self._stepper), **options)

    def __enter__(self) -> "Recorder":
        """Create the files and write the initial state, or resume the run.

        Raises:
            OSError: The folder does not exist, another run writes to these files, or one of
                them cannot be created or replaced. Nothing has been created.
            ValueError: The checkpoint is damaged or of another scene, or the table is not that
                of the run. Nothing has been changed.
        """
        meet(self._comm, f"open {self!r}")
        self._summary = Summary(self._options.name, self._stepper)
        stepper, one_state = self._stepper, self.diagnostics.one_state
        with stepper.timings.phase("output"), one_state() as now, ExitStack() as stack:
            now.gaps()  # for the first fields; the row reuses these gaps
            num_supports = len(stepper.supports) + len(guided(stepper.bodies))
            self._ledger = EnergyLedger(
                stepper.step, self.diagnostics.balance(), len(stepper.loads), num_supports
            )
            first = self._columns.row(None, self._ledger)
            stack.callback(self._files.close)
            if not self._files.open(self._ledger, list(first), self._options.resume):
                self._files.fields.write(now)
                self._files.write_row(first)
            if self._options.checkpoint_every is not None:
                stack.enter_context(self._interrupts)
            self._open = stack.pop_all()
        return self

    def write(self, step: StepReport) -> None:
        """Add a step to the table and, if due, to the fields.

        Args:
            step: Report of the last step of the stepper.

        Raises:
            OSError: A file cannot be written, for instance because the disk is full.
            ValueError: The recorder is not open, or a step was skipped.
        """
        meet(self._comm, f"write step {step.step} of {self._options.name}")
        if self._open is None:
            raise ValueError(
                "expected write() inside the with block of the recorder, given a call outside: "
                "with nts.Recorder(name, stepper) as record: ..."
            )
        due = self._ledger.step + 1
        if not step.step == self._stepper.step == due:
            raise ValueError(
                f"expected write() after every step, next for step {due}, given step {step.step} "
                f"after {self._stepper.step} steps"
            )
        with self._stepper.timings.phase("output"), self.diagnostics.one_state() as now:
            has_fields = self._options.has_fields(self._ledger.num_steps + 1, step.t)
            if has_fields:
                now.gaps()  # for the fields; the row reuses these gaps
            self._ledger.add(step, *self.diagnostics.after_step())
            self._warn_of_spurious_gain()
            self._files.write_row(self._columns.row(step, self._ledger))
            self._last = step
            if has_fields:
                self._files.fields.write(now)
            if self._options.checkpoint_every is not None:
                signum = self._interrupts.received()
                if signum or self._ledger.num_steps % self._options.checkpoint_every == 0:
                    self._files.save(self._ledger)
                if signum:
                    self._log_end(f"interrupted after step {step.step}")
                    self._interrupts.take_effect(signum)

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Write the last state and close the files.

        After an error other than `ConvergenceError` ranks may be in different steps, and nothing is
        written.
        """
        assert self._open is not None and self._summary is not None
        stack, self._open = self._open, None
        together = error is None or isinstance(error, ConvergenceError)
        with self._stepper.timings.phase("output"), stack:
            if together:
                meet(self._comm, f"close {self._options.name} after step {self._ledger.step}")
                self._stepper.check_overlaps()
                if isinstance(self._stepper, QuasiStatic):
                    self._summary.describe_equilibrium(self.diagnostics, self._last)
                self._files.fields.write(CurrentState(self._stepper))
                if self._options.checkpoint_every is not None:
                    self._files.save(self._ledger)
                self._files.fields.close()
        if isinstance(error, KeyboardInterrupt) and not self._interrupts.took_effect:
            self._log_end(f"interrupted immediately, in the step after {self._ledger.step}")
        self._summary.stop()
        if self._comm.rank == 0:
            _logger.info("%s", self.summary())

    def summary(self) -> str:
        """Describe the run after the ``with`` block. Local.

        Returns:
            Lines with the number of steps, changes of conserved quantities and the energy that
            is unaccounted for; then the columns of the solver, with iterations and wall time by
            phase [s] on this rank.

        Raises:
            ValueError: The ``with`` block has not been entered.
        """
        if self._summary is None:
            raise ValueError(
                "expected summary() in or after the with block of the recorder, given a call "
                "before: with nts.Recorder(name, stepper) as record: ..."
            )
        return self._summary.text(self._ledger)

    def _warn_of_spurious_gain(self) -> None:
        """Warn once if the scheme adds much energy. Local."""
        gain, is_static = self._ledger.spurious_gain, isinstance(self._stepper, QuasiStatic)
        if gain == 0.0 or is_static or self._has_warned:
            return
        self._has_warned = True
        if self._comm.rank == 0:
            _logger.warning(
                "%s has added %.3g J to the energy until t = %g s, of %.3g J now and %.3g J at the "
                "start (energy_bulk in %s.csv): use EnergyMomentum or shorter steps",
                type(self._stepper).__name__,
                gain,
                self._ledger.last.time,
                self._ledger.last.total_energy,
                self._ledger.first.total_energy,
                self._options.name,
            )

    def _log_end(self, what: str) -> None:
        """Log on the first rank why the run ends, and how to continue it. Local."""
        if self._comm.rank == 0:
            _logger.warning("%s; %s", what, self._files.how_to_go_on())


@dataclass(frozen=True)
class _Options:
    """Checked arguments of a `Recorder`, with the same names."""

    name: str
    every: int
    times: tuple[float, ...] | None
    checkpoint_every: int | None
    resume: bool
    columns_of: tuple[str, ...]
    stress: bool
    own_columns: tuple[str, ...]
    own_fields: tuple[str, ...]
    fields: str

    def __post_init__(self) -> None:
        if self.fields not in get_args(FieldsKind):
            names = ", ".join(map(repr, get_args(FieldsKind)))
            raise ValueError(f"expected fields to be one of {names}, given {self.fields!r}")
        if self.fields == "vtx" and self.resume:
            raise ValueError(
                "expected fields='vtkhdf' with resume, given 'vtx', which cannot be resumed"
            )
        if self.fields == "vtx" and self.stress:
            raise ValueError(
                "expected fields='vtkhdf' with stress, given 'vtx', which has nodal fields only"
            )
        whole("every", self.every)
        if self.checkpoint_every is not None:
            whole("checkpoint_every", self.checkpoint_every)

    def has_fields(self, count: int, t: float) -> bool:
        """Whether fields are due after ``count`` steps, at time t."""
        return count % self.every == 0 if self.times is None else t in self.times
