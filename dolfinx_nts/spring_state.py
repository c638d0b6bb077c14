"""Forces of the springs of a contact pair at one state, and their work."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dolfinx_nts import _kernels
from dolfinx_nts.contact_history import ContactHistory
from dolfinx_nts.search.candidates import Neighbourhood
from dolfinx_nts.search.obstacle_candidates import ObstacleNeighbourhood

__all__ = ["SpringState"]

Floats = npt.NDArray[np.float64]

_NO_SPRINGS = _kernels.Springs(
    np.empty(0, dtype=np.int32),
    np.empty(0, dtype=np.int64),
    np.empty((0, 1), dtype=np.int32),
    np.empty((0, 1, 3)),
    np.empty(0),
)


class SpringState(NamedTuple):
    """Forces of the springs of a pair at one state.

    Attributes:
        neighbourhood: Owned nodes and ghosts of the forces; None where no
            rank has a node near a segment.
        springs: Springs of the active nodes, by their positions in the
            surface's nodes.
        dissipation: Lost by friction in the step at all nodes of the surface,
            ``(n,)`` [J]; None without friction.
        history: Makes what the pair remembers of the state.
    """

    neighbourhood: Neighbourhood | ObstacleNeighbourhood | None
    springs: _kernels.Springs
    dissipation: Floats | None
    history: Callable[[], ContactHistory]

    @classmethod
    def none(
        cls, history: Callable[[], ContactHistory], dissipation: Floats | None = None
    ) -> "SpringState":
        """No forces."""
        return cls(None, _NO_SPRINGS, dissipation, history)

    def add_to(self, total: Floats) -> None:
        """Add the forces to those of the owned nodes. Collective.

        Args:
            total: Shape ``(n, 3)`` [N].
        """
        if self.neighbourhood is not None:
            self.neighbourhood.add_to_owners(total, self.springs.dofs, self.springs.force)

    @property
    def stored(self) -> float:
        """Energy of all springs on this rank [J]."""
        return float(self.springs.energy.sum())

    def displacement(self, du: Floats) -> Floats:
        """Displacement also of the ghosts, shape ``(l, 3)`` [m]. Collective.

        Args:
            du: That of the owned nodes, shape ``(n, 3)`` [m].
        """
        return du if self.neighbourhood is None else self.neighbourhood.with_ghosts(du)
