"""Forces of the springs of a contact pair at one state, and their work."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dolfinx_nts.contact_history import ContactHistory
from dolfinx_nts.obstacle_neighbourhood import ObstacleNeighbourhood
from dolfinx_nts.search import Neighbourhood

__all__ = ["SpringState"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


@dataclass(frozen=True)
class SpringState:
    """Forces of the springs of a pair at one state.

    Attributes:
        neighbourhood: Owned nodes and ghosts of the forces.
        node: Position in the surface's nodes, shape ``(m,)``.
        dofs: Nodes of the pairs in the neighbourhood, ``(m, 1+k)``.
        force: On these nodes, shape ``(m, 1+k, 3)`` [N].
        history: Contact at this state.
        num_active: Nodes in contact on all ranks.
    """

    neighbourhood: Neighbourhood | ObstacleNeighbourhood
    node: Ints
    dofs: Ints
    force: Floats
    history: ContactHistory
    num_active: int

    def add_to(self, total: Floats) -> None:
        """Add the forces to those of the owned nodes. Collective.

        Args:
            total: Shape ``(n, 3)`` [N].
        """
        if self.num_active:
            forces = np.zeros((self.neighbourhood.num_local, 3))
            np.add.at(forces, self.dofs.ravel(), self.force.reshape(-1, 3))
            total += self.neighbourhood.to_owners(forces)

    def work(self, du: Floats) -> Floats:
        """Work of the forces, by contact node. Collective.

        Args:
            du: Displacement of the owned nodes, shape ``(n, 3)`` [m].

        Returns:
            Work at each node of the surface, shape ``(n,)`` [J].
        """
        work = np.zeros(len(self.history.key))
        if self.num_active:
            dx = self.neighbourhood.with_ghosts(du)[self.dofs]
            work[self.node] = np.einsum("maj,maj->m", self.force, dx)
        return work
