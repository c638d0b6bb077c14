"""Correction around the contacts: the part of the preconditioner that knows them."""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.block_csr import BlockCSR
from dolfinx_nts.solvers.contact_blocks import ContactBlocks, slopes_at_nodes
from dolfinx_nts.solvers.elimination import Elimination
from dolfinx_nts.solvers.overlapping_subdomain import OverlappingSubdomain
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["ContactSchwarz", "SerialSubdomain"]

_NOTHING = -1, -1  # no numbers of matrix and active set
# Change of the contact tangent that makes factors useless, in stiffnesses of the softest node
# [-]: nodes that begin to slip, or turn, have tangents far above it.
_LARGEST_CHANGE = 0.1


class SerialSubdomain:
    """Nodes around the contacts of the only rank.

    Args:
        rows: Bulk tangent; its values may change.
    """

    def __init__(self, rows: BlockCSR) -> None:
        """Create factors that read the rows in place."""
        self._factors = _kernels.ContactSchwarz(rows.start, rows.column, rows.value)

    def build(self, contacts: Sequence[ContactBlocks], version: int) -> None:
        """Choose the nodes for some contacts, and factorise.

        Args:
            contacts: Constraints and tangent of each contact pair.
            version: Number of the matrix's values, which are read anyway.
        """
        self._factors.clear()
        for blocks in contacts:
            self._factors.add(blocks.kernel())
        self._factors.build()

    def correct(self, r: Floats, z: Floats) -> None:
        """Constrain z and correct it, as `ContactSchwarz.correct`."""
        self._factors.correct(r, z)


class ContactSchwarz:
    """Corrects a nodal vector around the contacts, see `cpp/nts/solvers/contact_schwarz.h`.

    Args:
        tangent: Matrix of the bulk.

    Attributes:
        num_builds: Factorisations so far.
    """

    def __init__(self, tangent: Tangent) -> None:
        """Create the object, without factors before `update`."""
        self._tangent = tangent
        self._contacts: list[ContactBlocks] = []
        self._version = _NOTHING  # of the matrix and of the active set
        self._domain: SerialSubdomain | OverlappingSubdomain | None = None
        self.num_builds = 0

    def update(self, elimination: Elimination) -> None:
        """Factorise, unless contacts and matrix are nearly those of the last time. Collective.

        Args:
            elimination: Active pairs.
        """
        version = self._tangent.num_assembled, elimination.active_version
        if version != self._version or self._has_changed(elimination):
            self._version = version
            self._contacts = [pairs.global_blocks() for pairs in elimination.pairs]
            self._build()

    def serialize(self, archive: Archive, active_version: int) -> None:
        """Serialize what was last factorised. Collective.

        Args:
            archive: Takes it or gives it.
            active_version: Number of the last active set.
        """
        version = self._tangent.num_assembled, active_version
        arrays = [array for blocks in self._contacts for array in blocks]
        known = archive.local("schwarz", arrays if version == self._version else None)
        if not archive.giving:
            return
        self._version = _NOTHING
        if known is not None:
            width = len(ContactBlocks.__annotations__)
            parts = (known[i : i + width] for i in range(0, len(known), width))
            self._contacts = [ContactBlocks(*part) for part in parts]
            self._version = version
            self._build()

    def correct(self, r: Floats, z: Floats) -> None:
        """Constrain z and correct it around the contacts. Collective.

        Args:
            r: Right-hand side at the owned nodes, shape ``(n, 3)``.
            z: Values at the owned nodes, overwritten.
        """
        assert self._domain is not None
        self._domain.correct(r, z)

    def _has_changed(self, elimination: Elimination) -> bool:
        """Whether the tangent of the same contacts is another one. Collective."""
        changes = [
            np.abs(now - then).max(initial=0.0)
            for pairs, known in zip(elimination.pairs, self._contacts, strict=True)
            for now, then in (
                (pairs.blocks.tangent, known.tangent),
                (slopes_at_nodes(pairs.blocks), slopes_at_nodes(known)),
            )
        ]
        comm, stiffness = self._tangent.comm, self._tangent.nodal_stiffness()
        softest = reductions.least(comm, float(stiffness.min(initial=np.inf)))
        return bool(reductions.anywhere(comm, max(changes) > _LARGEST_CHANGE * softest))

    def _build(self) -> None:
        if self._domain is None:
            rows = self._tangent.rows
            alone = rows.index_map.comm.size == 1
            self._domain = SerialSubdomain(rows) if alone else OverlappingSubdomain(rows)
        self._domain.build(self._contacts, self._version[0])
        self.num_builds += 1
