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
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_nts import _kernels
from dolfinx_nts.contact_rows import ContactState
from dolfinx_nts.contact_step import ContactStep
from dolfinx_nts.obstacles import ObstacleNeighbourhood
from dolfinx_nts.search import Neighbourhood

__all__ = ["Elimination", "coupled"]

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int32]

_NONE = np.empty(0)


class _Block:
    """Active pairs of one contact pair."""

    def __init__(self, here: Neighbourhood | ObstacleNeighbourhood, state: ContactState) -> None:
        active = state.active
        self.here = here
        self.dofs: Ints = state.dofs[active]
        self.rank: Ints = state.rank[active]
        self.normal: Floats = state.normal[active]
        self.gradients: Floats = state.gradients[active]
        self.columns: Floats = state.columns[active]
        self.tangent: Floats = state.tangent[active]
        self.excess: Floats = state.excess[active]
        self.node: Ints = self.dofs[self.rank > 0, 0]


class Elimination:
    """Projections for the active pairs of one Newton iteration.

    Collective, as all its methods. Vectors are nodal, shape ``(n, 3)``,
    over the owned nodes.

    Args:
        steps: Contact attempts.
        states: Their pairs; no active node is a vertex of another.
    """

    def __init__(self, steps: Sequence[ContactStep], states: Sequence[ContactState]) -> None:
        """Compress the arrays to the active pairs."""
        blocks = [
            _Block(step.neighbourhood, state) for step, state in zip(steps, states, strict=True)
        ]
        # An exchange is collective: leave out what is empty on all ranks.
        self._blocks = [b for b, step in zip(blocks, steps, strict=True) if step.num_active]

    @property
    def empty(self) -> bool:
        """Whether no pair is active on any rank."""
        return not self._blocks

    @property
    def pairing(self) -> bytes:
        """Tells the same nodes and constraints from others. Local."""
        return b"".join(part.tobytes() for b in self._blocks for part in (b.dofs, b.rank))

    def particular(self, n: int) -> Floats:
        """Nodal vector x_p with G^T x_p = -(g - g_ref)."""
        x = np.zeros((n, 3))
        for b in self._blocks:
            local = np.zeros((b.here.num_local, 3))
            _kernels.constrain(b.dofs, b.rank, b.normal, b.gradients, -b.excess, local)
            x[b.node] = local[b.node]
        return x

    def constrain(self, x: Floats) -> list[Floats]:
        """Replace x by Z x; returns Z x with ghosts for each block."""
        parts = []
        for b in self._blocks:
            part = b.here.with_ghosts(x)
            _kernels.constrain(b.dofs, b.rank, b.normal, b.gradients, _NONE, part)
            parts.append(part)
        for b, part in zip(self._blocks, parts, strict=True):
            x[b.node] = part[b.node]
        return parts

    def act(self, parts: list[Floats], y: Floats) -> Floats:
        """Z~^T (y + sum lambda dF/dq x), x given as by `constrain`."""
        for b, x in zip(self._blocks, parts, strict=True):
            local = b.here.with_room(y)
            _kernels.act(b.dofs, b.rank, b.normal, b.columns, b.tangent, x, local)
            y = b.here.to_owners(local)
        return y

    def with_ghosts(self, x: Floats) -> list[Floats]:
        """Values with ghosts for each block."""
        return [b.here.with_ghosts(x) for b in self._blocks]

    def fill(self, patch: _kernels.Patch) -> Flags:
        """Add the pairs whose nodes this rank owns to a patch.

        Args:
            patch: Preconditioner of the nodes around the contacts.

        Returns:
            Owned nodes in pairs with nodes of other ranks, shape ``(n,)``.
        """
        foreign: Any = False
        for b in self._blocks:
            num_owned = b.here.index_map.size_local
            own = np.all(b.dofs < num_owned, axis=1)
            marks: Floats = np.zeros((b.here.num_local, 3))
            marks[b.dofs[~own].ravel(), 0] = 1
            foreign = foreign | (b.here.to_owners(marks)[:num_owned, 0] > 0)
            patch.add(
                b.dofs[own],
                b.rank[own],
                b.normal[own],
                b.gradients[own],
                b.columns[own],
                b.tangent[own],
            )
        flags: Flags = foreign
        return flags


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
        np.add.at(marks[:, 0], state.dofs[constrained, 0], 1)
        marks[state.dofs[state.active & ~constrained, 0], 1] = 1
        marks[state.dofs[state.active, 1:].ravel(), 1] = 1
        marks = here.to_owners(marks)
        taken, others = taken + marks[:, 0], others + marks[:, 1]
        blocked = blocked or bool(np.any(~state.eliminable[constrained]))
    if comm is None:
        return False
    blocked = blocked or bool(np.any((taken > 1) | ((taken > 0) & (others > 0))))
    return bool(comm.allreduce(blocked))
