r"""Contact correction by a dense Schur complement, with the factors of the bulk.

Near incompressibility a single contact node cannot move without changing the volume of its cells.
Contact then has long-range effects, and a correction in its neighbourhood converges slowly. Where
contact involves few nodes, the complete system with the factors B of the bulk,

.. math:: (B^{-1} + U C U^T) z + U F \lambda = r, \qquad G^T U^T z = 0,

is solved instead. U selects the nodes of the contacts, C is the contact tangent, F and G are forces
and gradients of the constraints. With :math:`z_0 = B r` and the flexibility :math:`S = U^T B U` the
displacement :math:`s = U^T z` of these nodes follows from

.. math:: (1 + S C) s + S F \lambda = U^T z_0, \qquad G^T s = 0,

a dense system, and then :math:`z = z_0 - B U (C s + F \lambda)`. The columns of B U depend on the
nodes, not on the state of the contacts, and are kept as long as the factors. They also give the
compliance matrix of the contact points, see `cone_problem`.
"""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Array, Flags, Floats, GlobalInts
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.linear.contact_blocks import ContactBlocks
from dolfinx_nts.solvers.linear.elimination import ActivePairs, Elimination
from dolfinx_nts.solvers.precond.mobility import Mobility
from dolfinx_nts.solvers.precond.preconditioner import BulkPreconditioner
from dolfinx_nts.solvers.precond.tangent import Tangent

__all__ = ["ContactComplement"]

_NONE: GlobalInts = np.empty(0, dtype=np.int64)
_MOST_NODES = 400  # largest number of nodes with stored columns, including former contacts


