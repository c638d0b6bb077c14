"""Subdomain around the contacts on one of several ranks."""

from collections.abc import Sequence

import numpy as np
from dolfinx import common, la

from dolfinx_nts import _kernels, compat
from dolfinx_nts.common.arrays import Array, Floats, GlobalInts, Ints
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import exchanged, rows_by_rank
from dolfinx_nts.solvers.linear.block_csr import BlockCSR
from dolfinx_nts.solvers.linear.contact_blocks import ContactBlocks

__all__ = ["OverlappingSubdomain"]


class OverlappingSubdomain:
    """Subdomain around the contacts of a rank's nodes and of their neighbours.

    Each rank gathers the rows of all these nodes, solves, and keeps the solution at its own nodes.
    Without the contacts of the neighbours iterations increase by a tenth if a border between ranks
    crosses the contact. Collective, as all its methods.

    Args:
        rows: Bulk tangent of the owned nodes; its values may change.
    """

    def __init__(self, rows: BlockCSR) -> None:
        self._rows, space = rows, rows.index_map
        self._ends = np.array(space.comm.allgather(space.local_range[1]))
        # Nodes of this rank that are columns in the rows of each other rank.
        ghosts = rows.matrix.index_map(1).ghosts
        owners = rows_by_rank(space.comm, np.searchsorted(self._ends, ghosts, side="right"))
        self._reached = exchanged(space.comm, {rank: ghosts[k] for rank, k in owners.items()})
        self._reached[space.comm.rank] = np.arange(*space.local_range)
        # Known contact nodes, and the contact nodes among the columns of each rank. Both grow
        # slowly.
        self._known: GlobalInts = np.empty(0, dtype=np.int64)
        self._reaches: dict[int, GlobalInts] = {space.comm.rank: self._known}
        self._version, self._is_wide = -1, False
        self._gathered: _GatheredRows

    @property
    def size(self) -> int:
        """Number of nodes. Local."""
        return self._gathered.size

    def build(self, contacts: Sequence[ContactBlocks], version: int, *, wide: bool = False) -> None:
        """Factorise the subdomain for the contacts of this rank.

        Gathered rows are reused if the matrix is the same and they contain all contact nodes.

        Args:
            contacts: Constraints and tangent of each contact pair, in global numbers.
            version: Number of the matrix's values.
            wide: Whether to include neighbours of neighbours.
        """
        near = self._near(contacts)
        nodes = _unique([part for blocks in near for part in (blocks.nodes, blocks.tangent_nodes)])
        same = (version, wide) == (self._version, self._is_wide)
        enough = same and self._gathered.contain(nodes)
        if not reductions.everywhere(self._rows.index_map.comm, enough):
            self._version, self._is_wide = version, wide
            self._gathered = _GatheredRows(self._rows, self._ends, nodes, wide=wide)
        self._gathered.factorise(near)

    def correct(self, r: Floats, z: Floats) -> None:
        """Constrain z and correct it for the right-hand side r at the owned nodes."""
        self._gathered.correct(r, z)

    def _near(self, contacts: Sequence[ContactBlocks]) -> list[ContactBlocks]:
        """Contacts of all ranks that have a node among the columns of the rows of this rank."""
        comm = self._rows.index_map.comm
        self._find_ranks(_unique([a for c in contacts for a in (c.nodes, c.tangent_nodes.ravel())]))
        parts = {}
        for rank, reached in self._reaches.items():
            part = [_touching(blocks, reached) for blocks in contacts]
            if rank == comm.rank or any(b.nodes.size + b.tangent.size for b in part):
                parts[rank] = part
        received = exchanged(comm, parts).values()
        return [ContactBlocks.concatenated(every) for every in zip(*received, strict=True)]

    def _find_ranks(self, nodes: GlobalInts) -> None:
        """Find the ranks whose rows have new contact nodes as columns."""
        comm = self._rows.index_map.comm
        new = np.setdiff1d(nodes, self._known, assume_unique=True)
        if not reductions.anywhere(comm, len(new) > 0):
            return
        self._known = np.union1d(self._known, new)
        owners = rows_by_rank(comm, np.searchsorted(self._ends, new, side="right"))
        asked = exchanged(comm, {rank: new[rows] for rank, rows in owners.items()})
        answers = {asker: self._reached_of(some) for asker, some in asked.items()}
        for answer in exchanged(comm, answers).values():
            for rank, some in answer.items():
                self._reaches[rank] = np.union1d(self._reaches.get(rank, some), some)

    def _reached_of(self, nodes: GlobalInts) -> dict[int, GlobalInts]:
        """Columns of the rows of other ranks that are among ``nodes``, by rank."""
        found = {rank: np.intersect1d(nodes, some) for rank, some in self._reached.items()}
        return {rank: some for rank, some in found.items() if len(some)}


