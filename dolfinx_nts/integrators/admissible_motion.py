"""Motions that supports, guides and rigid bodies admit in a step."""

from collections.abc import Sequence

from dolfinx import fem

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.solvers.bulk import Bulk

__all__ = ["AdmissibleMotion"]


class AdmissibleMotion:
    """Displacements at the end of a step, as supports, guides and rigid bodies let them be.

    Args:
        bulk: Balance of the bodies, with their supports and rigid motions.
        u: Displacement at the end of the step, which is overwritten for a moment.
        u_n: Displacement at its start.
    """

    def __init__(self, bulk: Bulk, u: fem.Function, u_n: fem.Function) -> None:
        self._bulk, self._u, self._u_n = bulk, u, u_n.x.array

    def displacements(self, u: Floats, part: float = 1.0) -> Floats:
        """The admissible ones next to displacements u of the local dofs [m]. Collective.

        With a part of the step, displacements after that part of the way from those at its start.
        """
        u_n, rigid = self._u_n, self._bulk.rigid
        u = self._bulk.supports.applied(u)
        if part < 1:
            u = u_n + part * (u - u_n)
        if rigid.exists:
            trial, du, led = self._u.x, self.owned(u - u_n), rigid.guides.prescribed
            self.owned(trial.array)[:] = rigid.moved(self.owned(u_n), du, part * led)
            trial.scatter_forward()
            u = trial.array.copy()
            trial.array[:] = u_n
        return u

    def given(self, x_n: Floats, contacts: Sequence[PairState]) -> Floats:
        """Displacements that are given in the step, at the owned dofs [m]. Collective.

        Those of supports and guided bodies, and those of obstacles at nodes that may touch them.

        Args:
            x_n: Positions of the local nodes at the start of the step, shape ``(l, 3)`` [m].
            contacts: All contact.
        """
        # Where guides rest, rigid bodies move by round-off, which has no direction.
        rigid = self._bulk.rigid
        led = self.displacements if rigid.guides.are_moving else self._bulk.supports.applied
        u_n = self._u_n
        ways: Floats = (led(u_n) - u_n)[: self._bulk.num_owned]
        for contact in contacts:
            frame, nodes = contact.search.frame, contact.nodes.nodes
            if frame.moves:
                way = frame.in_space(frame.at_start(x_n[nodes])) - x_n[nodes]
                self.owned(ways)[nodes] += way[:, : rigid.dim]
        return ways

    def owned(self, values: Floats) -> Floats:
        """Those of the owned nodes among values of dofs, a view of shape ``(n, d)``. Local."""
        return values[: self._bulk.num_owned].reshape(-1, self._bulk.rigid.dim)
