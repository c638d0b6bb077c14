"""Choice of local search, normal contact and friction of a step by the laws of a pair."""

from collections.abc import Callable, Mapping

from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.contact.enforcement import LagrangeMultiplier, Tied
from dolfinx_nts.contact.implicit.crossing_edges import CrossingEdges
from dolfinx_nts.contact.implicit.friction.interface import Friction
from dolfinx_nts.contact.implicit.friction.stick_slip import StickSlip
from dolfinx_nts.contact.implicit.local_search import LocalSearch, StaticSearch
from dolfinx_nts.contact.implicit.mortar.frozen_points import (
    FrozenPoints,
    SettlingPoints,
    TiedPoints,
)
from dolfinx_nts.contact.implicit.normal.interface import NormalContact
from dolfinx_nts.contact.implicit.normal.multiplier import MultiplierContact
from dolfinx_nts.contact.implicit.normal.penalty import PenaltyContact
from dolfinx_nts.contact.implicit.normal.tied import Bond, TiedContact
from dolfinx_nts.contact.implicit.normal.vertex_contact import VertexMultipliers, VertexSprings
from dolfinx_nts.contact.joint_state import JointState, members
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.contact.vertices import VertexState

__all__ = ["make_friction", "make_normal_contact", "make_search"]

# Class of the local search, by the method of the pair and whether there is no inertia.
_SEARCHES: dict[tuple[str, bool | str], type[LocalSearch]] = {
    ("node-to-segment", False): LocalSearch,
    ("node-to-segment", True): StaticSearch,
    ("node-to-segment", "tied"): LocalSearch,
    ("mortar", False): FrozenPoints,
    ("mortar", True): SettlingPoints,
    ("mortar", "tied"): TiedPoints,
    ("edge-to-edge", False): CrossingEdges,
    ("edge-to-edge", True): CrossingEdges,
}


def make_search(
    state: PairState | JointState,
    x_n: Floats,
    x_trial: Floats,
    x_points: Floats,
    is_static: bool,
) -> LocalSearch:
    """Local search of a step, see `ContactStep` for the arguments. Collective."""
    kind = "tied" if isinstance(state.pair.enforcement, Tied) else is_static
    search = _SEARCHES[state.pair.method, kind]
    if issubclass(search, FrozenPoints):
        return search(state, x_n, x_trial, x_points)
    return search(state, x_n, x_trial)


def make_normal_contact(
    state: PairState | JointState,
    is_static: bool,
    search: LocalSearch,
    stiffness: Floats,
    intermediate: Mapping[float, Floats],
    share: float,
    dt: float,
    compression: Callable[[PairState], Floats],
    replace: Callable[[PairState, Flags], int],
) -> NormalContact:
    """Normal contact of a pair by its enforcement. Collective.

    Args:
        state: State of the contact pair or of the pairs.
        is_static: Whether there is no inertia.
        search: Segments of the nodes.
        stiffness: Stiffness of the nodes of the surface, shape ``(n,)`` [N/m].
        intermediate: Positions after fractions of the ballistic motion, see `ContactStep` [m].
        share: Weight of the end of the step in the forces of springs [-].
        dt: Length of the step [s].
        compression: Current compression of springs of other pairs, see `VertexSprings`.
        replace: Excludes nodes of other pairs, see `VertexMultipliers`.
    """
    law = state.pair.enforcement
    exchanged = isinstance(members(state)[0], VertexState)
    if isinstance(law, Tied):
        return TiedContact(state, law, is_static, search, stiffness, intermediate)
    if isinstance(law, LagrangeMultiplier):
        if exchanged:
            return VertexMultipliers(
                state, law, is_static, search, stiffness, intermediate, replace
            )
        return MultiplierContact(state, law, is_static, search, stiffness, intermediate)
    if exchanged:
        return VertexSprings(state, is_static, search, share, dt, compression)
    return PenaltyContact(state, is_static, search, share, dt)


def make_friction(
    state: PairState | JointState,
    is_static: bool,
    search: LocalSearch,
    stiffness: Floats,
    acts_at_end: bool,
    begins_sticking: bool,
    dt: float,
    fraction: Floats,
) -> Friction:
    """Friction of a pair by its laws. Local.

    Args:
        state: State of the contact pair or of the pairs.
        is_static: Whether there is no inertia.
        search: Segments of the nodes.
        stiffness: Stiffness of the nodes of the surface, shape ``(n,)`` [N/m].
        acts_at_end: Whether forces act at the end of the step.
        begins_sticking: Whether all nodes with friction stick at first.
        dt: Length of the step [s].
        fraction: Fraction of the stiffness of default springs that acts, shape ``(n,)`` [-].
    """
    law = state.pair.friction
    if isinstance(state.pair.enforcement, Tied):
        return Bond(state, is_static, search, stiffness, acts_at_end)
    if law is None:
        return Friction(state)
    return StickSlip(
        state, law, is_static, search, stiffness, acts_at_end, begins_sticking, dt, fraction
    )
