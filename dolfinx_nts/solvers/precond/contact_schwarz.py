"""Schwarz correction of the bulk preconditioner on a subdomain around the contacts."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, Ints, same_numbers
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.linear.block_csr import BlockCSR
from dolfinx_nts.solvers.linear.contact_blocks import ContactBlocks, slopes_at_nodes
from dolfinx_nts.solvers.linear.elimination import Elimination
from dolfinx_nts.solvers.precond.overlapping_subdomain import OverlappingSubdomain
from dolfinx_nts.solvers.precond.tangent import Tangent

__all__ = ["ContactSchwarz", "SerialSubdomain", "SubdomainWidth"]

_NOTHING = -1, -1  # matches no matrix and no active set
# Change of the contact tangent above which the subdomain is factorised again, relative to the
# stiffness of the softest node [-]. Slip and rotation change tangents by far more.
_LARGEST_CHANGE = 0.1
# Largest fraction of the constraints that have changed since the factorisation [-], and change of a
# gradient above which a constraint has changed [-]. Larger: too many iterations on sliding
# surfaces; smaller: one node on a new segment causes a factorisation.
_MOST_MOVED, _OTHER_GRADIENT = 0.25, 0.25
# Size of tangent blocks and slopes, relative to the stiffness of the softest node, and of gradients
# [-] below which they are left out of the subdomain: mortar contact has many small ones.
_NEGLIGIBLE = 0.01

# Cost of factors of a narrow and of a wide subdomain with all nodes, in Krylov iterations. The wide
# one has fill-in.
_FACTORS, _WIDE_FACTORS = 14.0, 26.0
# Decades of reduction over which costs are measured: about one step, and two steps in the trial,
# which includes the first factorisation.
_DECADES, _TRIAL_DECADES = 12.0, 24.0
# Iterations per decade of the residual above which the wide subdomain is tried, and largest cost
# ratio for which it is kept.
_SLOW, _CHEAPER = 2.0, 0.9
# Lower bound on the reduction of the residual in a solve, in decades [-], since every solve takes
# at least one iteration.
_FEWEST_DECADES = 0.3


@dataclass
class SubdomainWidth:
    """Choice of a narrow or a wide subdomain by the cost of iterations and factors. Local.

    The narrow one is used first. If it takes many iterations, as in the bending of thin walls, the
    wide one is tried once, and kept if it is cheaper.

    Attributes:
        is_wide: Whether the subdomain is wide.
        iterations: Krylov iterations since the last choice.
        factors: Cost of factors since the last choice, in Krylov iterations.
        decades: Decades of reduction since the last choice.
        narrow: Cost per decade of the narrow subdomain, NaN before the trial.
        is_final: Whether the trial is over.
    """

    is_wide: bool = False
    iterations: float = 0.0
    factors: float = 0.0
    decades: float = 0.0
    narrow: float = np.nan
    is_final: bool = False

    def count_factors(self, part: float) -> None:
        """Add the cost of factors of a subdomain that has a fraction ``part`` of all nodes."""
        self.factors += part * (_WIDE_FACTORS if self.is_wide else _FACTORS)

    def count(self, iterations: int, decades: float) -> bool:
        """Add the iterations of a solve with contact; return whether the width changes."""
        self.iterations += iterations
        self.decades += max(decades, _FEWEST_DECADES)
        if self.is_final or self.decades < (_TRIAL_DECADES if self.is_wide else _DECADES):
            return False
        was_wide, is_slow = self.is_wide, self.iterations > _SLOW * self.decades
        cost = (self.iterations + self.factors) / self.decades
        self.iterations = self.factors = self.decades = 0.0
        if was_wide:
            self.is_wide, self.is_final = cost < _CHEAPER * self.narrow, True
        elif is_slow:
            self.is_wide, self.narrow = True, cost
        return self.is_wide != was_wide

    def serialize(self, archive: Archive) -> None:
        """Serialize the state that later solves depend on. Collective."""
        state = archive.same("width_of_subdomain", np.array(astuple(self), dtype=float))
        if archive.restores:
            is_wide, *costs, is_final = map(float, state)
            self.is_wide, self.is_final = bool(is_wide), bool(is_final)
            self.iterations, self.factors, self.decades, self.narrow = costs


class SerialSubdomain:
    """Subdomain around the contacts on a single rank.

    Args:
        rows: Bulk tangent; its values may change.
    """

    def __init__(self, rows: BlockCSR) -> None:
        self._rows, self._version = rows, -1
        self._factors: _kernels.ContactSchwarz

    @property
    def size(self) -> int:
        """Number of nodes."""
        return self._factors.size

    def build(self, contacts: Sequence[ContactBlocks], version: int, *, wide: bool = False) -> None:
        """Choose the nodes of the subdomain for some contacts, and factorise.

        Args:
            contacts: Constraints and tangent of each contact pair.
            version: Version of the values of the matrix, of which the subdomain caches rows.
            wide: Whether to include neighbours of neighbours.
        """
        if version != self._version:
            rows, self._version = self._rows, version
            own_places: Ints = np.empty(0, dtype=np.int32)
            self._factors = _kernels.ContactSchwarz(rows.start, rows.column, rows.value, own_places)
        self._factors.clear()
        for blocks in contacts:
            self._factors.add(blocks.kernel())
        self._factors.build(wide=wide)

    def correct(self, r: Floats, z: Floats) -> None:
        """Constrain z and correct it for the right-hand side r."""
        self._factors.correct(r, z, np.empty((0, 2 * z.shape[1])))


class ContactSchwarz:
    """Schwarz correction around active contacts, see `cpp/nts/solvers/contact_schwarz.h`.

    Args:
        tangent: Matrix of the bulk.

    Attributes:
        num_builds: Number of factorisations so far.
    """

    def __init__(self, tangent: Tangent) -> None:
        self._tangent = tangent
        self._contacts: list[ContactBlocks] = []
        # Slopes of the factorised contacts, and stiffness of the softest node [N/m], for comparison
        # in each Newton iteration.
        self._slopes: list[Floats] = []
        self._softest = np.inf
        self._version = _NOTHING  # numbers of the matrix and of the active set
        self._domain: SerialSubdomain | OverlappingSubdomain | None = None
        self._width = SubdomainWidth()
        self.num_builds = 0

    def update(self, elimination: Elimination) -> None:
        """Factorise the subdomain, unless contacts and matrix have hardly changed. Collective.

        Args:
            elimination: Active pairs.
        """
        version = self._tangent.num_assembled, elimination.active_version
        now = [pairs.global_blocks() for pairs in elimination.pairs]
        if version[0] != self._version[0] or self._has_changed(now):
            self._contacts = now
            self._build(version[0])
            self._width.count_factors(self._largest_fraction())
        self._version = version

    def judge(self, iterations: int, decades: float) -> None:
        """Choose the width of the subdomain from the iterations of a solve. Local.

        Args:
            iterations: Krylov iterations.
            decades: Required reduction of the residual, in decades.
        """
        if self._width.count(iterations, decades):
            self._version = _NOTHING

    def serialize(self, archive: Archive, active_version: int) -> None:
        """Serialize the contacts of the last factorisation. Collective.

        Args:
            archive: Archive that stores or returns them.
            active_version: Number of the last active set.
        """
        version = self._tangent.num_assembled, active_version
        self._width.serialize(archive)
        arrays = [array for blocks in self._contacts for array in blocks]
        known = archive.local("schwarz", arrays if version == self._version else None)
        if not archive.restores:
            return
        self._version = _NOTHING
        if known is not None:
            width = len(ContactBlocks.__annotations__)
            parts = (known[i : i + width] for i in range(0, len(known), width))
            self._contacts = [ContactBlocks(*part) for part in parts]
            self._version = version
            self._build(version[0])

    def correct(self, r: Floats, z: Floats) -> None:
        """Constrain z and correct it around the contacts. Collective.

        Args:
            r: Right-hand side at the owned nodes, shape ``(n, 3)``.
            z: Values at the owned nodes, overwritten.
        """
        assert self._domain is not None
        self._domain.correct(r, z)

    def _has_changed(self, now: Sequence[ContactBlocks]) -> bool:
        """Whether constrained nodes or contact tangent have changed too much. Collective."""
        then, least = self._contacts, _LARGEST_CHANGE * self._softest
        has_changed = len(now) != len(then) or any(
            not _same_nodes(new, old)
            or _change(new, old, slopes) > least
            or _moved(new, old) > _MOST_MOVED
            for new, old, slopes in zip(now, then, self._slopes, strict=True)
        )
        return reductions.anywhere(self._tangent.comm, has_changed)

    def _build(self, version: int) -> None:
        if self._domain is None:
            rows = self._tangent.rows
            alone = rows.index_map.comm.size == 1
            self._domain = SerialSubdomain(rows) if alone else OverlappingSubdomain(rows)
        softest = float(self._tangent.nodal_stiffness().min(initial=np.inf))
        self._softest = reductions.least(self._tangent.comm, softest)
        self._slopes = [slopes_at_nodes(blocks) for blocks in self._contacts]
        least = _NEGLIGIBLE * self._softest
        contacts = [_essential(blocks, least) for blocks in self._contacts]
        self._domain.build(contacts, version, wide=self._width.is_wide)
        self.num_builds += 1

    def _largest_fraction(self) -> float:
        """Largest fraction on any rank of nodes in the subdomain [-]. Collective."""
        assert self._domain is not None
        part = self._domain.size / max(self._tangent.rows.index_map.size_local, 1)
        return float(reductions.largest(self._tangent.comm, part))


def _essential(contacts: ContactBlocks, least: float) -> ContactBlocks:
    """Drop small tangent blocks, slopes and gradients. Local.

    ``least`` is the smallest entry of the tangent that is kept [N/m].
    """
    is_large = _kernels.large_blocks(contacts.tangent, least)
    rows = contacts.gradients, contacts.columns
    lists = contacts.start, contacts.rank, *rows, contacts.slopes
    keeps = _kernels.essential_nodes(*lists, _NEGLIGIBLE, least)
    components = contacts.normal.shape[1]
    start, gradients, columns = _kernels.at_nodes(contacts.start, keeps, *rows, components)
    return contacts._replace(
        start=start,
        nodes=contacts.nodes[keeps],
        gradients=gradients,
        columns=columns,
        tangent_nodes=contacts.tangent_nodes[is_large],
        tangent=contacts.tangent[is_large],
    )


def _same_nodes(now: ContactBlocks, then: ContactBlocks) -> bool:
    """Whether the same nodes have the same numbers of constraints. Local."""
    own, before = (blocks.nodes[blocks.start[:-1]] for blocks in (now, then))
    return same_numbers(own, before) and same_numbers(now.rank, then.rank)


def _moved(now: ContactBlocks, then: ContactBlocks) -> float:
    """Fraction of the constraints whose gradients have changed [-]. Local."""
    m = len(now.rank)
    if not m:
        return 0.0
    if len(now.nodes) != len(then.nodes):
        return 1.0
    same = now.nodes == then.nodes
    return _kernels.num_moved(m, same, now.gradients, then.gradients, _OTHER_GRADIENT) / m


def _change(now: ContactBlocks, then: ContactBlocks, slopes_then: Floats) -> float:
    """Largest change of an entry of the tangent; its largest entry if nodes differ [N/m].

    ``slopes_then`` is `slopes_at_nodes` of ``then``.
    """
    slopes = _kernels.largest_difference(slopes_at_nodes(now), slopes_then)
    if same_numbers(now.tangent_nodes, then.tangent_nodes):
        return max(slopes, _kernels.largest_difference(now.tangent, then.tangent))
    return max(slopes, *(_kernels.largest_size(part.tangent) for part in (now, then)))
