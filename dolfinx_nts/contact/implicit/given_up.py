"""What nodes with multipliers give up: the displacements that their constraints determine."""

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints, same_numbers
from dolfinx_nts.contact.implicit.nodal_system import NodalSystem
from dolfinx_nts.fem.components import in_space
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.mortar_search import MortarCandidates

__all__ = ["GivenUp"]


class GivenUp:
    """Displacements of nodes of pairs, and of the nodes that go with them, see `Hats`.

    Args:
        candidates: Facets of the nodes, and segments.
        free: 1 where the displacement of a node is unknown, otherwise 0, shape ``(l, 3)``; None
            if all are.
        dofs: Nodes of the pairs, that with the multiplier first, shape ``(m, d)``.
    """

    def __init__(self, candidates: MortarCandidates, free: Floats | None, dofs: Ints) -> None:
        self._candidates, self._free, self._dofs = candidates, free, dofs
        # The last system of either kind, with its ranks and rows.
        self._last: dict[bool, tuple[Ints, Floats, NodalSystem]] = {}

    def take(self, dofs: Ints) -> "GivenUp":
        """Make the same of other pairs, shape ``(m, d)``."""
        return self if dofs is self._dofs else GivenUp(self._candidates, self._free, dofs)

    def system(
        self, rank: Ints, rows: Floats, normal: Floats, *, transposed: bool = False
    ) -> NodalSystem:
        """Make the system of rows of the pairs, see `NodalSystem`. Collective.

        It is the last one where ranks are the same, and rows the very array: neither can be
        changed from then on.
        """
        scatter, last = self._candidates.scatter, self._last.get(transposed)
        is_known = last is not None and rows is last[1] and same_numbers(rank, last[0])
        if not reductions.everywhere(scatter.index_map.comm, is_known):
            where = scatter, self._candidates.hats, self._dofs
            last = rank, rows, NodalSystem(*where, rank, rows, normal, transposed=transposed)
            self._last[transposed] = last
            for known in (rank, rows):
                known.setflags(write=False)
        assert last is not None
        return last[2]

    def gather(self, force: Floats) -> Floats:
        """Sum up what forces at the owned nodes, ``(n, b)``, do along it, ``(m, b)``. Collective.

        ``b`` is 3, or the components of the space.
        """
        if self._candidates.hats is not None:
            b = force.shape[1]
            force = self._candidates.hats.gather(self._masked(in_space(force)))[:, :b]
        return force[self._dofs[:, 0]]

    def move(self, way: Floats, x: Floats) -> None:
        """Add ways of the nodes of pairs, ``(m, b)``, to those of owned nodes ``(n, b)``.

        Collective.
        """
        if self._candidates.hats is None:
            x[self._dofs[:, 0]] += way
            return
        field = np.zeros((len(x), 3))
        field[self._dofs[:, 0], : way.shape[1]] = way
        x += self._masked(self._candidates.hats.spread(field))[:, : x.shape[1]]

    def _masked(self, field: Floats) -> Floats:
        """Values at the owned nodes, ``(n, 3)``, 0 where displacements are given."""
        return field if self._free is None else field * self._free[: len(field)]
