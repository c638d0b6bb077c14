"""Contact corrections of the bulk preconditioner: Schwarz subdomain or dense complement."""

from collections.abc import Sequence
from typing import Protocol

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Flags, Floats, GlobalInts
from dolfinx_nts.solvers.linear.elimination import ActivePairs, Elimination
from dolfinx_nts.solvers.precond.contact_complement import ContactComplement
from dolfinx_nts.solvers.precond.contact_schwarz import ContactSchwarz
from dolfinx_nts.solvers.precond.preconditioner import BulkPreconditioner
from dolfinx_nts.solvers.precond.tangent import Tangent
from dolfinx_nts.solvers.statics.inertia_relief import InertiaRelief

__all__ = ["ContactCorrections"]

# Krylov iterations per decade of the residual [-] above which the Schwarz correction is replaced,
# with ILU(1) or complete factors; and largest number of contact nodes [-] for the dense complement.
_SLOW, _MOST_NODES = 4.0, 100
# Largest number of contact forces in a cone complementarity problem; its cost grows with the cube.
_MOST_FORCES = 300
# Lower bound on the reduction of the residual in a solve, in decades [-], since every solve takes
# at least one iteration.
_FEWEST_DECADES = 0.3
# Weakest reduction of a solve [-]: with the complement it is cheap and saves Newton iterations;
# with the Schwarz correction there is no such bound.
_CHEAP_REDUCTION, _ANY_REDUCTION = 1e-3, 1.0


class _Correction(Protocol):
    """Interface of corrections that extend a bulk preconditioner to the projected tangent."""

    def update(self, elimination: Elimination) -> None: ...

    def correct(self, r: Floats, z: Floats) -> None: ...


class ContactCorrections:
    """Schwarz correction, replaced by the dense complement after slow convergence.

    Collective, as all its methods.

    Args:
        tangent: Matrix of the bulk.
        bulk: Preconditioner of the bulk.

    Attributes:
        least_reduction: Weakest reduction to request of a solve [-].
    """

    def __init__(self, tangent: Tangent, bulk: BulkPreconditioner) -> None:
        self._tangent, self._bulk = tangent, bulk
        self._schwarz, self._complement = ContactSchwarz(tangent), ContactComplement(tangent, bulk)
        self._present: _Correction = self._schwarz
        self._schwarz_is_poor = False
        self.least_reduction = _ANY_REDUCTION

    @property
    def num_builds(self) -> int:
        """Number of factorisations of the contact subdomain so far."""
        return self._schwarz.num_builds

    @property
    def uses_complement(self) -> bool:
        """Whether the dense complement is in use."""
        return self._present is self._complement

    def choose(self, num_active: int) -> bool:
        """Choose a correction for a number of active nodes; return whether it changes. Local."""
        use = self._schwarz_is_poor and self._bulk.has_responses and num_active <= _MOST_NODES
        last, self._present = self._present, self._complement if use else self._schwarz
        self.least_reduction = _CHEAP_REDUCTION if use else _ANY_REDUCTION
        return self._present is not last

    def judge(self, iterations: int, decades: float) -> None:
        """Register the iterations of a solve with contact, for the choice of the correction. Local.

        Args:
            iterations: Krylov iterations.
            decades: Requested reduction in decades [-].
        """
        if not self.uses_complement:
            self._schwarz.judge(iterations, decades)
        slow = iterations > _SLOW * max(decades, _FEWEST_DECADES)
        self._schwarz_is_poor |= slow and self._bulk.has_responses

    def update(self, elimination: Elimination) -> None:
        """Set the contacts of a Newton iteration."""
        self._present.update(elimination)

    def correct(self, r: Floats, z: Floats) -> None:
        """Correct the solution z of the bulk preconditioner for r, nodal vectors ``(n, 3)``."""
        self._present.correct(r, z)

    def condensed(
        self,
        R: Floats,
        pairs: Sequence[ActivePairs],
        is_point: Flags,
        present: Floats,
        *,
        relief: InertiaRelief,
        immobile: GlobalInts,
    ) -> tuple[Floats, Floats] | None:
        """Condense the system to the contact points, see `CondensedSystem`.

        ``relief`` has the motions of free bodies; ``immobile`` is as for `ContactComplement`. The
        result is None for many points, without accurate factors of the bulk, and if free bodies
        have no active contact. It is also None for free bodies with factors of the exact
        derivative, in which contact forces rotate them.
        """
        point, tangent = self._bulk.point, self._tangent
        if point is None or not self._bulk.has_responses or len(present) > _MOST_FORCES:
            return None
        turns = point is not tangent.point or point[0]
        if relief.is_unsupported or (relief.bodies and turns):
            return None
        mobility = relief.mobility(tangent.in_addition, tangent.drag)
        return self._complement.condensed(R, pairs, is_point, present, mobility, immobile)

    def serialize(self, archive: Archive, active_version: int) -> None:
        """Serialize the state that later steps depend on, after the factors of the bulk.

        Args:
            archive: Archive that stores or returns it.
            active_version: Number of the last active set.
        """
        self._schwarz.serialize(archive, active_version)
        self._complement.serialize(archive)
        self._schwarz_is_poor = archive.same("correction_is_poor", self._schwarz_is_poor)
