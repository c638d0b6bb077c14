"""Forces that do the work of a static step."""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, GlobalInts

__all__ = ["MeanForces"]


class MeanForces:
    """Means of the forces at both ends of static steps, which do the work (trapezoidal rule).

    Works of the end forces alone would be of first order in the increment, these are of second
    order. Before the first step all forces are zero.

    Args:
        ids: Input numbers of the owned nodes, shape ``(n,)``.
        d: Number of components of a force.
        num: Number of forces.
    """

    def __init__(self, ids: GlobalInts, d: int, num: int) -> None:
        self._ids, self._are_known = ids, True
        self._last: Floats = np.zeros((len(ids), num, d))

    def forget(self) -> None:
        """Discard the last forces: the end forces do the work of the next step. Local."""
        self._are_known = False

    def of(self, forces: Sequence[Floats]) -> list[Floats]:
        """Mean forces of a step that is accepted; its end forces are stored. Local.

        Args:
            forces: Forces at the end of the step on the owned dofs, each ``(d n,)`` [N].
        """
        n, _, d = self._last.shape
        now = np.stack([force.reshape(n, d) for force in forces], axis=1)
        mean = (self._last + now) / 2 if self._are_known else now
        self._last, self._are_known = now, True
        return [force.ravel() for force in mean.swapaxes(0, 1)]

    def of_contact(self, last: Floats, force: Floats) -> Floats:
        """Mean contact forces of a step, before `of`. Local.

        Args:
            last: Forces on the nodes at the start of the step, shape ``(n, 3)`` [N].
            force: Forces at its end, of the same shape [N].
        """
        return (last + force) / 2 if self._are_known else force

    def serialize(self, archive: Archive) -> None:
        """Serialize the forces of the last step. Collective."""
        self._are_known = archive.same("forces_are_known", self._are_known)
        self._last = archive.nodal("last_forces", self._ids, self._last)
