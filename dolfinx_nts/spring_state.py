"""Forces of the springs of a contact pair at one state, and their work."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dolfinx_nts.contact_history import ContactHistory
from dolfinx_nts.neighbourhood import Neighbourhood
from dolfinx_nts.obstacle_neighbourhood import ObstacleNeighbourhood

__all__ = ["SpringState"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]
GlobalInts = npt.NDArray[np.int64]


class SpringState(NamedTuple):
    """Forces of the springs of a pair at one state.

    Attributes:
        neighbourhood: Owned nodes and ghosts of the forces; None where no
            rank has a node near a segment.
        node: Active nodes by their position in the surface's nodes, ``(m,)``.
        key: Their segments, shape ``(m,)``.
        dofs: Nodes of the pairs in the neighbourhood, ``(m, 1+k)``.
        force: On these nodes, shape ``(m, 1+k, 3)`` [N].
        energy: Stored in the springs of the nodes, shape ``(m,)`` [J].
        dissipation: Lost by friction in the step at all nodes of the surface,
            ``(n,)`` [J]; None without friction.
        history: Makes what the pair remembers of the state.
    """

    neighbourhood: Neighbourhood | ObstacleNeighbourhood | None
    node: Ints
    key: GlobalInts
    dofs: Ints
    force: Floats
    energy: Floats
    dissipation: Floats | None
    history: Callable[[], ContactHistory]

    @classmethod
    def none(
        cls, history: Callable[[], ContactHistory], dissipation: Floats | None = None
    ) -> "SpringState":
        """No forces."""
        node, key, energy = np.empty(0, np.int32), np.empty(0, np.int64), np.empty(0)
        dofs, force = node[:, None], np.empty((0, 1, 3))
        return cls(None, node, key, dofs, force, energy, dissipation, history)

    def add_to(self, total: Floats) -> None:
        """Add the forces to those of the owned nodes. Collective.

        Args:
            total: Shape ``(n, 3)`` [N].
        """
        if self.neighbourhood is not None:
            self.neighbourhood.add_to_owners(total, self.dofs, self.force)

    @property
    def stored(self) -> float:
        """Energy of all springs on this rank [J]."""
        return float(self.energy.sum())

    def displacement(self, du: Floats) -> Floats:
        """Displacement also of the ghosts, shape ``(l, 3)`` [m]. Collective.

        Args:
            du: That of the owned nodes, shape ``(n, 3)`` [m].
        """
        return du if self.neighbourhood is None else self.neighbourhood.with_ghosts(du)

    def arrays(self, du: Floats) -> tuple[Any, ...]:
        """What `_kernels.work_by_cause` needs. Local.

        Args:
            du: As of `displacement`.
        """
        return self.node, self.key, self.dofs, self.force, self.energy, du
