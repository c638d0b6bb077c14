"""Forces per area at the nodes of a pair."""

from abc import ABC, abstractmethod

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.method import EDGES, MORTAR
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.passes import ForcesOfNodes, Passes
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.search.candidates import Search
from dolfinx_nts.search.nodal_facets import NodalFacets

__all__ = ["Tractions"]


class Tractions(ABC):
    """Forces per area in the accepted contact, including opposite passes.

    Args:
        pair: The pair.
        search: Search with the areas of multipliers.
        passes: Passes of the stepper.

    Attributes:
        pair, search, passes: The arguments.
        facets: Facets around the nodes.
    """

    def __init__(self, pair: ContactPair, search: Search, passes: Passes) -> None:
        self.pair, self.search, self.passes = pair, search, passes
        self.facets = NodalFacets(pair.nodes)

    @property
    @abstractmethod
    def history(self) -> ContactHistory:
        """Contact of the last accepted step. Local."""

    @property
    def nodes(self) -> Surface:
        """Surface whose nodes may touch. Local."""
        return self.pair.nodes

    @property
    def area(self) -> Floats:
        """Reference areas on which the nodes transmit force, shape ``(n,)`` [m^2]. Collective.

        In node-to-segment contact only the facets around a node that are opposed to the contact
        normal count, not those beyond a corner. Without contact all facets count.
        """
        return self._area(_normal_forces(self.history))

    @property
    def pressure(self) -> Floats:
        history, reverse = self.history, self._forces_of_reverse_passes(_normal_forces)
        area = self._area(_normal_forces(history) + reverse)
        pressure: Floats = self.search.per_area(-history.lambda_N, area)
        return pressure + self._on_facets(np.linalg.norm(reverse, axis=1), area)

    @property
    def traction(self) -> Floats:
        """Whole contact force per reference area of the nodes, ``(n, 3)`` [Pa]. Collective."""
        force = self.history.force + self._forces_of_reverse_passes(lambda history: history.force)
        return self._on_facets(force, self._area_of_passes())

    @property
    def friction_traction(self) -> Floats:
        """Friction part of the traction, ``(n, 3)`` [Pa]. Collective."""
        area, reverse = self._area_of_passes(), self._forces_of_reverse_passes(_friction)
        own = self.search.per_area(_friction(self.history), area)
        return own + self._on_facets(reverse, area)

    def _area_of_passes(self) -> Floats:
        return self._area(
            _normal_forces(self.history) + self._forces_of_reverse_passes(_normal_forces)
        )

    def _area(self, force: Floats) -> Floats:
        if self.pair.method == MORTAR:
            return self.history.area
        if self.pair.method == EDGES:
            return self.nodes.area
        presses: Flags = np.abs(force).max(axis=1) > 0
        x = self.passes.positions()
        normal = np.where(presses[:, None], _kernels.unit_vectors(force), self.history.normal)
        area: Floats = self.nodes.area * self.facets.facing_parts(x, normal, presses)
        return area

    def _on_facets(self, force: Floats, area: Floats) -> Floats:
        """Nodal forces per area; in mortar contact the area of all facets of a node. Collective.

        Arguments as for `Surface.per_area`.
        """
        return self.nodes.per_area(force, None if self.pair.method == MORTAR else area)

    def _forces_of_reverse_passes(self, of_nodes: ForcesOfNodes) -> Floats:
        """Forces of all opposite passes on the nodes, ``(n, 3)`` [N]. Collective.

        ``of_nodes`` returns the forces on the nodes of a pass.
        """
        total = np.zeros((len(self.nodes.nodes), 3))
        for each in self.passes.forces_on_nodes_of(self.pair, of_nodes):
            total += each[self.nodes.nodes]
        return total


def _normal_forces(history: ContactHistory) -> Floats:
    """Normal forces on the nodes, shape ``(n, 3)`` [N]. Local."""
    forces: Floats = np.abs(history.lambda_N)[:, None] * history.normal
    return forces


def _friction(history: ContactHistory) -> Floats:
    """Friction on the nodes, shape ``(n, 3)`` [N]. Local."""
    return -history.traction