def _touching(contacts: ContactBlocks, nodes: GlobalInts) -> ContactBlocks:
    """Constraints and blocks whose node lists include any of ``nodes``."""
    flags = (np.isin(some, nodes) for some in (contacts.nodes, contacts.tangent_nodes))
    return contacts.take(*contacts.touching(*flags))


class _GatheredRows:
    """Rows of some nodes and of their neighbours, gathered from all ranks.

    Args:
        rows: Bulk tangent of the owned nodes.
        ends: First number after the rows of each rank.
        nodes: Nodes of contacts, ascending.
        wide: Whether to include neighbours of neighbours.
    """

    def __init__(self, rows: BlockCSR, ends: GlobalInts, nodes: GlobalInts, *, wide: bool) -> None:
        space = rows.index_map
        first, last = space.local_range
        self._contacts, self._is_wide = nodes, wide
        domain = nodes
        for _ in range(2 if wide else 1):
            domain = _unique([domain, rows.neighbours(domain, ends)])
        start, column, value = rows.gather(domain, ends)
        # The subdomain, then the other nodes in the columns of its rows.
        halo = np.setdiff1d(column, domain)
        reached = np.concatenate([domain, halo])
        self._order = np.argsort(reached)
        self._sorted = reached[self._order]
        own = (reached >= first) & (reached < last)
        ghosts = reached[~own]
        owner = np.searchsorted(ends, ghosts, side="right").astype(np.int32)
        self._halo: _Halo | None = None  # None if no rank needs nodes of other ranks
        if reductions.anywhere(space.comm, len(ghosts) > 0):
            index_map = compat.index_map(space.comm, space.size_local, ghosts, owner)
            self._halo = _Halo(index_map, rows.dim)
        places = reached - first
        places[~own] = space.size_local + np.arange(len(ghosts))
        self._factors = _kernels.ContactSchwarz(
            start, self._place(column), value, places.astype(np.int32)
        )

    @property
    def size(self) -> int:
        """Number of nodes of the subdomain."""
        return self._factors.size

    def contain(self, nodes: GlobalInts) -> bool:
        """Whether the rows contain other nodes of contacts."""
        return bool(np.isin(nodes, self._contacts).all())

    def factorise(self, contacts: Sequence[ContactBlocks]) -> None:
        """Factorise the rows of the subdomain, including the stiffness of ``contacts``."""
        self._factors.clear()
        for blocks in contacts:
            self._factors.add(blocks.renumbered(self._place).kernel())
        self._factors.build(wide=self._is_wide)

    def correct(self, r: Floats, z: Floats) -> None:
        """Constrain z and correct it at owned nodes. Collective."""
        none: Floats = np.empty((0, 2 * r.shape[1]))
        self._factors.correct(r, z, none if self._halo is None else self._halo.exchange(r, z))

    def _place(self, nodes: GlobalInts) -> Ints:
        """Positions of nodes in the list of columns."""
        place: Ints = self._order[np.searchsorted(self._sorted, nodes)].astype(np.int32)
        return place


class _Halo:
    """Exchange of two nodal vectors to the ghosts of an index map.

    Args:
        index_map: Index map of the nodes.
        dim: Components of a node.
    """

    def __init__(self, index_map: common.IndexMap, dim: int) -> None:
        self._shared, self._num_owned = compat.shared(index_map), index_map.size_local
        self._vector = la.vector(index_map, 2 * dim)
        self._values: Floats = self._vector.array.reshape(-1, 2 * dim)

    def exchange(self, r: Floats, z: Floats) -> Floats:
        """Values at the ghosts of two vectors at the owned nodes, both ``(n, d)``. Collective."""
        both = [r.take(self._shared, axis=0), z.take(self._shared, axis=0)]
        self._values[self._shared] = np.concatenate(both, axis=1)
        self._vector.scatter_forward()
        return self._values[self._num_owned :]


def _unique(arrays: Sequence[Array]) -> GlobalInts:
    nodes = [np.empty(0, dtype=np.int64), *(array.ravel() for array in arrays)]
    unique: GlobalInts = np.unique(np.concatenate(nodes))
    return unique
