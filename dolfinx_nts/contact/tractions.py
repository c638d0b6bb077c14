"""Forces per area at the nodes of a pair."""

from abc import ABC, abstractmethod

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.passes import ForcesOfNodes, Passes
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.candidates import Search

__all__ = ["Tractions"]


class Tractions(ABC):
    """Tells forces per area of accepted contact, also where nodes are segments of a reverse pass.

    Args:
        pair: The pair.
        search: Knows the areas on which multipliers act.
        passes: Those of the stepper.

    Attributes:
        pair, search: The arguments.
    """

    def __init__(self, pair: ContactPair, search: Search, passes: Passes) -> None:
        """Take the arguments. Local."""
        self.pair, self.search, self._passes = pair, search, passes

    @property
    @abstractmethod
    def history(self) -> ContactHistory:
        """Contact of the last accepted step. Local."""

    @property
    def nodes(self) -> Surface:
        """Surface whose nodes may touch. Local."""
        return self.pair.nodes

    @property
    def pressure(self) -> Floats:
        """Contact pressure at the nodes, see `ContactPair.pressure`. Collective."""
        history = self.history
        own = self.search.per_area(-history.lambda_N, history.area)
        pressure: Floats = own + self._per_area_by_reverse(_normal_forces)[:, 0]
        return pressure

    @property
    def traction(self) -> Floats:
        """Whole contact force per reference area of the nodes, ``(n, 3)`` [Pa]. Collective."""
        own = self.nodes.per_area(self.history.force)
        return own + self._per_area_by_reverse(lambda history: history.force)

    @property
    def friction_traction(self) -> Floats:
        """The part of the traction that is friction, ``(n, 3)`` [Pa]. Collective."""
        history = self.history
        own = self.search.per_area(-history.traction, history.area)
        return own + self._per_area_by_reverse(lambda history: -history.traction)

    def _per_area_by_reverse(self, of_nodes: ForcesOfNodes) -> Floats:
        """Tractions of all passes in which the nodes are segments, ``(n, 3)`` [Pa]. Collective.

        ``of_nodes`` tells the forces of the nodes of a pass.
        """
        nodes = self.nodes
        forces = self._passes.forces_on_nodes_of(self.pair, of_nodes)
        total = np.zeros((len(nodes.nodes), 3))
        for each in forces:
            total += nodes.per_area(each[nodes.nodes])
        return total


def _normal_forces(history: ContactHistory) -> Floats:
    """Normal forces on nodes, against their normals, in the first of three columns [N]. Local."""
    return np.column_stack([history.lambda_N, *np.zeros((2, len(history.lambda_N)))])
