"""Nodes around the contacts that one of several ranks solves for."""

from collections.abc import Sequence

import numpy as np
from dolfinx import la

from dolfinx_nts import _kernels, compat
from dolfinx_nts.common.arrays import Array, Flags, Floats, GlobalInts, Ints
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import exchanged
from dolfinx_nts.solvers.block_csr import BlockCSR
from dolfinx_nts.solvers.contact_blocks import ContactBlocks

__all__ = ["OverlappingSubdomain"]


class OverlappingSubdomain:
    """Nodes around the contacts of a rank's nodes and of their neighbours.

    Each rank gathers the rows of all these nodes, solves, and takes what it
    finds at its own. Without the contacts of the neighbours there are a tenth
    more iterations where a border between ranks crosses the contact.
    Collective, as all its methods.

    Args:
        rows: Bulk tangent of the owned nodes; its values may change.
    """

    def __init__(self, rows: BlockCSR) -> None:
        """Create the lists of nodes that rows of other ranks reach."""
        self._rows, space = rows, rows.index_map
        self._ends = np.array(space.comm.allgather(space.local_range[1]))
        # Nodes of this rank that rows of each rank reach.
        ghosts = rows.matrix.index_map(1).ghosts
        owner = np.searchsorted(self._ends, ghosts, side="right")
        asked = [ghosts[owner == rank] for rank in range(space.comm.size)]
        self._reached = exchanged(space.comm, asked)
        self._reached[space.comm.rank] = np.arange(*space.local_range)
        # Nodes of contacts, ascending, and which ranks' rows reach them: contacts come to few
        # others.
        self._known: GlobalInts = np.empty(0, dtype=np.int64)
        self._reaches: Flags = np.empty((0, space.comm.size), dtype=bool)
        self._version, self._is_wide = -1, False
        self._gathered: _GatheredRows

    @property
    def size(self) -> int:
        """Number of nodes. Local."""
        return self._gathered.size

    def build(self, contacts: Sequence[ContactBlocks], version: int, *, wide: bool = False) -> None:
        """Factorise for the contacts of this rank.

        Rows that were gathered the last time are used again where they are
        those of the matrix and enough.

        Args:
            contacts: Constraints and tangent of each contact pair, in
                global numbers.
            version: Number of the matrix's values.
            wide: Whether there are neighbours of neighbours.
        """
        near = [self._near(blocks) for blocks in contacts]
        nodes = _unique([part for blocks in near for part in (blocks.nodes, blocks.tangent_nodes)])
        same = (version, wide) == (self._version, self._is_wide)
        enough = same and self._gathered.cover(nodes)
        if not reductions.everywhere(self._rows.index_map.comm, enough):
            self._version, self._is_wide = version, wide
            self._gathered = _GatheredRows(self._rows, self._ends, nodes, wide=wide)
        self._gathered.factorise(near)

    def correct(self, r: Floats, z: Floats) -> None:
        """Constrain z and correct it, as `ContactSchwarz.correct`."""
        self._gathered.correct(r, z)

    def _near(self, blocks: ContactBlocks) -> ContactBlocks:
        """Those of all ranks that touch nodes which rows of this rank reach."""
        comm = self._rows.index_map.comm
        self._learn(np.union1d(blocks.nodes, blocks.tangent_nodes))
        flags = (self._of_ranks(some) for some in (blocks.nodes, blocks.tangent_nodes))
        touching = (blocks.touching(*flag) for flag in zip(*flags, strict=True))
        parts = [blocks.take(*some) for some in touching]
        others = (part for rank, part in enumerate(parts) if rank != comm.rank)
        if not reductions.anywhere(comm, any(p.nodes.size + p.tangent.size for p in others)):
            own: ContactBlocks = parts[comm.rank]
            return own
        return ContactBlocks.concatenated(exchanged(comm, parts))

    def _learn(self, nodes: GlobalInts) -> None:
        """Ask the owners of nodes that are new which ranks reach them."""
        comm = self._rows.index_map.comm
        new = np.setdiff1d(nodes, self._known, assume_unique=True)
        if not reductions.anywhere(comm, len(new) > 0):
            return
        asked = exchanged(comm, np.split(new, np.searchsorted(new, self._ends[:-1])))
        answers = [np.column_stack([np.isin(some, r) for r in self._reached]) for some in asked]
        known = np.concatenate([self._known, new])
        reaches = np.concatenate([self._reaches, *exchanged(comm, answers)])
        order = np.argsort(known)
        self._known, self._reaches = known[order], reaches[order]

    def _of_ranks(self, nodes: GlobalInts) -> Flags:
        """Whether rows of each rank reach nodes that are known, shape ``(ranks, ...)``."""
        return np.moveaxis(self._reaches[np.searchsorted(self._known, nodes)], -1, 0)


