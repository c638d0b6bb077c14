r"""Elimination of the multipliers from the linear systems of Newton's method.

Each active node gives up its normal displacement, which the constraint
determines, so Krylov methods see a system of the size and condition of the
bulk and no saddle point. With one column E per active pair, the node's
normal at the node, the gap gradients G, the forces F, and

.. math:: Z = 1 - E (G^T E)^{-1} G^T, \qquad
          \tilde Z^T = 1 - F (E^T F)^{-1} E^T,

the increment is :math:`\Delta u = x_p + Z y` with a particular part
:math:`x_p` that satisfies the constraints, and the multipliers follow from
the balance of normal forces at the nodes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_nts import _kernels
from dolfinx_nts.contact_rows import ContactState
from dolfinx_nts.contact_step import ContactStep
from dolfinx_nts.obstacle_neighbourhood import ObstacleNeighbourhood
from dolfinx_nts.search import Neighbourhood

__all__ = ["ActivePairs", "Elimination", "coupled"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]

_NONE = np.empty(0)


@dataclass(frozen=True)
class ActivePairs:
    """Active pairs of one contact pair, see `ContactState`.

    Attributes:
        here: Neighbourhood that carries their values between ranks.
        dofs: Nodes in its index map, shape ``(m, 1+k)``.
        rank: Number of constraints, shape ``(m,)``.
        normal: Unit normal at the node, shape ``(m, 3)``.
        gradients: Of the constraints, shape ``(m, 3, d)``.
        columns: Force per multiplier, shape ``(m, 3, d)``.
        tangent: Contact tangent, shape ``(m, d, d)``.
    """

    here: Neighbourhood | ObstacleNeighbourhood
    dofs: npt.NDArray[Any]
    rank: Ints
    normal: Floats
    gradients: Floats
    columns: Floats
    tangent: Floats

    @classmethod
    def of(cls, here: Neighbourhood | ObstacleNeighbourhood, state: ContactState) -> "ActivePairs":
        """The active ones of a state."""
        names = ("dofs", "rank", "normal", "gradients", "columns", "tangent")
        return cls(here, *(getattr(state, name)[state.active] for name in names))

    def global_dofs(self) -> npt.NDArray[np.int64]:
        """Global numbers of the nodes, shape ``(m, 1+k)``."""
        nodes = self.here.index_map.local_to_global(self.dofs.ravel())
        return np.asarray(nodes).reshape(self.dofs.shape)


class Elimination:
    """Projections for the active pairs of one Newton iteration.

    Collective, as all its methods. Vectors are nodal, shape ``(n, 3)``,
    over the owned nodes.

    Args:
        steps: Contact attempts.
        states: Their pairs; no active node is a vertex of another.

    Attributes:
        pairs: Active pairs, one item for each contact pair that has any.
    """

    def __init__(self, steps: Sequence[ContactStep], states: Sequence[ContactState]) -> None:
        """Compress the arrays to the active pairs."""
        # An exchange is collective: leave out what is empty on all ranks.
        active = [
            (step.neighbourhood, state)
            for step, state in zip(steps, states, strict=True)
            if step.num_active
        ]
        self.pairs = [ActivePairs.of(here, state) for here, state in active]
        self._excess = [state.excess[state.active] for _, state in active]
        self._node = [p.dofs[p.rank > 0, 0] for p in self.pairs]

    @property
    def empty(self) -> bool:
        """Whether no pair is active on any rank."""
        return not self.pairs

    @property
    def pairing(self) -> bytes:
        """Tells the same nodes and constraints from others. Local."""
        parts = (part for p in self.pairs for part in (p.global_dofs(), p.rank))
        return b"".join(part.tobytes() for part in parts)

    def particular(self, n: int) -> tuple[Floats, list[Floats]]:
        """Nodal vector x_p with G^T x_p = -(g - g_ref), and as `constrain`."""
        x = np.zeros((n, 3))
        return x, self._constrain(x, [-excess for excess in self._excess])

    def constrain(self, x: Floats) -> list[Floats]:
        """Replace x by Z x; returns Z x with ghosts for each of `pairs`."""
        return self._constrain(x, [_NONE] * len(self.pairs))

    def _constrain(self, x: Floats, values: list[Floats]) -> list[Floats]:
        parts = [p.here.with_ghosts(x) for p in self.pairs]
        for p, node, value, part in zip(self.pairs, self._node, values, parts, strict=True):
            _kernels.constrain(p.dofs, p.rank, p.normal, p.gradients, value, part)
            if part is not x:
                x[node] = part[node]
        return parts

    def act(self, parts: list[Floats], y: Floats) -> Floats:
        """Z~^T (y + sum lambda dF/dq x), x as `constrain` returns it; overwrites y."""
        for p, x in zip(self.pairs, parts, strict=True):
            local = p.here.with_room(y)
            _kernels.act(p.dofs, p.rank, p.normal, p.columns, p.tangent, x, local)
            y = p.here.to_owners(local)
        return y


def coupled(steps: Sequence[ContactStep], states: Sequence[ContactState]) -> bool:
    """Whether a constrained node takes part in another active pair, or is fixed.

    Then the projections above do not exist. Collective.
    """
    taken: Any = 0
    others: Any = 0
    blocked = False
    comm = None
    for step, state in zip(steps, states, strict=True):
        if not step.num_active:
            continue
        comm = step.comm
        here = step.neighbourhood
        constrained = state.rank > 0
        marks: Floats = np.zeros((here.num_local, 3))
        marks[state.dofs[constrained, 0], 0] = 1  # each node is in one pair of the state
        marks[state.dofs[state.active & ~constrained, 0], 1] = 1
        marks[state.dofs[state.active, 1:].ravel(), 1] = 1
        marks = here.to_owners(marks)
        taken, others = taken + marks[:, 0], others + marks[:, 1]
        blocked = blocked or bool(np.any(~state.eliminable[constrained]))
    if comm is None:
        return False
    blocked = blocked or bool(np.any((taken > 1) | ((taken > 0) & (others > 0))))
    return bool(comm.allreduce(blocked))
