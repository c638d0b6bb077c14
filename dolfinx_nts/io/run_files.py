"""Files of one run, which are opened, saved and resumed together."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from mpi4py import MPI

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.diagnostics.energy_ledger import EnergyLedger
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.io import checkpoint
from dolfinx_nts.io.atomic_file import check_replaceable
from dolfinx_nts.io.checkpoint import HasState
from dolfinx_nts.io.csv_table import Table
from dolfinx_nts.io.fields import RunFields
from dolfinx_nts.io.formats.vtkhdf import VtkHdfFile
from dolfinx_nts.io.formats.vtx import VtxFile
from dolfinx_nts.io.formats.xdmf import XdmfFile
from dolfinx_nts.io.name_lock import NameLock
from dolfinx_nts.parallel.communication import on_root

__all__ = ["FieldsFile", "RunFiles", "ScriptedStep"]

# Relative difference of step lengths [-] that counts as round-off: the estimates of explicit
# steppers depend slightly on the partition.
_ROUND_OFF = 1e-9


class ScriptedStep:
    """Length of steps in the script, which a resumed run compares with that of the checkpoint.

    An unchanged script continues with the step length of the checkpoint. A script with another
    ``dt`` continues with its new ``dt``.

    Args:
        stepper: Stepper of the run, before a checkpoint is restored.
    """

    def __init__(self, stepper: Stepper) -> None:
        self._stepper, self._dt = stepper, stepper.dt

    def serialize(self, archive: Archive) -> None:
        """Serialize the step length; a length that the script has changed is set again. Collective.

        Raises:
            ValueError: The step length is not stable.
        """
        before = archive.same("scripted_dt", self._dt)
        if not math.isclose(self._dt, before, rel_tol=_ROUND_OFF):
            self._stepper.dt = self._dt


class FieldsFile(Protocol):
    """File with the fields of a run. Collective, as all its methods except `check`."""

    def check(self) -> None:
        """Check that the files can be written. Local."""

    def serialize(self, archive: Archive) -> None:
        """Serialize which states have been written."""

    def open(self, resume: bool) -> None:
        """Create the files, or continue them."""

    def write(self, now: CurrentState) -> None:
        """Write the current state, possibly buffered, unless it was written before."""

    def flush(self) -> None:
        """Wait until the disk has all states."""

    def close(self) -> None:
        """Complete the files."""

    def leave(self) -> None:
        """Write buffered states after an error, unless ranks are in different steps."""


# Suffix and writer by the kind of the file of fields.
_KINDS: dict[str, tuple[str, Callable[[Path, Stepper, RunFields], FieldsFile]]] = {
    "vtkhdf": ("vtkhdf", VtkHdfFile),
    "xdmf": ("xdmf", XdmfFile),
    "vtx": ("bp", VtxFile),
}


class RunFiles:
    """Table, fields and checkpoint of a run.

    Collective, as all its methods except `how_to_go_on`.

    Args:
        name: Path of the files without suffix.
        stepper: Stepper of the run.
        kind: Kind of the file of fields, ``"vtkhdf"``, ``"xdmf"`` or ``"vtx"``.
        fields: Fields of each state.

    Attributes:
        fields: File of the fields.

    Raises:
        ValueError: The name is a folder, or has characters that are invalid in XDMF.
    """

    def __init__(self, name: str, stepper: Stepper, kind: str, fields: RunFields) -> None:
        _check_name(name)
        self._stepper = stepper
        self._comm: MPI.Comm = stepper.u.function_space.mesh.comm
        self._table = Table(Path(f"{name}.csv"))
        self._checkpoint = Path(f"{name}.checkpoint.h5")
        self._lock = NameLock(Path(f"{name}.lock"))
        # Step and time of the last checkpoint, or of the start.
        self._saved = (0, 0.0)
        self._script: ScriptedStep
        suffix, file = _KINDS[kind]
        self.fields: FieldsFile = file(Path(f"{name}.{suffix}"), stepper, fields)

    def open(self, ledger: EnergyLedger, columns: Sequence[str], resume: bool) -> bool:
        """Create the files, or resume the run from its checkpoint.

        Args:
            ledger: Ledger of the run, a part of the checkpoint.
            columns: Names of the columns of the table.
            resume: Whether to resume the run if there is a checkpoint.

        Returns:
            Whether the run has been resumed.

        Raises:
            OSError: The folder does not exist, another run writes to these files, or one of
                them cannot be created or replaced. Nothing has been created.
            ValueError: The checkpoint is damaged or of another scene, or the table is not that
                of the run. Nothing has been changed.
        """

        def take() -> bool:
            folder = self._checkpoint.parent
            if not folder.is_dir():
                raise FileNotFoundError(f"expected an existing folder, given {folder}")
            self._lock.take()
            return resume and self._checkpoint.exists()

        self._script = ScriptedStep(self._stepper)
        resume = on_root(self._comm, take)
        if resume:
            checkpoint.load(self._checkpoint, self._stepper, *self._others(ledger))
        self._saved = (ledger.step, ledger.last.time)

        def open_table() -> None:
            check_replaceable(self._table.path)
            self.fields.check()
            if not resume:
                self._checkpoint.unlink(missing_ok=True)
            self._table.open(columns, resume)

        on_root(self._comm, open_table)
        self.fields.open(resume)
        return resume

    def write_row(self, row: Mapping[str, float]) -> None:
        """Add a row to the table.

        Args:
            row: Values by name.
        """
        on_root(self._comm, lambda: self._table.write(row))

    def save(self, ledger: EnergyLedger) -> None:
        """Write a checkpoint of the current step, unless it was written before.

        All rows and fields up to this step are synchronised with the disk first.

        Args:
            ledger: Ledger of the run.

        Raises:
            OSError: A file cannot be written. The former checkpoint is unchanged.
        """
        if self._saved[0] == ledger.step:
            return
        self.fields.flush()
        on_root(self._comm, self._table.sync)
        checkpoint.save(self._checkpoint, self._stepper, *self._others(ledger))
        self._saved = (ledger.step, ledger.last.time)

    def how_to_go_on(self) -> str:
        """Text with the step of the checkpoint and instructions to continue the run. Local."""
        if not self._checkpoint.exists():
            return (
                "there is no checkpoint: with Recorder(..., checkpoint_every=50, resume=True) a "
                "restarted script continues where it was interrupted"
            )
        step, t = self._saved
        return (
            f"{self._checkpoint} holds step {step}, t = {t:g}: the same script with Recorder(..., "
            "resume=True) continues from there"
        )

    def _others(self, ledger: EnergyLedger) -> Sequence[HasState]:
        """Objects whose state a checkpoint contains in addition to the stepper."""
        return ledger, self._table, self.fields, self._script

    def close(self) -> None:
        """Close the files and release the lock, even if ranks are in different steps.

        Raises:
            OSError: Buffered states cannot be written.
        """
        self._table.close()
        try:
            self.fields.leave()
        finally:
            self._lock.release()


def _check_name(name: str) -> None:
    """Check that files with this name can be written and read."""
    last = name.rpartition("/")[2]
    if last in ("", ".", ".."):
        raise ValueError(
            f"expected the path of files without suffix, such as 'results/run', given {name!r}, "
            "a folder"
        )
    if (suffix := Path(last).suffix) in (".csv", ".h5", ".vtkhdf", ".vtu", ".xdmf"):
        raise ValueError(
            f"expected the path of files without suffix, such as 'results/run', given {name!r}: "
            f"omit {suffix}, as each file of the run has its own suffix"
        )
    if unfit := sorted({c for c in last if c in ":\\" or not c.isprintable()}):
        raise ValueError(
            "expected a name that readers of XDMF accept, without "
            f"{' and '.join(map(repr, unfit))}, given {last!r}"
        )
