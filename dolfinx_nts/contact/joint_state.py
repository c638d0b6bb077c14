"""Joint evaluation of several pairs with the same laws.

A scene of many bodies has many pairs with few nodes each. Array operations treat all pairs
together. Each pair keeps its own search range and history.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import fields
from functools import partial
from itertools import pairwise
from operator import is_not
from typing import Any, NamedTuple, cast

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Array, Floats, GlobalInts, Ints
from dolfinx_nts.common.declaration import Declaration
from dolfinx_nts.contact.cell_stiffness import Layers
from dolfinx_nts.contact.enforcement import Tied
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.massless import is_resolved
from dolfinx_nts.contact.nodes_of_pairs import NodesOfPairs
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.search.global_search import GlobalSearch
from dolfinx_nts.search.joint_facets import JointFacets
from dolfinx_nts.search.joint_search import JointSearch

__all__ = ["JointNodes", "JointState", "joint_states", "members"]


class JointNodes(NamedTuple):
    """Nodes of several pairs, pair by pair, with possible repetitions, see `Surface`.

    Attributes:
        V: Their space.
        nodes: Owned nodes, shape ``(n,)``.
        node_ids: Their input numbers, shape ``(n,)``.
        area: Their tributary areas, shape ``(n,)`` [m^2].
        positive_area: As ``area``, but positive, see `Surface.positive_area`.
    """

    V: Any
    nodes: Ints
    node_ids: GlobalInts
    area: Floats
    positive_area: Floats


class JointState(NodesOfPairs):
    """Pairs whose contact is evaluated together, see `PairState`. Collective.

    Args:
        states: States of the ``c`` pairs, with the same laws and the same shape of segments.

    Attributes:
        members: The argument.
        nodes: Nodes of all pairs.
        pair: One of the pairs, for the laws.
        search: Joint search of all pairs.
        facets: Facets around the nodes.
    """

    def __init__(self, states: Sequence[PairState]) -> None:
        super().__init__([state.pair for state in states])
        self.members = tuple(states)
        surfaces = [state.nodes for state in states]
        names = ("nodes", "node_ids", "area", "positive_area")
        arrays = (np.concatenate([getattr(each, name) for each in surfaces]) for name in names)
        self.nodes = JointNodes(surfaces[0].V, *arrays)
        self.pair: ContactPair = states[0].pair
        sizes = np.array([state.pair.segment_size for state in states])
        shorter = _kernels.DEEPEST * (self.longest_segment - sizes)
        searches = [cast(GlobalSearch, state.search) for state in states]
        self.search = JointSearch(self.nodes.V.mesh.comm, searches, shorter)
        self.facets = JointFacets([state.facets for state in states])
        # Accepted histories of the single pairs, from which `_history` was joined.
        self._accepted: list[ContactHistory | Callable[[], ContactHistory]] = []
        self._history: ContactHistory
        # Layers of the single pairs, and joint layers of all pairs.
        self._parts: list[Layers] = []
        self._layers: Layers | None = None

    @property
    def eps_N(self) -> Floats | None:
        """Stiffness of the normal penalty springs [N/m]. Local."""
        return _joint_springs([state.eps_N for state in self.members])

    @property
    def layers(self) -> Layers | None:
        """Layers of cells on which default springs depend, once they are chosen. Local."""
        parts = [state.layers for state in self.members if state.layers is not None]
        if len(parts) != len(self._parts) or any(map(is_not, parts, self._parts)):
            self._parts, self._layers = parts, Layers.joint(parts) if parts else None
        return self._layers

    @property
    def eps_T(self) -> Floats | None:
        """Stiffness of the tangential springs [N/m]. Local."""
        return _joint_springs([state.eps_T for state in self.members])

    @property
    def history(self) -> ContactHistory:
        """Contact of the last accepted step of all pairs. Local."""
        accepted = [state.accepted for state in self.members]
        known = self._accepted
        if len(known) != len(accepted) or any(map(is_not, accepted, known)):
            self._history = _joint_history([state.history for state in self.members])
            self._accepted = accepted
        return self._history

    def accept(self, history: ContactHistory) -> None:
        """Accept the contact of a step, and store the entries of each pair. Local."""
        self._history, self._accepted = history, []
        for state, (start, end) in zip(self.members, pairwise(self.ends), strict=True):
            state.accept(partial(_own_history, history, slice(start, end)))
            self._accepted.append(state.accepted)


def joint_states(states: Sequence[PairState]) -> list[PairState | JointState]:
    """Join pairs that can be evaluated together. Collective.

    These are node-to-segment pairs between bodies with equal laws.

    Args:
        states: States of all pairs.

    Returns:
        Joint and single states, in the order of the first pair of each.
    """
    groups: dict[Hashable, list[PairState]] = {}
    for number, state in enumerate(states):
        groups.setdefault(_kind(state) or number, []).append(state)
    return [group[0] if len(group) == 1 else JointState(group) for group in groups.values()]


def members(state: PairState | JointState) -> tuple[PairState, ...]:
    """States of the single pairs of a state. Local."""
    return state.members if isinstance(state, JointState) else (state,)


def _kind(state: PairState) -> Hashable:
    """Key, equal for pairs that can be evaluated together; None for pairs that cannot be joined."""
    pair, search = state.pair, state.search
    # Other pairs have a special search or elimination.
    alone = is_resolved(pair) or isinstance(pair.enforcement, Tied)
    if type(search) is not GlobalSearch or alone:
        return None
    laws = map(_values, (pair.enforcement, pair.friction))
    return (type(state), search.num_vertices, pair.nodes.segments.shape[1], *laws)


def _values(law: Declaration | None) -> Hashable:
    """Class and arguments of a law; the law itself if its arguments cannot be compared."""
    if law is None:
        return None
    values = [
        (name, _values(value) if isinstance(value, Declaration) else value)
        for name, value in sorted(vars(law).items())
    ]
    try:
        hash(tuple(values))
    except TypeError:
        return law
    return (type(law), *values)


def _joint_springs(values: Sequence[Floats | None]) -> Floats | None:
    """Stiffness of the springs of all pairs, or None."""
    present = [value for value in values if value is not None]
    return np.concatenate(present) if present else None


def _joint_history(histories: Sequence[ContactHistory]) -> ContactHistory:
    arrays: dict[str, Array] = {
        field.name: np.concatenate([getattr(history, field.name) for history in histories])
        for field in fields(ContactHistory)
    }
    return ContactHistory(**arrays)


def _own_history(history: ContactHistory, own: slice) -> ContactHistory:
    arrays: dict[str, Array] = {
        field.name: getattr(history, field.name)[own] for field in fields(ContactHistory)
    }
    return ContactHistory(**arrays)
