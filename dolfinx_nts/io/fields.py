"""Fields of a state, for files."""

import numpy as np

from dolfinx_nts.common.arrays import Array
from dolfinx_nts.integrators.stepper import Stepper

__all__ = ["nodal_fields"]


def nodal_fields(stepper: Stepper) -> dict[str, Array]:
    """Displacement, velocity and contact at the owned nodes. Collective.

    At the contact nodes: gap [m], contact pressure [Pa], active, and with
    friction slip state (0 open, 1 stick, 2 slip), accumulated slip [m] and
    traction [Pa]; least, summed or largest if a node belongs to several
    pairs. The gap is NaN at other nodes and where a node faces no segment,
    the others are 0 there.

    Args:
        stepper: What is run.

    Returns:
        Values by name, shape ``(n,)`` or ``(n, 3)``.
    """
    n = len(stepper.node_ids)
    fields: dict[str, Array] = {
        "displacement": stepper.u.x.array.reshape(-1, 3)[:n],
        "velocity": stepper.v.x.array.reshape(-1, 3)[:n],
    }
    rubs = any(pair.friction is not None for pair in stepper.pairs)
    gap = np.full(n, np.nan)
    pressure, active, slip_state, slip = np.zeros((4, n))
    traction = np.zeros((n, 3))
    for contact in stepper.contacts:
        at, history = contact.nodes.nodes, contact.history
        gap[at] = np.fmin(gap[at], contact.gap(stepper.x))
        pressure[at] += contact.pressure
        active[at] = np.maximum(active[at], history.active)
        if contact.pair.friction is not None:
            slip_state[at] = np.maximum(slip_state[at], history.active + 1.0 * history.sliding)
            slip[at] += history.slip
            traction[at] -= contact.nodes.per_area(history.traction)
    if rubs:
        fields["friction_traction"] = traction
    if stepper.pairs:
        fields |= {"gap": gap, "contact_pressure": pressure, "active": active}
    if rubs:
        fields |= {"slip_state": slip_state, "accumulated_slip": slip}
    return fields
