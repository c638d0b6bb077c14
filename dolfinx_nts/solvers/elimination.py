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

Values at the few nodes of a neighbourhood that a rank needs.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
from dolfinx import la

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Array, Flags, Floats, Ints
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["ActivePairs", "Coupling", "Elimination", "PartialScatter"]


_NONE = np.empty(0)


class PartialScatter:
    """Some nodes: only what they and other ranks need of a nodal vector is touched.

    Vectors are over the owned nodes, shape ``(n, 3)``, and excerpts over
    these nodes, shape ``(m, 3)``.

    Args:
        scatter: Brings values of nodes to this rank.
        nodes: Numbers in its index map, ascending, shape ``(m,)``.
    """

    def __init__(self, scatter: NodalScatter, nodes: Ints) -> None:
        """Divide them into owned ones and ghosts."""
        self._scatter, self._num_nodes = scatter, len(nodes)
        self._num_owned = int(np.searchsorted(nodes, scatter.index_map.size_local))
        self._owned, self._ghosts = np.split(nodes, [self._num_owned])

    def take(self, x: Floats) -> Floats:
        """PartialScatter of a vector. Collective."""
        shared, values = self._scatter.shared, self._values
        values[shared] = x[shared]
        self._scatter.vector.scatter_forward()
        return np.concatenate([x[self._owned], values[self._ghosts]])

    def owned(self, y: Floats) -> Floats:
        """PartialScatter of a vector, zero at ghosts. Local."""
        part = np.zeros((self._num_nodes, 3))
        part[: self._num_owned] = y[self._owned]
        return part

    def put(self, part: Floats, y: Floats) -> None:
        """Set a vector at the owned nodes, and add at owners what ghosts have. Collective."""
        y[self._owned], ghosts = np.split(part, [self._num_owned])
        shared, values = self._scatter.shared, self._values
        values[shared] = values[self._scatter.index_map.size_local :] = 0.0
        values[self._ghosts] = ghosts
        self._scatter.vector.scatter_reverse(la.InsertMode.add)
        y[shared] += values[shared]

    @property
    def _values(self) -> Floats:
        values: Floats = self._scatter.vector.array.reshape(-1, 3)
        return values


class ActivePairs(NamedTuple):
    """Active pairs of one contact pair, see `ContactContribution`.

    Attributes:
        kernel: The projections on their constraints, in an excerpt.
        excerpt: Their nodes; None where a rank knows all values: then it is
            the vector itself.
        place: Of ``dofs`` in the excerpt, shape ``(m, 1+k)``.
        scatter: Carries their values between ranks.
        fixed: Whether the node cannot give up what constraints determine.
        excess: What they should make zero, shape ``(m, 3)`` [m].
        dofs: Nodes in its index map, shape ``(m, 1+k)``.
        rank: Number of constraints, shape ``(m,)``.
        normal: Unit normal at the node, shape ``(m, 3)``.
        gradients: Of the constraints, shape ``(m, 3, d)``.
        columns: Force per multiplier, shape ``(m, 3, d)``.
        tangent: Contact tangent, shape ``(m, d, d)``.
    """

    kernel: _kernels.Elimination
    excerpt: PartialScatter | None
    place: Ints
    scatter: NodalScatter
    fixed: Flags
    excess: Floats
    dofs: Array
    rank: Ints
    normal: Floats
    gradients: Floats
    columns: Floats
    tangent: Floats

    @classmethod
    def of(cls, candidates: Candidates, state: ContactContribution) -> "ActivePairs":
        """The active ones of a state."""
        pairs, scatter = state.pairs, candidates.scatter
        arrays: tuple[Any, ...] = (
            *(pairs.fixed, pairs.excess, pairs.dofs, state.rank),
            *(pairs.normal, pairs.gradients, state.columns, state.tangent),
        )
        if not state.active.all():
            active = np.flatnonzero(state.active)
            arrays = tuple(array.take(active, axis=0) for array in arrays)
        excerpt, place = None, arrays[2]
        if not scatter.is_local:
            nodes, place = np.unique(place, return_inverse=True)
            excerpt = PartialScatter(scatter, nodes)
            place = place.reshape(arrays[2].shape).astype(np.int32)
        kernel = _kernels.Elimination(place, *arrays[3:])
        return cls(kernel, excerpt, place, scatter, *arrays)

    def global_dofs(self) -> Array:
        """Global numbers of the nodes, shape ``(m, 1+k)``."""
        nodes: Array = self.scatter.global_nodes(self.dofs)
        return nodes

    @property
    def constrained(self) -> Ints:
        """Nodes with constraints."""
        nodes: Ints = self.dofs[self.rank > 0, 0]
        return nodes


