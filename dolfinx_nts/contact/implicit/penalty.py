"""Normal springs of a contact pair with penalty, in one attempt at a step."""

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.enforcement import Penalty
from dolfinx_nts.contact.implicit.contributions import PairKinematics
from dolfinx_nts.contact.implicit.local_search import LocalSearch
from dolfinx_nts.contact.pair import ContactPair

__all__ = ["NormalSprings"]


class NormalSprings:
    """Forces and energies of the springs. Local.

    Args:
        pair: The contact pair, with springs.
        law: Its enforcement.
        pairing: Segments of its nodes.
    """

    def __init__(self, pair: ContactPair, law: Penalty, pairing: LocalSearch) -> None:
        """Keep what the springs depend on."""
        self._pair, self._law, self._pairing = pair, law, pairing

    def _stiffness(self, rows: PairKinematics) -> Floats:
        assert self._pair.eps_N is not None
        return self._pair.eps_N[rows.node]

    def _offset(self, rows: PairKinematics) -> Floats:
        """Gap at which springs start on the present segments.

        On a new segment it moves by the difference of the gaps at t_n, so
        that the energy of the spring is continuous; that of a node which
        was open on the old one starts where the node is.
        """
        old, node = self._pair.history, rows.node
        moved = (old.key[node] >= 0) & (old.key[node] != self._pairing.candidates.key[rows.segment])
        before = np.where(old.active[node], old.gap[node], np.maximum(rows.gap_n, 0.0))
        offset: Floats = old.offset[node] + np.where(moved, rows.gap_n - before, 0.0)
        return offset

    def push(self, rows: PairKinematics, x: Floats) -> tuple[Floats, Flags, Floats]:
        """Forces of the springs.

        Args:
            rows: The pairs; with convective friction the gradients change.
            x: Positions with ghosts, shape ``(l, 3)`` [m].

        Returns:
            lambda_N [N, <= 0], whether the node is in its spring, and the
            derivative of lambda_N by the gap [N/m]; shape ``(m,)``.
        """
        eps_N = self._stiffness(rows)
        if self._pair.is_convective:
            # Half-way, as everything else in (60)-(64).
            nodes, half = self._pair.nodes.nodes[rows.node], (self._pairing.x_n + x) / 2
            gap = self._pairing.candidates.gap(half, nodes, rows.segment)
            rows.gradients[:, 0] = rows.columns[:, 0]
            return eps_N * np.minimum(gap, 0.0), gap < 0, np.where(gap < 0, eps_N / 2, 0.0)
        offset = self._offset(rows)
        lambda_N, slope = self._law.force(rows.gap_n - offset, rows.gap - offset, eps_N)
        return lambda_N, lambda_N < 0, slope

    def accepted(self, rows: PairKinematics) -> tuple[Floats, Floats]:
        """Energy [J] of the springs and gap at which they start [m], ``(m,)``."""
        shift = self._offset(rows)
        gap = rows.gap - shift
        energy = self._law.energy(gap, self._stiffness(rows))
        # An open node forgets; one still inside must not gain energy.
        return energy, np.where((gap >= 0) & (rows.gap >= 0), 0.0, shift)

    def stored(self, rows: PairKinematics) -> Floats:
        """Energy that went into the springs in the step, shape ``(m,)`` [J]."""
        offset, eps_N = self._offset(rows), self._stiffness(rows)
        at_n = self._law.energy(rows.gap_n - offset, eps_N)
        # A node that starts inside its spring brings energy with it.
        before = np.where(self._pair.history.active[rows.node], at_n, 0.0)
        stored: Floats = self._law.energy(rows.gap - offset, eps_N) - before
        return stored
