"""History of contact after an accepted step: state of the nodes, and energies by cause."""

import operator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints

__all__ = [
    "APART",
    "NEVER",
    "ContactHistory",
    "ContactWork",
    "contact_sums",
    "reloaded",
    "unloaded",
    "without_friction",
]

# Key of a node without a segment at the start of a run, or after displacements were set. Its spring
# may be loaded initially.
NEVER = -2
# The same if the bodies of both sides do not overlap. Its spring is not loaded initially.
APART = -3


@dataclass(frozen=True)
class ContactHistory:
    """Accepted contact of the owned nodes of a pair at t_n.

    Attributes:
        key: Key of the segment of each node, -1 without one, `NEVER` or `APART`, ``(n,)``.
        shared: Sum of the keys of the segments of a node that is equally near to several, which
            distinguishes sets of segments; 0 with one segment or none, shape ``(n,)``.
        active: Whether the node transmits force, shape ``(n,)``.
        sliding: Whether an active node slides, shape ``(n,)``.
        lambda_N: Multiplier of the last step, shape ``(n,)`` [N, <= 0].
        force: Contact force on the node in the last step, shape ``(n, 3)`` [N].
        gap: Gap to the segment, NaN without one, shape ``(n,)`` [m].
        offset: Gap at which a penalty spring begins, shape ``(n,)`` [m].
        soft_depth: Compression beyond which a penalty spring is stiffer, shape ``(n,)`` [m].
        part: Fraction of the stiffness of the penalty spring of a node that acts, shape ``(n,)``
            [-]: less than 1 at edges, and above segments softer than the stiffest one.
        normal: Unit normal of the segment at nodes that touch or may touch, otherwise 0, shape
            ``(n, 3)``.
        traction: Cartesian traction of friction, against the motion, shape ``(n, 3)`` [N].
        slip: Accumulated length of slip, shape ``(n,)`` [m].
        energy: Energy of the node's springs, shape ``(n,)`` [J].
        dissipation: Energy dissipated by friction in the last step, shape ``(n,)`` [J].
        partner: Bodies that take the reactions to the force of the multiplier, or -1, shape
            ``(n, w)``: only in implicit steps, see `Passes.sharing_bodies`.
        reaction: These reactions, shape ``(n, w, 3)`` [N].
        area: Area on which the multiplier acts, shape ``(n,)`` [m^2]: of all facets around the
            node, see `Tractions.area`, or in mortar contact the area covered by segments.
        dual_fraction: Largest fraction of dual functions around the node in mortar contact, see
            `FacetPoints`, ``(n,)`` [-]; 1 otherwise.
    """

    key: GlobalInts
    shared: GlobalInts
    active: Flags
    sliding: Flags
    lambda_N: Floats
    force: Floats
    gap: Floats
    offset: Floats
    soft_depth: Floats
    part: Floats
    normal: Floats
    traction: Floats
    slip: Floats
    energy: Floats
    dissipation: Floats
    partner: Ints
    reaction: Floats
    area: Floats
    dual_fraction: Floats

    @classmethod
    def at(cls, n: int, node: Ints, **values: Floats) -> "ContactHistory":
        """Create the history of n nodes, of which some have contact. Local.

        ``node`` are the indices of nodes with contact, shape ``(m,)``, and ``values`` their
        attributes by name, shape ``(m, ...)``.
        """
        history = cls.none(n)
        for name, value in values.items():
            getattr(history, name)[node] = value
        return history

    @classmethod
    def none(cls, n: int) -> "ContactHistory":
        """Create the history of n nodes without contact. Local."""
        return cls(
            key=np.full(n, -1, dtype=np.int64),
            shared=np.zeros(n, dtype=np.int64),
            active=np.zeros(n, dtype=bool),
            sliding=np.zeros(n, dtype=bool),
            lambda_N=np.zeros(n),
            force=np.zeros((n, 3)),
            gap=np.full(n, np.nan),
            offset=np.zeros(n),
            soft_depth=np.full(n, np.inf),
            part=np.ones(n),
            normal=np.zeros((n, 3)),
            traction=np.zeros((n, 3)),
            slip=np.zeros(n),
            energy=np.zeros(n),
            dissipation=np.zeros(n),
            partner=np.full((n, 1), -1, dtype=np.int32),
            reaction=np.zeros((n, 1, 3)),
            area=np.zeros(n),
            dual_fraction=np.ones(n),
        )


class ContactWork(NamedTuple):
    """Energy that contact gave to the bodies in a step, by cause [J].

    Attributes:
        persistent: By nodes that were active on the same segment in the last step.
        activation: By nodes that were inactive in the last step.
        facet_change: By nodes that were active on another segment in the last step.
        springs: Released by penalty and friction springs.
        friction: Minus the dissipation by friction.
        obstacles: Work of moving obstacles.
        equilibrium: Strain energy added by the static solve of massless nodes.
        refund: Kinetic energy returned to vibration to correct for `equilibrium`.
    """

    persistent: float = 0.0
    activation: float = 0.0
    facet_change: float = 0.0
    springs: float = 0.0
    friction: float = 0.0
    obstacles: float = 0.0
    equilibrium: float = 0.0
    refund: float = 0.0

    def __add__(self, other: "ContactWork") -> "ContactWork":  # type: ignore[override]
        """Add energies cause by cause. Local."""
        return ContactWork(*map(operator.add, self, other))


def contact_sums(history: ContactHistory, x: Floats, nodes: Ints, area: Floats) -> Floats:
    """Contact sums over the nodes of a pair on this rank. Local.

    Args:
        history: Their contact.
        x: Positions at which the forces act, including these nodes, shape ``(l, 3)`` [m].
        nodes: Rows of the nodes in x, shape ``(n,)``.
        area: Reference areas on which the nodes transmit force, shape ``(n,)`` [m^2].

    Returns:
        Energy of springs [J], number and reference area [m^2] of nodes that transmit force, force
        [N] and torque about the origin [N m], shape ``(9,)``.
    """
    contact = history.force, history.energy, history.active, area
    return _kernels.contact_sums(x, nodes, *contact, area)


def without_friction(history: ContactHistory) -> ContactHistory:
    """Copy without slip and friction traction. Local."""
    none = ContactHistory.none(len(history.key))
    names = ("sliding", "traction", "slip", "dissipation")
    return replace(history, **{name: getattr(none, name) for name in names})


def unloaded(history: ContactHistory) -> ContactHistory:
    """Copy in which no spring is loaded initially, as both sides do not overlap. Local.

    Mean gaps may be negative next to corners even if the bodies are apart.
    """
    return replace(history, key=np.where(history.key == NEVER, APART, history.key))


def reloaded(history: ContactHistory) -> ContactHistory:
    """Copy in which penetrating nodes without a segment have loaded springs initially. Local."""
    return replace(history, key=np.where(history.key < 0, NEVER, history.key))