class ContactComplement:
    """Corrects solutions of the bulk preconditioner for contact by a dense system.

    Args:
        tangent: Matrix of the bulk.
        bulk: Preconditioner of the bulk; its responses must be available in `update`.

    Attributes:
        num_columns: Number of bulk solutions for unit forces so far.
    """

    def __init__(self, tangent: Tangent, bulk: BulkPreconditioner) -> None:
        self._tangent, self._bulk = tangent, bulk
        # Nodes in the order of their columns. The size of a batch changes the last digit of its
        # columns, so a resumed run must use the same batches.
        self._batches: list[GlobalInts] = []
        self._version = -1  # version of the factors that gave the columns
        self._columns: list[Floats] = []  # by batch of k nodes, each of shape (d n, d k)
        self._flexibility: Floats = np.empty((0, 0))  # shape (d k, d k)
        self._reached: Array = np.empty(0, dtype=np.int64)  # columns of the current contacts
        self._response: Floats = np.empty((0, 0))  # maps U^T z_0 to the force C s + F lambda
        self.num_columns = 0

    def update(self, elimination: Elimination) -> None:
        """Compute columns of B U of new contact nodes; factorise the dense system. Collective.

        Args:
            elimination: Active pairs.
        """
        contacts = self._gathered(elimination.pairs)
        nodes = self._reach(contacts)
        self._response = _response(self._among_reached, *_dense(nodes, contacts, self._dim))

    def condensed(
        self,
        R: Floats,
        pairs: Sequence[ActivePairs],
        is_point: Flags,
        present: Floats,
        mobility: Mobility | None = None,
        immobile: GlobalInts = _NONE,
    ) -> tuple[Floats, Floats] | None:
        """Condense the system to the contact points, see `CondensedSystem`. Collective.

        ``mobility`` is the additional compliance of free bodies, if any. ``immobile`` are the nodes
        of rigid bodies without free motion, the same on all ranks.
        """
        # The geometric stiffness of contact is left out: the factors do not contain the geometric
        # stiffness of the bodies, which would balance it.
        contacts = [
            blocks._replace(tangent_nodes=blocks.tangent_nodes[:0], tangent=blocks.tangent[:0])
            for blocks in self._gathered(pairs)
        ]
        nodes = self._reach(contacts)
        C, F, G = _dense(nodes, contacts, self._dim)
        excess = [p.excess[np.arange(self._dim) < p.blocks.rank[:, None]] for p in pairs]
        parts = self._tangent.comm.allgather(excess)
        gaps = np.concatenate([values for part in parts for values in part])
        alone = self._bulk.responses(-np.asfortranarray(R[:, None]))
        S, s = self._among_reached, self._at_known(alone)[self._reached]
        if len(immobile):
            moves = np.repeat(~np.isin(nodes, immobile), self._dim)
            S, s = S * np.outer(moves, moves), s * moves
        if mobility is not None:
            motions = np.array([self._at_known(m)[self._reached] for m in mobility.motions])
            S = S + motions.T @ mobility.compliance @ motions
            s += mobility.by(self._tangent.comm, -R) @ motions
        by_points = S @ F[:, is_point]
        A, m = _system(S, C, F[:, ~is_point], G[~is_point]), len(s)
        right = np.zeros((len(A), 1 + len(present)))
        right[:m] = np.column_stack([s + by_points @ present, by_points])
        right[m:, 0] = -gaps[~is_point]
        try:
            moved = G[is_point] @ np.linalg.solve(A, right)[:m]
        except np.linalg.LinAlgError:
            return None
        return moved[:, 1:], moved[:, 0] + gaps[is_point]

    def _gathered(self, pairs: Sequence[ActivePairs]) -> list[ContactBlocks]:
        """Pairs of all ranks, rank by rank. Collective."""
        parts = self._tangent.comm.allgather([some.global_blocks() for some in pairs])
        return [blocks for part in parts for blocks in part]

    def _reach(self, contacts: Sequence[ContactBlocks]) -> GlobalInts:
        """Compute missing columns of B U for contact nodes; return these nodes. Collective."""
        nodes: GlobalInts = np.unique(np.concatenate([b.nodes for b in contacts]))
        nodes = np.union1d(nodes, np.concatenate([b.tangent_nodes.ravel() for b in contacts]))
        if self._version != self._bulk.num_builds:
            self._forget([])
        new = np.setdiff1d(nodes, self._known)
        if len(new) + len(self._known) > max(_MOST_NODES, len(nodes)):
            self._forget([])
            new = nodes
        if len(new):
            self._batches.append(new.astype(np.int64))
        if len(self._columns) < len(self._batches):
            self._solve()
        known = self._known
        order = np.argsort(known)
        self._reached = _dofs(order[np.searchsorted(known, nodes, sorter=order)], self._dim)
        return nodes

    def correct(self, _r: Floats, z: Floats) -> None:
        """Correct the solution of the bulk. Collective.

        Args:
            z: Values at the owned nodes, shape ``(n, d)``, overwritten.
        """
        d, known = self._dim, self._at_known(z)
        force = np.zeros_like(known)
        force[self._reached] = self._response @ known[self._reached]
        if self._bulk.is_strong:
            ends = np.cumsum([columns.shape[1] for columns in self._columns])
            for columns, part in zip(self._columns, np.split(force, ends[:-1]), strict=True):
                z -= (columns @ part).reshape(-1, d)
            return
        # Another application of incomplete factors is cheaper than a product with all columns.
        owned, place = self._owned(self._known)
        forces = np.zeros((z.size, 1), order="F")
        forces[_dofs(owned, d), 0] = force[_dofs(place, d)]
        z -= self._bulk.responses(forces).reshape(-1, d)

    def serialize(self, archive: Archive) -> None:
        """Serialize the nodes of the columns, after the factors. Collective."""
        is_present = self._version == self._bulk.num_builds
        known = self._batches if is_present and self._batches else None
        batches = archive.local("complement", known)
        if archive.restores:
            self._forget(batches or [])

    @property
    def _known(self) -> GlobalInts:
        """Nodes of the stored columns, in the order of the columns."""
        return np.concatenate([np.empty(0, dtype=np.int64), *self._batches])

    @property
    def _dim(self) -> int:
        """Components of a node."""
        return self._tangent.rows.dim

    @property
    def _among_reached(self) -> Floats:
        """Flexibility matrix S restricted to the contact nodes."""
        flexibility: Floats = self._flexibility[np.ix_(self._reached, self._reached)]
        return flexibility

    def _at_known(self, z: Floats) -> Floats:
        """Values at all nodes of the columns, from values at the owned nodes. Collective."""
        owned, place = self._owned(self._known)
        values = np.zeros(len(self._flexibility))
        values[_dofs(place, self._dim)] = z.reshape(-1, self._dim)[owned].ravel()
        total: Floats = reductions.total(self._tangent.comm, values)
        return total

    def _forget(self, batches: Sequence[Array]) -> None:
        """Discard all columns, and set the nodes of the new columns."""
        self._version, self._batches, self._columns = self._bulk.num_builds, list(batches), []

    def _owned(self, nodes: GlobalInts) -> tuple[Array, Array]:
        """Local numbers of the owned nodes in a list of nodes, and their positions in the list."""
        first, last = self._tangent.rows.index_map.local_range
        place = np.flatnonzero((nodes >= first) & (nodes < last))
        return nodes[place] - first, place

    def _solve(self) -> None:
        """Compute the missing columns. Collective."""
        d = self._tangent.rows.dim
        n = d * self._tangent.rows.index_map.size_local
        for batch in self._batches[len(self._columns) :]:
            forces = np.zeros((n, d * len(batch)), order="F")
            owned, place = self._owned(batch)
            forces[_dofs(owned, d), _dofs(place, d)] = 1
            self._columns.append(self._bulk.responses(forces))
            self.num_columns += d * len(batch)
        owned, place = self._owned(self._known)
        rows = [columns[_dofs(owned, d)] for columns in self._columns]
        flexibility = np.zeros((d * len(self._known),) * 2)
        flexibility[_dofs(place, d)] = np.hstack(rows)
        self._flexibility = reductions.total(self._tangent.comm, flexibility)


