"""Nodal fields: motion, and contact on surfaces."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Array, GlobalInts, Ints
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.diagnostics.current_state import CurrentState
from dolfinx_nts.fem.components import in_space, nodal
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.parallel.slabs import Some

__all__ = ["NodalFields"]


class _Rule(NamedTuple):
    """Definition of a contact field.

    Attributes:
        of: Returns the values at the nodes of a pair, from the state, the pair and its number.
        merged: Function that merges the values of a node that belongs to several pairs.
        elsewhere: Value of nodes without a pair.
        shape: Shape of the value of a node.
        needs_friction: Whether only pairs with friction have the field.
    """

    of: Callable[[CurrentState, PairState, int], Array]
    merged: np.ufunc
    elsewhere: float = 0.0
    shape: tuple[int, ...] = ()
    needs_friction: bool = False


_RULES = {
    "gap": _Rule(lambda now, pair, i: now.gaps()[i], np.fmin, np.nan),
    "contact_pressure": _Rule(lambda now, pair, i: now.pressures[i], np.add),
    "active": _Rule(lambda now, pair, i: pair.history.active.astype(np.float64), np.maximum),
    "contact_traction": _Rule(lambda now, pair, i: pair.traction, np.add, shape=(3,)),
    "friction_traction": _Rule(
        lambda now, pair, i: pair.friction_traction, np.add, 0.0, (3,), True
    ),
    "slip_state": _Rule(
        lambda now, pair, i: pair.history.active + 1.0 * pair.history.sliding,
        np.maximum,
        0.0,
        (),
        True,
    ),
    "accumulated_slip": _Rule(lambda now, pair, i: pair.history.slip, np.add, 0.0, (), True),
}


class _Place(NamedTuple):
    """Nodes of several pairs in one array, and the rows of each pair in this array.

    Attributes:
        nodes: Owned nodes of all these pairs, ascending, shape ``(r,)``.
        rows: Indices of the nodes of each pair in ``nodes``, by the number of the pair.
    """

    nodes: Ints
    rows: Mapping[int, GlobalInts | slice]

    @classmethod
    def of(cls, pairs: Mapping[int, PairState]) -> "_Place":
        """Nodes of some pairs, by their numbers. Local."""
        own = {number: pair.nodes.nodes for number, pair in pairs.items()}
        nodes = np.unique(np.concatenate([np.empty(0, dtype=np.int32), *own.values()]))
        rows = {
            number: slice(None) if np.array_equal(some, nodes) else np.searchsorted(nodes, some)
            for number, some in own.items()
        }
        return cls(nodes, rows)


class NodalFields:
    """Displacement, velocity and contact of a stepper at the owned nodes.

    A node of several pairs has the smallest gap, the sum of pressures, slips and tractions, and the
    largest of all other values.

    Args:
        stepper: The stepper.
    """

    def __init__(self, stepper: Stepper) -> None:
        # Each access to the array of a DOLFINx Function takes 2 us.
        ends, n = {"displacement": stepper.u, "velocity": stepper.v}, len(stepper.node_ids)
        self._motion = {name: nodal(function)[:n] for name, function in ends.items()}
        self._contacts = dict(enumerate(stepper.contacts))
        rubbing = {i: each for i, each in self._contacts.items() if each.pair.friction is not None}
        places = {False: _Place.of(self._contacts), True: _Place.of(rubbing)}
        self._places = {name: places[rule.needs_friction] for name, rule in _RULES.items()}

    def of(self, now: CurrentState) -> dict[str, Array | Some]:
        """Fields of a state by name. Collective.

        Args:
            now: Current state of the stepper.

        Returns:
            ``displacement`` [m] and ``velocity`` [m/s] have the shape ``(n, 3)`` for ``n`` owned
            nodes; in the plane the third components of all vectors are 0.

            With contact pairs, at their nodes: ``gap`` [m], positive if open, and NaN without a
                candidate segment and elsewhere; ``contact_pressure`` [Pa]; ``active``, 1 where
                contact transmits force; and ``contact_traction`` [Pa], the total contact force per
                reference area, shape ``(r, 3)``. With friction also ``friction_traction`` [Pa], the
                frictional part of it, shape ``(r, 3)``; ``slip_state``, 0 open, 1 sticking, 2
                sliding; and ``accumulated_slip`` [m]. All but the gap are 0 elsewhere.
        """
        fields: dict[str, Array | Some]
        fields = {name: in_space(values) for name, values in self._motion.items()}
        for name, place in self._places.items():
            if place.rows:
                fields[name] = self.contact(now, name)
        return fields

    def contact(self, now: CurrentState, name: str) -> Some:
        """A contact field by its name. Collective."""
        rule, (nodes, rows) = _RULES[name], self._places[name]
        of_pairs = [(rule.of(now, self._contacts[i], i), some) for i, some in rows.items()]
        if len(of_pairs) == 1 and isinstance(of_pairs[0][1], slice):  # one pair: no merge is needed
            return Some(nodes, of_pairs[0][0], rule.elsewhere)
        values: Array = np.full((len(nodes), *rule.shape), rule.elsewhere)
        for own, some in of_pairs:
            values[some] = rule.merged(values[some], own)
        return Some(nodes, values, rule.elsewhere)
