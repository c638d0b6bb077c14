"""Displacements eliminated by active mortar constraints."""

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints, same_numbers
from dolfinx_nts.contact.implicit.mortar.nodal_system import NodalSystem
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.mortar.mortar_search import MortarCandidates

__all__ = ["EliminatedDofs"]


class EliminatedDofs:
    """Eliminated displacements of nodes and of their mid-nodes, see `HatFunctions`.

    Args:
        candidates: Facets of the nodes, and segments.
        free: 1 at unknown displacements, otherwise 0, shape ``(l, 3)``; None if all are unknown.
        dofs: Nodes of the pairs, the one with the multiplier first, shape ``(m, d)``.
    """

    def __init__(self, candidates: MortarCandidates, free: Floats | None, dofs: Ints) -> None:
        self._candidates, self._free, self._dofs = candidates, free, dofs
        # Cache of the last system and of its transpose, with their ranks and rows.
        self._last: dict[bool, tuple[Ints, Floats, NodalSystem]] = {}

    def take(self, dofs: Ints) -> "EliminatedDofs":
        """Copy of this object for other pairs, with their nodes, ``(m, d)``."""
        return self if dofs is self._dofs else EliminatedDofs(self._candidates, self._free, dofs)

    def system(
        self, rank: Ints, rows: Floats, normal: Floats, *, transposed: bool = False
    ) -> NodalSystem:
        """System of rows of the pairs, see `NodalSystem`. Collective.

        The last system is reused if ranks are equal and rows are the same array, which must not be
        changed afterwards.
        """
        scatter, last = self._candidates.scatter, self._last.get(transposed)
        is_known = last is not None and rows is last[1] and same_numbers(rank, last[0])
        if not reductions.everywhere(scatter.index_map.comm, is_known):
            where = scatter, self._candidates.hat_functions, self._dofs
            last = rank, rows, NodalSystem(*where, rank, rows, normal, transposed=transposed)
            self._last[transposed] = last
            for known in (rank, rows):
                known.setflags(write=False)
        assert last is not None
        return last[2]

    def gather(self, force: Floats) -> Floats:
        """Project forces at the owned nodes, ``(n, b)``, on the pairs, ``(m, b)``. Collective.

        ``b`` is 3, or the number of components of the space.
        """
        if self._candidates.hat_functions is not None:
            b = force.shape[1]
            force = self._candidates.hat_functions.gather(self._masked(in_space(force)))[:, :b]
        return force[self._dofs[:, 0]]

    def move(self, increment: Floats, x: Floats) -> None:
        """Add increments of the nodes of pairs, ``(m, b)``, to displacements x of owned nodes.

        Collective.
        """
        if self._candidates.hat_functions is None:
            x[self._dofs[:, 0]] += increment
            return
        field = np.zeros((len(x), 3))
        field[self._dofs[:, 0], : increment.shape[1]] = increment
        x += self._masked(self._candidates.hat_functions.spread(field))[:, : x.shape[1]]

    def _masked(self, field: Floats) -> Floats:
        """Values at the owned nodes, ``(n, 3)``, 0 at prescribed displacements."""
        return field if self._free is None else field * self._free[: len(field)]
