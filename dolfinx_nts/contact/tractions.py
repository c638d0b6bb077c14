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

__all__ = ["Tractions", "pressure_and_further_area"]


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
        return pressure_and_further_area(self)[0]

    @property
    def traction(self) -> Floats:
        """Total contact force per reference area of the nodes, ``(n, 3)`` [Pa]. Collective.

        In mortar contact the area is that of all facets around a node, otherwise of facets that
        face the contact.
        """
        force = self.history.force + self._forces_of_reverse_passes(lambda history: history.force)
        return _on_facets(self.pair, force, self._facing_fractions_of_passes())

    @property
    def friction_traction(self) -> Floats:
        """Friction per area of the pressure, ``(n, 3)`` [Pa]. Collective."""
        facing, reverse = (
            self._facing_fractions_of_passes(),
            self._forces_of_reverse_passes(_friction),
        )
        own = self.search.per_area(_friction(self.history), facing, self.history.area)
        return own + _on_facets(self.pair, reverse, facing)

    def _facing_fractions_of_passes(self) -> Floats:
        reverse = self._forces_of_reverse_passes(_normal_forces)
        return self._facing_fractions(_normal_forces(self.history) + reverse)

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


def pressure_and_further_area(contact: Tractions) -> tuple[Floats, Floats]:
    """Pressure at the nodes of a pair, and areas of further nodes that receive forces. Collective.

    They are inactive nodes that receive forces of vertices and opposite passes.

    Returns:
        Pressure, shape ``(n,)`` [Pa], and reference area of these nodes from which the pressure
        follows, 0 at all others, shape ``(n,)`` [m^2].
    """
    pair, history = contact.pair, contact.history
    reverse = contact._forces_of_reverse_passes(_normal_forces)
    facing = contact._facing_fractions(_normal_forces(history) + reverse)
    own = contact.search.per_area(-history.lambda_N, facing, history.area)
    further = _on_facets(pair, np.linalg.norm(reverse, axis=1), facing)
    area = pair.nodes.spread(_areas(pair, facing))
    return own + further, np.where((further > 0) & ~history.active, area, 0.0)


def _normal_forces(history: ContactHistory) -> Floats:
    """Normal forces on the nodes, shape ``(n, 3)`` [N]. Local."""
    forces: Floats = np.abs(history.lambda_N)[:, None] * history.normal
    return forces


def _friction(history: ContactHistory) -> Floats:
    """Friction on the nodes, shape ``(n, 3)`` [N]. Local."""
    return -history.traction


def _on_facets(pair: ContactPair, force: Floats, facing: Floats) -> Floats:
    """Nodal forces per area, in mortar contact per area of all facets of a node. Collective.

    ``facing`` is the fraction of the area that faces the contact, shape ``(n,)`` [-].
    """
    return pair.nodes.per_area(force, _areas(pair, facing))


def _areas(pair: ContactPair, facing: Floats) -> Floats:
    """Areas of the nodes for `_on_facets`, shape ``(n,)`` [m^2]. Collective at the first use."""
    return pair.nodes.area if pair.method == MORTAR else facing * pair.nodes.area
