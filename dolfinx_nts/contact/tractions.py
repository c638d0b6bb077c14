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
        self.facets = NodalFacets.of(pair.nodes)

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
        if self.pair.method == MORTAR:
            return self.history.area
        return self.nodes.area * self._facing_fractions(_normal_forces(self.history))

    @property
    def pressure(self) -> Floats:
        reverse = self._forces_of_reverse_passes(_normal_forces)
        facing = self._facing_fractions(_normal_forces(self.history) + reverse)
        own = self.search.per_area(-self.history.lambda_N, facing, self.history.area)
        return own + self._on_facets(np.linalg.norm(reverse, axis=1), facing)

    @property
    def traction(self) -> Floats:
        """Whole contact force per reference area of the nodes, ``(n, 3)`` [Pa]. Collective.

        In mortar contact all facets around the nodes count, otherwise those that face the contact.
        """
        force = self.history.force + self._forces_of_reverse_passes(lambda history: history.force)
        return self._on_facets(force, self._facing_fractions_of_passes())

    @property
    def friction_traction(self) -> Floats:
        """Friction per area of the pressure, ``(n, 3)`` [Pa]. Collective."""
        facing, reverse = (
            self._facing_fractions_of_passes(),
            self._forces_of_reverse_passes(_friction),
        )
        own = self.search.per_area(_friction(self.history), facing, self.history.area)
        return own + self._on_facets(reverse, facing)

    def _facing_fractions_of_passes(self) -> Floats:
        reverse = self._forces_of_reverse_passes(_normal_forces)
        return self._facing_fractions(_normal_forces(self.history) + reverse)

    def _on_facets(self, force: Floats, facing: Floats) -> Floats:
        """Nodal forces per area; in mortar contact the area of all facets of a node. Collective.

        ``facing`` is the fraction of it that faces the contact, shape ``(n,)`` [-].
        """
        is_mortar = self.pair.method == MORTAR
        return self.nodes.per_area(force, None if is_mortar else facing * self.nodes.area)

    def _facing_fractions(self, force: Floats) -> Floats:
        """Fractions of the nodal areas opposed to the normal forces, shape ``(n,)`` [-]."""
        if self.pair.method == EDGES:
            return np.ones(len(force))
        presses: Flags = np.abs(force).max(axis=1) > 0
        x = self.passes.positions()
        normal = np.where(presses[:, None], _kernels.unit_vectors(force), self.history.normal)
        return self.facets.facing_fractions(x, normal, presses)

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
