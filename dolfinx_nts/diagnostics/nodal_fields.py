"""Fields at the nodes: motion, and contact where there is a surface."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Array
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.diagnostics.present import Present
from dolfinx_nts.fem.components import in_space, nodal
from dolfinx_nts.integrators.stepper import Stepper

__all__ = ["contact_field", "contact_fields", "nodal_fields"]


class _Rule(NamedTuple):
    """How a field of contact is made.

    Attributes:
        of: Values at the nodes of a pair, from the state, the pair and its number.
        merged: Merges the values of a node that belongs to several pairs.
        elsewhere: Value of nodes without a pair.
        shape: Shape of the value of a node.
        needs_friction: Whether only pairs with friction have the field.
    """

    of: Callable[[Present, PairState, int], Array]
    merged: Callable[[Array | float, Array], Array]
    elsewhere: float = 0.0
    shape: tuple[int, ...] = ()
    needs_friction: bool = False


_RULES = {
    "gap": _Rule(lambda now, pair, i: now.gaps()[i], np.fmin, np.nan),
    "contact_pressure": _Rule(lambda now, pair, i: now.pressures[i], np.add),
    "active": _Rule(lambda now, pair, i: pair.history.active.astype(np.float64), np.maximum),
    "contact_traction": _Rule(
        lambda now, pair, i: pair.nodes.per_area(pair.history.force), np.add, shape=(3,)
    ),
    "friction_traction": _Rule(
        lambda now, pair, i: -pair.search.per_area(pair.history.traction, pair.history.area),
        np.add,
        0.0,
        (3,),
        True,
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


def contact_fields(stepper: Stepper) -> dict[str, float]:
    """Values at nodes without a pair by the names of the fields of contact. Local."""
    has_friction = any(pair.friction is not None for pair in stepper.pairs)
    return {
        name: rule.elsewhere
        for name, rule in _RULES.items()
        if stepper.pairs and (has_friction or not rule.needs_friction)
    }


def contact_field(stepper: Stepper, name: str) -> Array:
    """One of the fields of contact at the owned nodes, see `nodal_fields`. Collective.

    Args:
        stepper: Stepper whose present state is described.
        name: Name of the field.

    Returns:
        Values, shape ``(n,)`` or ``(n, 3)``.
    """
    return _of_contact(Present(stepper), name)


def _of_contact(now: Present, name: str) -> Array:
    """The same of a state."""
    rule, stepper = _RULES[name], now.stepper
    shape = len(stepper.node_ids), *rule.shape
    # Zeros take no time where nobody writes.
    values: Array = np.full(shape, rule.elsewhere) if rule.elsewhere else np.zeros(shape)
    is_first = True
    for number, contact in enumerate(stepper.contacts):
        if contact.pair.friction is not None or not rule.needs_friction:
            at = contact.nodes.nodes
            before = rule.elsewhere if is_first else values[at]
            values[at] = rule.merged(before, rule.of(now, contact, number))
            is_first = False
    return values


def nodal_fields(now: Present) -> dict[str, Array]:
    """Displacement, velocity and contact at the owned nodes. Collective.

    Where a node belongs to several pairs, it has their smallest gap, the sum of their
    pressures, slips and tractions, and the largest of the others.

    Args:
        now: State that is described.

    Returns:
        Values by name. ``displacement`` [m] and ``velocity`` [m/s] have the shape ``(n, 3)``
        for ``n`` owned nodes; in the plane the third components of all vectors are 0.

        With contact pairs, of shape ``(n,)``: ``gap`` [m], positive where contact is open, and
        NaN where a node faces no segment or belongs to no pair; ``contact_pressure`` [Pa];
        ``active``, 1 where contact transmits force; and ``contact_traction`` [Pa], the whole
        contact force per reference area, shape ``(n, 3)``. With friction also
        ``friction_traction`` [Pa], the part of it by friction, shape ``(n, 3)``;
        ``slip_state``, 0 open, 1 sticking, 2 sliding; and ``accumulated_slip`` [m]. All but the
        gap are 0 at nodes without a pair.
    """
    stepper, n = now.stepper, len(now.stepper.node_ids)
    fields: dict[str, Array] = {
        "displacement": in_space(nodal(stepper.u)[:n]),
        "velocity": in_space(nodal(stepper.v)[:n]),
    }
    for name in contact_fields(stepper):
        fields[name] = _of_contact(now, name)
    return fields
