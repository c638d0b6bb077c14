"""Archives, which store and restore the state of a run.

Every object with a state has a method ``serialize(archive)``: it passes each value of its state to
the archive, and assigns the returned value. This is the value itself while the archive stores, and
the stored value while it restores. Both repeated steps with a smaller dt and resumed runs use
archives.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

from dolfinx_nts.common.arrays import Array, GlobalInts

__all__ = ["Archive", "Snapshot"]

T = TypeVar("T", float, int, bool, Array)


class Archive(ABC):
    """Stores named values, or restores them. Collective, as are all its methods.

    Attributes:
        restores: Whether the archive restores.
    """

    restores: bool = False

    @abstractmethod
    def same(self, name: str, value: T) -> T:
        """Serialize a number or an array that is the same on all ranks.

        Args:
            name: Name of the value.
            value: The value to store. While the archive restores, only its type is used.

        Returns:
            The value itself, or while restoring the stored one.
        """

    @abstractmethod
    def nodal(self, name: str, ids: GlobalInts, values: Array) -> Array:
        """Serialize values of owned nodes.

        Args:
            name: Name of the values.
            ids: Node numbers that do not depend on the partition, shape ``(n,)``.
            values: One row for each node, shape ``(n, ...)``.

        Returns:
            The values themselves, or while restoring the stored ones of these nodes.
        """

    @abstractmethod
    def local(self, name: str, arrays: Sequence[Array] | None) -> Sequence[Array] | None:
        """Serialize arrays that are meaningful on this rank only, and are never changed in place.

        Such arrays save computations, or make results of a resumed run equal to the last digit.

        Args:
            name: Name of the arrays.
            arrays: The arrays to store, or None on all ranks.

        Returns:
            The arrays themselves, or the stored ones while restoring. None on all ranks if none
            were stored, or if they were stored for another partition of the mesh.
        """


class Snapshot(Archive):
    """Archive in memory for one step: it stores values, and restores them after `rewind`. Local."""

    def __init__(self) -> None:
        self._values: dict[str, Any] = {}

    def rewind(self) -> "Snapshot":
        """Restore from now on; return the snapshot itself."""
        self.restores = True
        return self

    def same(self, name: str, value: T) -> T:
        return self._copy(name, value)

    def nodal(self, name: str, ids: GlobalInts, values: Array) -> Array:
        return self._copy(name, values)

    def local(self, name: str, arrays: Sequence[Array] | None) -> Sequence[Array] | None:
        """Serialize arrays of this rank without copying them."""
        if not self.restores:
            self._values[name] = arrays
        stored: Sequence[Array] | None = self._values.get(name)
        return stored

    def _copy(self, name: str, value: T) -> T:
        if self.restores:
            stored: T = self._values[name]
            return stored.copy() if isinstance(stored, np.ndarray) else stored
        self._values[name] = value.copy() if isinstance(value, np.ndarray) else value
        return value
