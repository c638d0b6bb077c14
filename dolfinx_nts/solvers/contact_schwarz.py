"""Nodes around the contacts that a rank solves for, and the rows of these nodes.

On one rank the rows are those of the bulk tangent, where they are. On several,
each rank solves for the nodes that it owns with all pairs of these and of their
neighbours, and with the rows of other ranks' nodes there and around. Without
the neighbours' pairs it takes a tenth more iterations where a border between
ranks crosses the contact.

Patch around the contacts: the part of the preconditioner that knows them.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from dolfinx import la

from dolfinx_nts import _kernels, compat
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Array, Flags, Floats, GlobalInts, Ints
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import exchanged
from dolfinx_nts.solvers.block_csr import BlockCSR
from dolfinx_nts.solvers.elimination import ActivePairs, Elimination
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["ContactSchwarz", "OverlappingSubdomain", "SerialSubdomain", "SharedPairs"]


class SharedPairs:
    """Active pairs with global numbers of the nodes.

    Args:
        nodes: The numbers, shape ``(m, 1+k)``.
        arrays: Rank, normal, gradients, columns and tangent, as of
            `ActivePairs`.
    """

    def __init__(self, nodes: GlobalInts, *arrays: Any) -> None:
        """Keep them."""
        self.nodes = nodes
        self.rank, self.normal, self.gradients, self.columns, self.tangent = arrays

    @classmethod
    def of(cls, p: ActivePairs) -> "SharedPairs":
        """Those of this rank."""
        return cls(p.global_dofs(), p.rank, p.normal, p.gradients, p.columns, p.tangent)

    def local(self, dofs: Array) -> _kernels.Elimination:
        """The pairs with other numbers of their nodes."""
        return _kernels.Elimination(dofs.astype(np.int32), *self.arrays[1:])

    @property
    def arrays(self) -> tuple[Any, ...]:
        """What the constructor takes."""
        return self.nodes, self.rank, self.normal, self.gradients, self.columns, self.tangent


class SerialSubdomain:
    """The nodes of the only rank.

    Args:
        rows: Bulk tangent; its values may change.
    """

    def __init__(self, rows: BlockCSR) -> None:
        """Wait for pairs."""
        self._factors = _kernels.ContactSchwarz(rows.start, rows.column, rows.value)

    def build(self, pairs: Sequence[SharedPairs], version: int) -> None:
        """Choose the nodes for some pairs, and factorise.

        Args:
            pairs: The pairs.
            version: Number of the matrix's values, which are read anyway.
        """
        self._factors.clear()
        for p in pairs:
            self._factors.add(p.local(p.nodes))
        self._factors.build()

    def correct(self, r: Floats, z: Floats) -> None:
        """Constrain z and correct it, as `ContactSchwarz.correct`."""
        self._factors.correct(r, z)


class OverlappingSubdomain:
    """Nodes around the pairs of the nodes that a rank owns, and of their neighbours.

    Collective, as all its methods.

    Args:
        rows: Bulk tangent of the owned nodes; its values may change.
    """

    def __init__(self, rows: BlockCSR) -> None:
        """Learn which nodes the rows of other ranks reach."""
        self._rows, space = rows, rows.index_map
        self._ends = np.array(space.comm.allgather(space.local_range[1]))
        # Nodes of this rank that rows of each rank reach.
        reached = rows.matrix.index_map(1).ghosts
        owner = np.searchsorted(self._ends, reached, side="right")
        asked = [reached[owner == rank] for rank in range(space.comm.size)]
        self._reached = exchanged(space.comm, asked)
        self._version = -1
        self._contacts: GlobalInts  # nodes of pairs for which there are rows

    def build(self, pairs: Sequence[SharedPairs], version: int) -> None:
        """Factorise for the pairs of this rank.

        Rows that are here from the last time are used again.

        Args:
            pairs: The pairs.
            version: Number of the matrix's values.
        """
        everywhere = [self._shared(self._at_owners(p)) for p in pairs]
        contacts = _unique([p.nodes for p in everywhere])
        covered = version == self._version and np.isin(contacts, self._contacts).all()
        if not reductions.everywhere(self._rows.index_map.comm, bool(covered)):
            self._version, self._contacts = version, contacts
            self._gather(contacts)
        self._factors.clear()
        for p in everywhere:
            dofs = self._place(p.nodes.ravel()).reshape(p.nodes.shape)
            self._factors.add(p.local(dofs))
        self._exists = self._factors.build()

    def _gather(self, contacts: GlobalInts) -> None:
        """Gather the rows of nodes and their neighbours."""
        rows, space, ends = self._rows, self._rows.index_map, self._ends
        first, last = space.local_range
        domain = _unique([contacts, rows.neighbours(contacts, ends)])
        start, column, value = rows.gather(domain, ends)
        # The domain, then what its rows reach outside.
        halo = np.setdiff1d(column, domain)
        self._num_rows = len(domain)
        self._place = _Places(domain, halo)
        self._factors = _kernels.ContactSchwarz(start, self._place(column), value)

        nodes = np.concatenate([domain, halo])
        own = (nodes >= first) & (nodes < last)
        ghosts = nodes[~own]
        index_map = compat.index_map(
            space.comm,
            space.size_local,
            ghosts,
            np.searchsorted(ends, ghosts, side="right").astype(np.int32),
        )
        self._vector = la.vector(index_map, 6)
        self._position = nodes - first
        self._position[~own] = space.size_local + np.arange(len(ghosts))
        self._inner = np.flatnonzero(own[: self._num_rows])
        # Owned nodes whose values somebody needs.
        self._needed = np.union1d(compat.shared(index_map), self._position[own])

    def _at_owners(self, pairs: SharedPairs) -> SharedPairs:
        """Pairs that nodes of this rank take part in."""
        owner = np.searchsorted(self._ends, pairs.nodes, side="right")
        return self._sent(pairs, [owner == rank for rank in range(len(self._ends))])

    def _shared(self, pairs: SharedPairs) -> SharedPairs:
        """These, and those of the nodes that rows of this rank reach."""
        taking = [np.isin(pairs.nodes, nodes) for nodes in self._reached]
        taking[self._rows.index_map.comm.rank][:] = True
        return self._sent(pairs, taking)

    def _sent(self, pairs: SharedPairs, taking: list[Flags]) -> SharedPairs:
        """What ranks send to this one, each pair once.

        Args:
            pairs: Those of this rank.
            taking: For each rank, nodes for which it gets the pairs,
                shape ``(m, 1+k)``.
        """
        masks = [nodes.any(axis=1) for nodes in taking]
        parts = exchanged(
            self._rows.index_map.comm,
            [tuple(array[mask] for array in pairs.arrays) for mask in masks],
        )
        arrays: Any = [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]
        _, once = np.unique(arrays[0][:, 0], return_index=True)
        return SharedPairs(*(array[once] for array in arrays))

    def correct(self, r: Floats, z: Floats) -> None:
        """Constrain z and correct it, as `ContactSchwarz.correct`."""
        both: Floats = self._vector.array.reshape(-1, 6)
        needed = self._needed
        both[needed, :3], both[needed, 3:] = r[needed], z[needed]
        self._vector.scatter_forward()
        if not self._exists:
            return
        here = both[self._position]
        right = np.ascontiguousarray(here[: self._num_rows, :3])
        values = np.ascontiguousarray(here[:, 3:])
        self._factors.correct(right, values)
        z[self._position[self._inner]] = values[self._inner]


class _Places:
    """Numbers of nodes of the domain and the halo."""

    def __init__(self, domain: GlobalInts, halo: GlobalInts) -> None:
        nodes = np.concatenate([domain, halo])
        self._order = np.argsort(nodes)
        self._sorted = nodes[self._order]

    def __call__(self, nodes: GlobalInts) -> Ints:
        place: Ints = self._order[np.searchsorted(self._sorted, nodes)].astype(np.int32)
        return place


def _unique(arrays: list[Any]) -> GlobalInts:
    nodes = [np.empty(0, dtype=np.int64), *(array.ravel() for array in arrays)]
    unique: GlobalInts = np.unique(np.concatenate(nodes))
    return unique


class ContactSchwarz:
    """Corrects a nodal vector around the contacts, see `cpp/nts/solvers/contact_schwarz.h`.

    Args:
        tangent: Matrix of the bulk.

    Attributes:
        num_builds: Factorisations so far.
    """

    def __init__(self, tangent: Tangent) -> None:
        """Wait for pairs."""
        self._tangent = tangent
        self._version = -1, -1  # of matrix and pairs
        self._domain: SerialSubdomain | OverlappingSubdomain | None = None
        self._pairs: list[SharedPairs] = []
        self.num_builds = 0

    def update(self, elimination: Elimination) -> None:
        """Factorise, unless pairs and matrix are those of the last time. Collective.

        Args:
            elimination: Active pairs.
        """
        version = self._tangent.num_assembled, elimination.active_version
        if version != self._version:
            self._version = version
            self._pairs = [SharedPairs.of(pairs) for pairs in elimination.pairs]
            self._build()

    def serialize(self, archive: Archive, active_version: int) -> None:
        """Serialize what the patch was last made of. Collective.

        Args:
            archive: Takes it or gives it.
            active_version: Number of the last active set.
        """
        version = self._tangent.num_assembled, active_version
        valid = version == self._version
        kept = archive.local("patch", [a for p in self._pairs for a in p.arrays] if valid else None)
        if not archive.giving:
            return
        self._version = -1, -1
        if kept is not None:
            parts = [kept[i : i + 6] for i in range(0, len(kept), 6)]
            self._pairs = [SharedPairs(*part) for part in parts]
            self._version = version
            self._build()

    def _build(self) -> None:
        if self._domain is None:
            rows = self._tangent.rows
            alone = rows.index_map.comm.size == 1
            self._domain = SerialSubdomain(rows) if alone else OverlappingSubdomain(rows)
        self._domain.build(self._pairs, self._version[0])
        self.num_builds += 1

    def correct(self, r: Floats, z: Floats) -> None:
        """Constrain z and add what the patch solves for. Collective.

        Args:
            r: Right-hand side at the owned nodes, shape ``(n, 3)``.
            z: Values at the owned nodes, overwritten.
        """
        assert self._domain is not None
        self._domain.correct(r, z)