def _dofs(nodes: Array, d: int) -> Array:
    """Scalar dofs of some nodes, shape ``(d m,)``."""
    dofs: Array = (d * nodes[:, None] + np.arange(d)).ravel()
    return dofs


def _dense(
    nodes: GlobalInts, contacts: Sequence[ContactBlocks], d: int
) -> tuple[Floats, Floats, Floats]:
    """Dense tangent C, ``(d k, d k)``, forces F, ``(d k, m)``, and gradients G^T of constraints.

    Args:
        nodes: Nodes of the contacts, ascending, shape ``(k,)``.
        contacts: Constraints and tangents, of these nodes only.
        d: Components of a node.
    """
    n = d * len(nodes)
    C = np.zeros((n, n))
    F: list[Floats] = [np.empty((0, n))]
    G: list[Floats] = [np.empty((0, n))]
    for blocks in contacts:
        lists = np.searchsorted(nodes, blocks.nodes)
        gradients, columns = (
            some.reshape(-1, d * d) for some in (blocks.gradients, blocks.columns)
        )
        for i, (rank, slope) in enumerate(zip(blocks.rank, blocks.slopes, strict=True)):
            entries = slice(blocks.start[i], blocks.start[i + 1])
            dofs, dense = _dofs(lists[entries], d), np.zeros((2, d, n))
            for result, rows in zip(dense, (gradients, columns), strict=True):
                # Lists may name a node twice.
                np.add.at(result.T, dofs, rows[entries].reshape(d, -1).T)
            G.append(dense[0, :rank])
            F.append(dense[1, :rank])
            if slope.any():
                C += dense[1].T @ slope @ dense[0]
        of_blocks = d * np.searchsorted(nodes, blocks.tangent_nodes)[:, :, None] + np.arange(d)
        of_blocks = of_blocks.reshape(blocks.tangent.shape[:2])
        entry = n * of_blocks[:, :, None] + of_blocks[:, None]
        C += np.bincount(entry.ravel(), blocks.tangent.ravel(), n * n).reshape(n, n)
    return C, np.vstack(F).T, np.vstack(G)


def _system(S: Floats, C: Floats, F: Floats, G: Floats) -> Floats:
    """Matrix of the dense system for s and lambda, from the matrices of `_dense`."""
    n, m = F.shape
    return np.block([[np.eye(n) + S @ C, S @ F], [G, np.zeros((m, m))]])


def _response(S: Floats, C: Floats, F: Floats, G: Floats) -> Floats:
    """Matrix that maps displacements U^T z_0 to forces C s + F lambda, shape ``(d k, d k)``."""
    n, m = F.shape
    try:
        solution = np.linalg.solve(_system(S, C, F, G), np.eye(n + m, n))
    except np.linalg.LinAlgError:  # the system of bulk and contact is also singular
        return np.zeros((n, n))
    response: Floats = np.hstack([C, F]) @ solution
    return response
