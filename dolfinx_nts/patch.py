"""Patch around the contacts: the part of the preconditioner that knows them."""

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_nts.block_rows import BlockRows
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.elimination import Elimination
from dolfinx_nts.parallel import reductions
from dolfinx_nts.patch_domain import GlobalPairs, OverlappingDomain, WholeDomain

__all__ = ["Patch"]

Floats = npt.NDArray[np.float64]


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
        self._domain = (WholeDomain if self._comm.size == 1 else OverlappingDomain)(rows)
        self._pairs: list[GlobalPairs] = []
        self.num_builds = 0

    def update(self, elimination: Elimination, version: int) -> None:
        """Factorise, unless pairs and matrix are those of the last time. Collective.

        Args:
            elimination: Active pairs.
            version: Number of the matrix's values.
        """
        is_new = version != self._version or elimination.pairing != self._pairing
        if not reductions.anywhere(self._comm, is_new):
            return
        self._version, self._pairing = version, elimination.pairing
        self._pairs = [GlobalPairs.of(pairs) for pairs in elimination.pairs]
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
            self._pairs = [GlobalPairs(*part) for part in parts]
            self._pairing = b"".join(a.tobytes() for part in parts for a in part[:2])
            self._version = version
            self._build()

    def _build(self) -> None:
        self._domain.build(self._pairs, self._version)
        self.num_builds += 1

    def correct(self, r: Floats, z: Floats) -> None:
        """Constrain z and add what the patch solves for. Collective.

        Args:
            r: Right-hand side at the owned nodes, shape ``(n, 3)``.
            z: Values at the owned nodes, overwritten.
        """
        self._domain.correct(r, z)
