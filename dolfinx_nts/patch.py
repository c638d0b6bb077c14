"""Patch around the contacts: the part of the preconditioner that knows them.

On one rank the patch reads the rows of the bulk tangent where they are. On
several, each rank solves for the nodes that it owns with all pairs of these and
of their neighbours, and with the rows of other ranks' nodes there and around.
Without the neighbours' pairs it takes a tenth more iterations where a border
between ranks crosses the contact.
"""

from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import la

from dolfinx_nts import _kernels, compat, reductions
from dolfinx_nts.archive import Archive
from dolfinx_nts.block_rows import BlockRows
from dolfinx_nts.elimination import ActivePairs, Elimination

__all__ = ["Patch"]

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]
GlobalInts = npt.NDArray[np.int64]


class Patch:
    """Corrects a nodal vector around the contacts, see `cpp/nts/patch.h`.

    Args:
        rows: Bulk tangent of the owned nodes; its values may change.

    Attributes:
        num_builds: Factorisations so far.
    """

    def __init__(self, rows: BlockRows) -> None:
        """Wait for pairs."""
        self._comm: MPI.Comm = rows.index_map.comm
        self._pairing = b""
        self._version = -1
        self._domain = _Whole(rows) if self._comm.size == 1 else _Overlapping(rows)
        self._exists = False
        self._elimination = Elimination((), ())
        self._pairs: list[_GlobalPairs] = []
        self.num_builds = 0

    def update(self, elimination: Elimination, version: int) -> None:
        """Factorise, unless pairs and matrix are those of the last time. Collective.

        Args:
            elimination: Active pairs.
            version: Number of the matrix's values.
        """
        self._elimination = elimination
        is_new = version != self._version or elimination.pairing != self._pairing
        if not reductions.anywhere(self._comm, is_new):
            return
        self._version, self._pairing = version, elimination.pairing
        self._pairs = [_GlobalPairs.of(pairs) for pairs in elimination.pairs]
        self._build()

    def exchange(self, archive: Archive, version: int) -> None:
        """Exchange what the patch was last made of. Collective.

        Args:
            archive: Takes it or gives it.
            version: Number of the matrix's values.
        """
        valid = version == self._version
        kept = archive.local("patch", [a for p in self._pairs for a in p.arrays] if valid else None)
        if not archive.giving:
            return
        self._version = -1
        if kept is not None:
            parts = [kept[i : i + 6] for i in range(0, len(kept), 6)]
            self._pairs = [_GlobalPairs(*part) for part in parts]
            self._pairing = b"".join(a.tobytes() for part in parts for a in part[:2])
            self._version = version
            self._build()

    def _build(self) -> None:
        self._domain.choose(self._pairs)
        self._exists = self._domain.factors.build()
        self.num_builds += 1

    def correct(self, r: Floats, z: Floats) -> None:
        """Constrain z and add what the patch solves for. Collective.

        Args:
            r: Right-hand side at the owned nodes, shape ``(n, 3)``.
            z: Values at the owned nodes, overwritten.
        """
        if isinstance(self._domain, _Whole):
            self._domain.correct(r, z)
        else:
            self._elimination.constrain(z)
            self._domain.correct(r, z, self._exists)


class _GlobalPairs:
    """Pairs with global numbers of the nodes, otherwise `ActivePairs`."""

    def __init__(self, nodes: GlobalInts, *arrays: Any) -> None:
        self.nodes = nodes
        self.rank, self.normal, self.gradients, self.columns, self.tangent = arrays

    @classmethod
    def of(cls, p: ActivePairs) -> "_GlobalPairs":
        return cls(p.global_dofs(), p.rank, p.normal, p.gradients, p.columns, p.tangent)

    def local(self, dofs: npt.NDArray[Any]) -> _kernels.Elimination:
        """The pairs with other numbers of their nodes."""
        return _kernels.Elimination(dofs.astype(np.int32), *self.arrays[1:])

    @property
    def arrays(self) -> tuple[Any, ...]:
        return self.nodes, self.rank, self.normal, self.gradients, self.columns, self.tangent


class _Whole:
    """The nodes of the only rank."""

    def __init__(self, rows: BlockRows) -> None:
        self.factors = _kernels.Patch(rows.start, rows.column, rows.value)

    def choose(self, pairs: list[_GlobalPairs]) -> None:
        self.factors.clear()
        for p in pairs:
            self.factors.add(p.local(p.nodes))

    def correct(self, r: Floats, z: Floats) -> None:
        self.factors.correct(r, z)


class _Overlapping:
    """Nodes around the pairs of the nodes that a rank owns, and of their neighbours.

    Collective, as all its methods.
    """

    def __init__(self, rows: BlockRows) -> None:
        self._rows, space = rows, rows.index_map
        self._ends = np.array(space.comm.allgather(space.local_range[1]))
        # Nodes of this rank that rows of each rank reach.
        reached = rows.matrix.index_map(1).ghosts
        owner = np.searchsorted(self._ends, reached, side="right")
        asked = [reached[owner == rank] for rank in range(space.comm.size)]
        self._reached = space.comm.alltoall(asked)

    def choose(self, pairs: list[_GlobalPairs]) -> None:
        rows, space, ends = self._rows, self._rows.index_map, self._ends
        first, last = space.local_range
        everywhere = [self._shared(self._at_owners(p)) for p in pairs]
        contacts = _unique([p.nodes for p in everywhere])
        _, ring, _ = rows.gather(contacts, ends)
        domain = _unique([contacts, ring])
        start, column, value = rows.gather(domain, ends)
        # The domain, then what its rows reach outside.
        halo = np.setdiff1d(column, domain)
        self._num_rows = len(domain)
        place = _Places(domain, halo)
        self.factors = _kernels.Patch(start, place(column), value)
        for p in everywhere:
            dofs = place(p.nodes.ravel()).reshape(p.nodes.shape)
            self.factors.add(p.local(dofs))

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

    def _at_owners(self, pairs: _GlobalPairs) -> _GlobalPairs:
        """Pairs that nodes of this rank take part in."""
        owner = np.searchsorted(self._ends, pairs.nodes, side="right")
        return self._sent(pairs, [owner == rank for rank in range(len(self._ends))])

    def _shared(self, pairs: _GlobalPairs) -> _GlobalPairs:
        """These, and those of the nodes that rows of this rank reach."""
        taking = [np.isin(pairs.nodes, nodes) for nodes in self._reached]
        taking[self._rows.index_map.comm.rank][:] = True
        return self._sent(pairs, taking)

    def _sent(self, pairs: _GlobalPairs, taking: list[npt.NDArray[np.bool_]]) -> _GlobalPairs:
        """What ranks send to this one, each pair once.

        Args:
            pairs: Those of this rank.
            taking: For each rank, nodes for which it gets the pairs,
                shape ``(m, 1+k)``.
        """
        masks = [nodes.any(axis=1) for nodes in taking]
        parts = self._rows.index_map.comm.alltoall(
            [tuple(array[mask] for array in pairs.arrays) for mask in masks]
        )
        arrays: Any = [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]
        _, once = np.unique(arrays[0][:, 0], return_index=True)
        return _GlobalPairs(*(array[once] for array in arrays))

    def correct(self, r: Floats, z: Floats, exists: bool) -> None:
        both: Floats = self._vector.array.reshape(-1, 6)
        both[: len(r), :3], both[: len(r), 3:] = r, z
        self._vector.scatter_forward()
        if not exists:
            return
        here = both[self._position]
        right = np.ascontiguousarray(here[: self._num_rows, :3])
        values = np.ascontiguousarray(here[:, 3:])
        self.factors.correct(right, values)
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
