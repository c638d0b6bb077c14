"""Recorder: fields for ParaView and a table of the balances of a run.

``name.xdmf`` with ``name.h5`` holds one time series: displacement, velocity,
number of the body and, at the contact nodes, gap, contact pressure and
active. ``name.csv`` has one row a step, flushed at once: a killed run leaves
whole rows.
"""

import copy
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

from dolfinx_nts.contact import ContactWork
from dolfinx_nts.diagnostics import Balance, Diagnostics
from dolfinx_nts.integrators import EnergyMomentum, Midpoint, StepReport
from dolfinx_nts.newton import ConvergenceError
from dolfinx_nts.timing import Timings

__all__ = ["Recorder"]

_logger = logging.getLogger("dolfinx_nts")


class Recorder:
    """Writes fields and balances of a run; use it in a ``with`` block.

    Entering writes the present state as the first row and fields; leaving
    closes the files, also after an exception. Files of the same name are
    replaced. Collective, as all methods; ``summary`` is local.

    Columns of the table, in SI units: ``step, time, dt``, the numbers of
    `Balance`, ``newton_iterations``, and the change of the total energy
    since the first row by cause: ``energy_bulk``,
    ``energy_persistent_contact``, ``energy_activation``,
    ``energy_facet_change``, ``energy_solver``. Each is summed on its own;
    ``energy_unaccounted`` is the rest: round-off, unless supports move or
    the state is set between steps.

    Fields of the contact nodes are 0 at other nodes, the gap is NaN there
    and where a node faces no segment.

    Args:
        name: Path of the files without suffix, in an existing folder.
        stepper: Midpoint or EnergyMomentum.
        every: Steps from one state of the fields to the next; the first
            and the last state are always there.

    Attributes:
        diagnostics: Diagnostics of the stepper.

    Raises:
        FileNotFoundError: The folder does not exist.
        ValueError: ``every`` is less than 1.
    """

    def __init__(
        self, name: str | Path, stepper: Midpoint | EnergyMomentum, *, every: int = 1
    ) -> None:
        """Check the arguments; nothing is created yet."""
        if every < 1:
            raise ValueError(f"expected fields every 1 step or more, given {every}")
        self.diagnostics = Diagnostics(stepper)
        self._name, self._stepper, self._every = str(name), stepper, every
        self._comm: MPI.Comm = stepper.u.function_space.mesh.comm
        folder = Path(self._name).parent
        if not self._comm.bcast(folder.is_dir()):
            raise FileNotFoundError(f"expected an existing folder, given {str(folder)!r}")
        self._timings: Timings = getattr(stepper, "timings", Timings())
        self._fields: _Fields | None = None
        self._table: TextIO | None = None

    def __enter__(self) -> "Recorder":
        """Open the files and write the present state.

        Raises:
            OSError: The table cannot be created.
        """
        self._start, self._seconds = time.perf_counter(), dict(self._timings.seconds)
        with self._timings.phase("output"):
            error: OSError | None = None
            if self._comm.rank == 0:
                try:
                    self._table = open(f"{self._name}.csv", "w", newline="", encoding="utf-8")
                except OSError as failure:
                    error = failure
            if error := self._comm.bcast(error):
                raise error
            try:
                self._fields = _Fields(self._name, self._stepper)
                self._fields.write()
                self._first = self.diagnostics.balance()
                self._bulk = self._solver = 0.0
                self._contact = ContactWork.zero()
                self._iterations: list[int] = []
                self._drift = np.zeros(3)
                self._write_row(self._first, 0.0, 0)
            except BaseException:
                self._close()
                raise
        return self

    def write(self, step: StepReport) -> None:
        """Add the row of a step and, when it is their turn, the fields.

        Args:
            step: Report of the step that the stepper has just done.

        Raises:
            ValueError: The recorder is not open, or a step is left out.
        """
        if self._fields is None:
            raise ValueError("expected an open recorder: use it in a with block")
        if not step.step == self._stepper.step == self._step + 1:
            raise ValueError(
                f"expected step {self._step + 1} (every step, at once), given step {step.step} "
                f"when the stepper has done {self._stepper.step}"
            )
        with self._timings.phase("output"):
            self._bulk += self.diagnostics.bulk_defect()
            self._contact = self._contact + step.contact_work
            self._solver += step.solver_work
            self._iterations.append(step.newton_iterations)
            self._write_row(self.diagnostics.balance(), step.dt, step.newton_iterations)
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
            try:
                if self._fields and (error is None or isinstance(error, ConvergenceError)):
                    self._fields.write()
            finally:
                self._close()
        self._stop = time.perf_counter()
        if self._comm.rank == 0:
            _logger.info("%s", self.summary())

    def summary(self) -> str:
        """What the run did: steps, iterations, drifts, time of this rank.

        Local; for after the ``with`` block.
        """
        its, first = self._iterations, self._first
        drift = zip(
            ("energy", "linear momentum", "angular momentum"),
            self._drift,
            (first.total_energy, *map(np.linalg.norm, (first.linear_momentum, first.angular_momentum))),
            ("J", "kg m/s", "kg m^2/s"),
            strict=True,
        )
        total = self._stop - self._start
        phases = {
            name: seconds - self._seconds.get(name, 0.0)
            for name, seconds in self._timings.seconds.items()
        }
        phases["other"] = total - sum(phases.values())
        lines = [
            f"{self._name}: {len(its)} steps from t = {first.time:g} to {self._time:g} s",
            f"Newton iterations: {sum(its)}, mean {np.mean(its or [0]):.2f}, max {max(its, default=0)}",
            *(f"drift of {name}: {d:.1e} {unit} of {start:.6g}" for name, d, start, unit in drift),
            f"wall time: {total:.1f} s: " + ", ".join(f"{n} {s:.1f}" for n, s in phases.items()),
        ]
        return "\n".join(lines)

    def _write_row(self, now: Balance, dt: float, newton_iterations: int) -> None:
        first, contact = self._first, self._contact
        self._step, self._time = self._stepper.step, now.time
        changes = (
            now.total_energy - first.total_energy,
            now.linear_momentum - first.linear_momentum,
            now.angular_momentum - first.angular_momentum,
        )
        self._drift = np.maximum(self._drift, [float(np.linalg.norm(c)) for c in changes])
        causes = {
            "bulk": self._bulk,
            "persistent_contact": contact.persistent,
            "activation": contact.activation,
            "facet_change": contact.facet_change,
            "solver": self._solver,
        }
        causes["unaccounted"] = changes[0] - sum(causes.values())
        row = {
            "step": self._step,
            "time": now.time,
            "dt": dt,
            "kinetic_energy": now.kinetic_energy,
            "strain_energy": now.strain_energy,
            "total_energy": now.total_energy,
            **_components("linear_momentum", now.linear_momentum),
            **_components("angular_momentum", now.angular_momentum),
            **_components("contact_force", now.contact_force),
            "active_nodes": now.active_nodes,
            "min_gap": now.min_gap,
            "newton_iterations": newton_iterations,
            **{f"energy_{cause}": work for cause, work in causes.items()},
        }
        if self._table:
            writer = csv.writer(self._table)
            if not self._iterations:
                writer.writerow(row)
            writer.writerow(row.values())
            self._table.flush()

    def _close(self) -> None:
        fields, table = self._fields, self._table
        self._fields = self._table = None
        if table:
            table.close()
        if fields:
            fields.close()


