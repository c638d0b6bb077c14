"""What an accepted step leaves of contact: state of the nodes, energy by cause."""

import operator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts, Ints

__all__ = ["ContactHistory", "ContactWork"]


@dataclass(frozen=True)
class ContactHistory:
    """Accepted contact of the owned nodes of a pair at t_n.

    Attributes:
        key: Segment of each node, -1 without, shape ``(n,)``.
        active: Whether the node transmits force, shape ``(n,)``.
        sliding: Whether an active node slides, shape ``(n,)``.
        lambda_N: Multiplier of the last step, shape ``(n,)`` [N, <= 0].
        force: Contact force on the node in it, shape ``(n, 3)`` [N].
        gap: Gap to the segment, NaN without, shape ``(n,)`` [m].
        offset: Gap at which a penalty spring starts, ``(n,)`` [m].
        normal: Normal of the segment, shape ``(n, 3)``.
        traction: StickSlip part that friction remembers, Cartesian,
            against the motion, shape ``(n, 3)`` [N].
        slip: Accumulated length of slip, shape ``(n,)`` [m].
        energy: Stored in the node's springs, shape ``(n,)`` [J].
        dissipation: Lost by friction in the last step, ``(n,)`` [J].
    """

    key: GlobalInts
    active: Flags
    sliding: Flags
    lambda_N: Floats
    force: Floats
    gap: Floats
    offset: Floats
    normal: Floats
    traction: Floats
    slip: Floats
    energy: Floats
    dissipation: Floats

    @classmethod
    def at(cls, n: int, node: Ints, **values: Floats) -> "ContactHistory":
        """Contact of some of n nodes; no contact at the others.

        Args:
            n: Number of nodes.
            node: Positions among the nodes, shape ``(m,)``.
            **values: Attributes by name, of these nodes, ``(m, ...)``.
        """
        history = cls.none(n)
        for name, value in values.items():
            getattr(history, name)[node] = value
        return history

    @classmethod
    def none(cls, n: int) -> "ContactHistory":
        """No contact at n nodes."""
        return cls(
            key=np.full(n, -1, dtype=np.int64),
            active=np.zeros(n, dtype=bool),
            sliding=np.zeros(n, dtype=bool),
            lambda_N=np.zeros(n),
            force=np.zeros((n, 3)),
            gap=np.full(n, np.nan),
            offset=np.zeros(n),
            normal=np.zeros((n, 3)),
            traction=np.zeros((n, 3)),
            slip=np.zeros(n),
            energy=np.zeros(n),
            dissipation=np.zeros(n),
        )


class ContactWork(NamedTuple):
    """Energy that contact gave to the bodies in a step, by cause [J].

    Attributes:
        persistent: Nodes that were active on the same segment before.
        activation: Nodes that were not active before.
        facet_change: Nodes that were active on another segment.
        springs: Taken from penalty and friction springs.
        friction: Minus the dissipation.
    """

    persistent: float = 0.0
    activation: float = 0.0
    facet_change: float = 0.0
    springs: float = 0.0
    friction: float = 0.0

    def __add__(self, other: "ContactWork") -> "ContactWork":  # type: ignore[override]
        """Sum by cause."""
        return ContactWork(*map(operator.add, self, other))
