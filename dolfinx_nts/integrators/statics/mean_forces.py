"""Forces that do the work of a step."""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, GlobalInts

__all__ = ["MeanForces"]


class MeanForces:
    """Forces that do the work of a step: in statics the means of those at both ends.

    A static step knows the forces at its end, and with them works would be of first order in the
    increment. Those of the trapezoidal rule are of second order. A dynamic scheme defines the
    forces that act in a step, which are returned unchanged.

    Args:
        ids: Input numbers of the owned nodes, shape ``(n,)``.
        d: Number of components of a force.
        num: Number of forces.
        is_static: Whether bodies have no inertia.
    """

    def __init__(self, ids: GlobalInts, d: int, num: int, *, is_static: bool) -> None:
        self._ids, self._is_static, self._are_known = ids, is_static, True
        self._last: Floats = np.zeros((len(ids), num, d))

    def forget(self) -> None:
        """Discard the forces of the last step: the next work is that of the end forces. Local."""
        self._are_known = False

    def of(self, forces: Sequence[Floats]) -> list[Floats]:
        """Forces that do the work of a step that is accepted. Local.

        Args:
            forces: Forces of the step on the owned dofs, each ``(d n,)`` [N].
        """
        if not self._is_static:
            return list(forces)
        n, _, d = self._last.shape
        now = np.stack([force.reshape(n, d) for force in forces], axis=1)
        mean = (self._last + now) / 2 if self._are_known else now
        self._last, self._are_known = now, True
        return [force.ravel() for force in mean.swapaxes(0, 1)]

    def of_contact(self, last: Floats, force: Floats) -> Floats:
        """The same for contact forces at both ends of a step, shape ``(n, 3)`` [N]. Local."""
        return (last + force) / 2 if self._is_static and self._are_known else force

    def serialize(self, archive: Archive) -> None:
        """Serialize the forces of the last step. Collective."""
        if self._is_static:
            self._are_known = archive.same("forces_are_known", self._are_known)
            self._last = archive.nodal("last_forces", self._ids, self._last)