class Elimination:
    """Projections for the active pairs of one Newton iteration.

    Collective, as all its methods. Vectors are nodal, shape ``(n, 3)``,
    over the owned nodes.

    Args:
        steps: Contact attempts.
        states: Their pairs; unless `Coupling` finds none between them,
            the pairs are all there is to use.

    Attributes:
        pairs: Active pairs, one item for each contact pair that has any.
        pairing: Tells the same nodes and constraints from others.
    """

    def __init__(self, steps: Sequence[ContactStep], states: Sequence[ContactContribution]) -> None:
        """Compress the arrays to the active pairs."""
        # An exchange is collective: leave out what is empty on all ranks.
        self.pairs = [
            ActivePairs.of(step.candidates, state)
            for step, state in zip(steps, states, strict=True)
            if step.num_active
        ]
        parts = (part for p in self.pairs for part in (p.global_dofs(), p.rank))
        self.local_search = b"".join(part.tobytes() for part in parts)

    @property
    def empty(self) -> bool:
        """Whether no pair is active on any rank."""
        return not self.pairs

    def particular(self, n: int) -> tuple[Floats, list[Floats]]:
        """Nodal vector x_p with G^T x_p = -(g - g_ref), and as `constrain`."""
        x = np.zeros((n, 3))
        return x, self._constrain(x, [-p.excess for p in self.pairs])

    def constrain(self, x: Floats) -> list[Floats]:
        """Replace x by Z x; returns an excerpt of Z x for each of `pairs`."""
        return self._constrain(x, [_NONE] * len(self.pairs))

    def _constrain(self, x: Floats, values: list[Floats]) -> list[Floats]:
        parts = [x if p.excerpt is None else p.excerpt.take(x) for p in self.pairs]
        for p, value, part in zip(self.pairs, values, parts, strict=True):
            p.kernel.constrain(value, part)
            if part is not x:
                x[p.constrained] = part[p.place[p.rank > 0, 0]]
        return parts

    def act(self, parts: list[Floats], y: Floats) -> Floats:
        """Z~^T (y + sum lambda dF/dq x), x as `constrain` returns it; overwrites y."""
        for p, x in zip(self.pairs, parts, strict=True):
            part = y if p.excerpt is None else p.excerpt.owned(y)
            p.kernel.act(x, part)
            if p.excerpt is not None:
                p.excerpt.put(part, y)
        return y


class Coupling:
    """Whether the projections exist, looked at only where pairs have changed.

    They do not where a constrained node takes part in another active pair,
    or is fixed.

    Args:
        comm: Communicator.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        """Start without pairs."""
        self._comm = comm
        self._pairing = b"", b""
        self._is_coupled = False

    def of(self, elimination: Elimination) -> bool:
        """Whether the pairs of a Newton iteration are coupled. Collective."""
        if elimination.empty:
            return False
        fixed = b"".join(p.fixed.tobytes() for p in elimination.pairs)
        pairing = elimination.local_search, fixed
        if reductions.anywhere(self._comm, pairing != self._pairing):
            self._pairing = pairing
            self._is_coupled = reductions.anywhere(self._comm, _coupled(elimination.pairs))
        return self._is_coupled


def _coupled(pairs: Sequence[ActivePairs]) -> bool:
    """Whether some are on this rank. Collective."""
    taken: Any = 0
    others: Any = 0
    blocked = False
    for p in pairs:
        constrained = p.rank > 0
        marks: Floats = np.zeros((p.scatter.num_local, 3))
        marks[p.constrained, 0] = 1  # each node is in one pair of a contact pair
        marks[p.dofs[~constrained, 0], 1] = 1
        marks[p.dofs[:, 1:].ravel(), 1] = 1
        marks = p.scatter.reverse(marks)
        taken, others = taken + marks[:, 0], others + marks[:, 1]
        blocked = blocked or bool(p.fixed[constrained].any())
    return blocked or bool(((taken > 1) | ((taken > 0) & (others > 0))).any())
