"""Archives: what takes the state of a run and gives it back.

One description serves both ways. Every object with a state lists it in a
method ``serialize(archive)``: it passes each value and goes on with what comes
back, which is the value itself while the archive takes, and the kept value
while it gives. A step that is cut and a run that is resumed go the same way.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

from dolfinx_nts.common.arrays import Array, GlobalInts

__all__ = ["Archive", "Snapshot"]

T = TypeVar("T", float, int, bool, Array)


class Archive(ABC):
    """Takes or gives named values. Collective, as all its methods.

    Attributes:
        giving: Whether kept values come back.
    """

    giving: bool = False

    @abstractmethod
    def same(self, name: str, value: T) -> T:
        """Serialize a number or array that is the same on all ranks.

        Args:
            name: Name of the value.
            value: What is taken; while giving, its kind counts only.

        Returns:
            The kept value, or the one that was taken.
        """

    @abstractmethod
    def nodal(self, name: str, ids: GlobalInts, values: Array) -> Array:
        """Serialize values of owned nodes.

        Args:
            name: Name of the values.
            ids: Numbers of the nodes in the mesh as read, shape ``(n,)``.
            values: Shape ``(n, ...)``.

        Returns:
            The kept values of these nodes, or those that were taken.
        """

    @abstractmethod
    def local(self, name: str, arrays: Sequence[Array] | None) -> Sequence[Array] | None:
        """Serialize arrays that have a meaning on this rank only.

        They save work, or the last digit, and are never changed in place.

        Args:
            name: Name of the arrays.
            arrays: What is taken, on all ranks or on none.

        Returns:
            The arrays; None if there are none, on all ranks, which they
            are not for another partition of the mesh.
        """


class Snapshot(Archive):
    """Archive in memory; first it takes, after `rewind` it gives."""

    def __init__(self) -> None:
        """Start empty."""
        self._kept: dict[str, Any] = {}

    def rewind(self) -> "Snapshot":
        """Give back from now on."""
        self.giving = True
        return self

    def same(self, name: str, value: T) -> T:
        """Serialize a number or array that is the same on all ranks."""
        return self._copy(name, value)

    def nodal(self, name: str, ids: GlobalInts, values: Array) -> Array:
        """Serialize values of owned nodes."""
        return self._copy(name, values)

    def local(self, name: str, arrays: Sequence[Array] | None) -> Sequence[Array] | None:
        """Serialize arrays of this rank, the very same."""
        if not self.giving:
            self._kept[name] = arrays
        kept: Sequence[Array] | None = self._kept.get(name)
        return kept

    def _copy(self, name: str, value: T) -> T:
        if self.giving:
            kept: T = self._kept[name]
            return kept.copy() if isinstance(kept, np.ndarray) else kept
        self._kept[name] = value.copy() if isinstance(value, np.ndarray) else value
        return value
