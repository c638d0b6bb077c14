"""What the files of fields of all kinds can do."""

from typing import Protocol

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.diagnostics.present import Present

__all__ = ["FieldsFile"]


class FieldsFile(Protocol):
    """File with the fields of a run. Collective, as all its methods except `check`."""

    def check(self) -> None:
        """Refuse names under which nothing can be written. Local."""

    def serialize(self, archive: Archive) -> None:
        """Serialize which states have been written."""

    def open(self, resume: bool) -> None:
        """Create the files, or continue them."""

    def write(self, now: Present) -> None:
        """Write the present state, perhaps later, unless that has been done."""

    def flush(self) -> None:
        """Wait until the disk has all states."""

    def close(self) -> None:
        """Complete the files."""

    def leave(self) -> None:
        """Write what is held back after an error, unless the ranks are apart."""
