"""How the preconditioner of the bulk is corrected for contact: nearby, or wherever it is felt."""

from collections.abc import Sequence
from typing import Protocol

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.solvers.contact_complement import ContactComplement
from dolfinx_nts.solvers.contact_schwarz import ContactSchwarz
from dolfinx_nts.solvers.elimination import ActivePairs, Elimination
from dolfinx_nts.solvers.inertia_relief import InertiaRelief
from dolfinx_nts.solvers.preconditioner import BulkPreconditioner
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["ContactCorrections"]

# Iterations per decade, with factors of the bulk that know responses, from which on a correction
# around the contacts is poor; and nodes in contact up to which the dense complement is cheaper.
_POOR, _MOST_NODES = 4.0, 100
# Forces at points up to which it costs little to decide on all of them.
_MOST_FORCES = 300
# Decades that count at least, as a solve that asks for less takes an iteration, too.
_FEWEST_DECADES = 0.3
# Reduction that the complement gives at little cost, and that saves iterations of Newton's
# method [-]; around the contacts none is too small to ask for.
_CHEAP_REDUCTION, _ANY_REDUCTION = 1e-3, 1.0


class _Correction(Protocol):
    """Makes of a preconditioner of the bulk one of the projected tangent."""

    def update(self, elimination: Elimination) -> None: ...

    def correct(self, r: Floats, z: Floats) -> None: ...


class ContactCorrections:
    """A correction around the contacts, and the complement where it has been found to be poor.

    Collective, as all its methods.

    Args:
        tangent: Matrix of the bulk.
        bulk: Preconditioner of the bulk.

    Attributes:
        least_reduction: Reduction that every solve should be asked for [-].
    """

    def __init__(self, tangent: Tangent, bulk: BulkPreconditioner) -> None:
        """Create both, of which the first is the present one."""
        self._tangent, self._bulk = tangent, bulk
        self._schwarz, self._complement = ContactSchwarz(tangent), ContactComplement(tangent, bulk)
        self._present: _Correction = self._schwarz
        self._schwarz_is_poor = False
        self.least_reduction = _ANY_REDUCTION

    @property
    def num_builds(self) -> int:
        """Factorisations around the contacts so far."""
        return self._schwarz.num_builds

    @property
    def uses_complement(self) -> bool:
        """Whether the complement is the present one."""
        return self._present is self._complement

    def choose(self, num_active: int) -> bool:
        """Choose for a number of active nodes; returns whether this is another one. Local."""
        use = self._schwarz_is_poor and self._bulk.has_responses and num_active <= _MOST_NODES
        last, self._present = self._present, self._complement if use else self._schwarz
        self.least_reduction = _CHEAP_REDUCTION if use else _ANY_REDUCTION
        return self._present is not last

    def judge(self, iterations: int, decades: float) -> None:
        """Learn from a solve with contact. Local.

        Args:
            iterations: Krylov iterations.
            decades: Reduction that was asked for.
        """
        if not self.uses_complement:
            self._schwarz.judge(iterations, decades)
        slow = iterations > _POOR * max(decades, _FEWEST_DECADES)
        self._schwarz_is_poor |= slow and self._bulk.has_responses

    def update(self, elimination: Elimination) -> None:
        """Take the contacts of a Newton iteration."""
        self._present.update(elimination)

    def correct(self, r: Floats, z: Floats) -> None:
        """Correct the result z of the bulk for r, nodal vectors of shape ``(n, 3)``."""
        self._present.correct(r, z)

    def condensed(
        self,
        R: Floats,
        pairs: Sequence[ActivePairs],
        is_point: Flags,
        present: Floats,
        *,
        relief: InertiaRelief,
    ) -> tuple[Floats, Floats] | None:
        """How forces at points move them, see `CondensedSystem`.

        ``relief`` knows how free bodies move. None where points are many, without good factors of
        the bulk, where nothing presses on free bodies, and where these turn under the forces that
        press on them, as they do in factors of the derivative.
        """
        point, tangent = self._bulk.point, self._tangent
        if point is None or not self._bulk.has_responses or len(present) > _MOST_FORCES:
            return None
        turns = point is not tangent.point or point[0]
        if relief.is_loose or (relief.bodies and turns):
            return None
        mobility = relief.mobility(tangent.in_addition, tangent.drag)
        return self._complement.condensed(R, pairs, is_point, present, mobility)

    def serialize(self, archive: Archive, active_version: int) -> None:
        """Serialize what a later step goes on with, after the factors of the bulk.

        Args:
            archive: Takes it or gives it.
            active_version: Number of the last active set.
        """
        self._schwarz.serialize(archive, active_version)
        self._complement.serialize(archive)
        self._schwarz_is_poor = archive.same("correction_is_poor", self._schwarz_is_poor)