def _components(name: str, vector: Any) -> dict[str, float]:
    return {f"{name}_{axis}": float(value) for axis, value in zip("xyz", vector, strict=True)}


class _Fields:
    """The XDMF file. Collective, as all methods."""

    def __init__(self, name: str, stepper: Midpoint | EnergyMomentum) -> None:
        """Open the files and write the mesh."""
        self._stepper, self._path = stepper, Path(f"{name}.xdmf")
        V = stepper.u.function_space
        mesh = V.mesh
        self._comm: MPI.Comm = mesh.comm
        Q, self._dofs = V.sub(0).collapse()
        self._nodal = [fem.Function(Q, name=n) for n in ("gap", "contact_pressure", "active")]
        self._body = fem.Function(fem.functionspace(mesh, ("DG", 0)), name="body")
        for number, body in enumerate(stepper.bodies):
            self._body.x.array[body.cells] = number
        self._written: float | None = None
        self._file = io.XDMFFile(mesh.comm, str(self._path), "w")
        self._file.write_mesh(mesh)

    def write(self) -> None:
        """Write the present state, unless it has been written."""
        stepper = self._stepper
        if self._written == stepper.t:
            return
        values = np.zeros((len(stepper.x), len(self._nodal)))
        values[:, 0] = np.nan
        for pair in stepper.pairs:
            at, history = pair.nodes.nodes, pair.history
            values[at, 0] = np.fmin(values[at, 0], pair.gap(stepper.x))
            values[at, 1] += pair.pressure
            values[at, 2] = np.maximum(values[at, 2], history.active)
        for function, column in zip(self._nodal, values.T, strict=True):
            function.x.array[:] = column[np.asarray(self._dofs) // 3]
            function.x.scatter_forward()
        once = [self._body] if self._written is None else []
        for function in (stepper.u, stepper.v, *(self._nodal if stepper.pairs else []), *once):
            self._file.write_function(function, stepper.t)
        self._written = stepper.t

    def close(self) -> None:
        """Close the files; one grid a time, which every reader opens."""
        self._file.close()
        if self._comm.rank == 0:
            tree = ElementTree.parse(self._path)
            _merge(tree.getroot())
            tree.write(self._path, encoding="utf-8", xml_declaration=True)
        self._comm.barrier()


def _merge(root: ElementTree.Element) -> None:
    """Merge DOLFINx's series, one a function, into one of whole grids.

    ParaView shows separate series as unrelated blocks, and VTK's Xdmf2
    reader crashes on their references to the mesh (pyvista issue 6303).
    """
    domain = root[0]
    mesh, *series = domain
    body = series.pop()[0].find("Attribute")
    domain[:] = series[:1]
    series[0].set("Name", "state")
    for grids in zip(*series, strict=True):
        attributes = [grid.find("Attribute") for grid in grids]
        parts = [*copy.deepcopy(list(mesh)), grids[0].find("Time"), *attributes, body]
        grids[0][:] = [part for part in parts if part is not None]
        grids[0].set("Name", "state")
        for item in grids[0].iterfind(".//DataItem"):
            if "NumberType" not in item.attrib:  # Readers take float32 otherwise.
                item.attrib.update(NumberType="Float", Precision="8")