class _GatheredRows:
    """Rows of some nodes, of their neighbours and maybe of theirs, wherever they are from.

    Args:
        rows: Bulk tangent of the owned nodes.
        ends: First number after those of each rank.
        nodes: Nodes of contacts, ascending.
        wide: Whether there are neighbours of neighbours.
    """

    def __init__(self, rows: BlockCSR, ends: GlobalInts, nodes: GlobalInts, *, wide: bool) -> None:
        space = rows.index_map
        first, last = space.local_range
        self._contacts, self._is_wide = nodes, wide
        domain = nodes
        for _ in range(2 if wide else 1):
            domain = _unique([domain, rows.neighbours(domain, ends)])
        start, column, value = rows.gather(domain, ends)
        # The domain, then what its rows reach outside.
        halo = np.setdiff1d(column, domain)
        reached = np.concatenate([domain, halo])
        self._order = np.argsort(reached)
        self._sorted = reached[self._order]
        own = (reached >= first) & (reached < last)
        ghosts = reached[~own]
        owner = np.searchsorted(ends, ghosts, side="right").astype(np.int32)
        index_map = compat.index_map(space.comm, space.size_local, ghosts, owner)
        self._is_local = not reductions.anywhere(space.comm, len(ghosts) > 0)
        # It carries rows of r and z beside each other.
        self._vector = la.vector(index_map, 2 * rows.dim)
        self._values: Floats = self._vector.array.reshape(-1, 2 * rows.dim)
        self._shared, self._num_owned = compat.shared(index_map), space.size_local
        places = reached - first
        places[~own] = space.size_local + np.arange(len(ghosts))
        self._factors = _kernels.ContactSchwarz(
            start, self._place(column), value, places.astype(np.int32)
        )

    @property
    def size(self) -> int:
        """Number of nodes whose rows are solved for."""
        return self._factors.size

    def cover(self, nodes: GlobalInts) -> bool:
        """Whether these rows are enough for other nodes of contacts."""
        return bool(np.isin(nodes, self._contacts).all())

    def factorise(self, contacts: Sequence[ContactBlocks]) -> None:
        """Factorise the rows with some contacts."""
        self._factors.clear()
        for blocks in contacts:
            self._factors.add(blocks.renumbered(self._place).kernel())
        self._factors.build(wide=self._is_wide)

    def correct(self, r: Floats, z: Floats) -> None:
        """Constrain z and correct it at owned nodes. Collective."""
        shared, values = self._shared, self._values
        if not self._is_local:
            both = [r.take(shared, axis=0), z.take(shared, axis=0)]
            values[shared] = np.concatenate(both, axis=1)
            self._vector.scatter_forward()
        self._factors.correct(r, z, values[self._num_owned :])

    def _place(self, nodes: GlobalInts) -> Ints:
        """Positions of nodes among those that rows reach."""
        place: Ints = self._order[np.searchsorted(self._sorted, nodes)].astype(np.int32)
        return place


def _unique(arrays: Sequence[Array]) -> GlobalInts:
    nodes = [np.empty(0, dtype=np.int64), *(array.ravel() for array in arrays)]
    unique: GlobalInts = np.unique(np.concatenate(nodes))
    return unique
