"""Forces of implicit steps, as far as their size says what is exact, at rest or gained."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.bulk import Bulk

__all__ = ["StepForces"]

# Part of the momentum over dt [-] that counts as a force to which the residual is compared: a
# body in free flight has no other force, and its round-off is that of its momentum.
_INERTIA_PART = 1e-3
# Relative change of the loads [-] that is none.
_SAME_LOAD = 1e-9


class StepForces:
    """Norms of the forces at work, now and in the last step. Collective, as are its methods.

    Args:
        bulk: Residual of the bodies and loads.
        mass: Lumped masses of the owned dofs, which are exact enough for this, ``(d n,)`` [kg].

    Attributes:
        internal: Norm of the internal forces of the last step [N].
        load: Norm of its loads [N].
    """

    def __init__(self, bulk: Bulk, mass: Floats) -> None:
        self._bulk, self._mass = bulk, mass
        self._comm: MPI.Comm = bulk.comm
        self.internal = self.load = 0.0

    def forget(self) -> None:
        """Let no loads be those of the last step. Local."""
        self.load = np.inf

    def serialize(self, archive: Archive) -> None:
        """Serialize the norms of the last step."""
        self.internal = archive.same("internal_force", self.internal)
        self.load = archive.same("load_norm", self.load)

    def accept(self, load: float, internal: Floats) -> None:
        """Keep norm of the loads [N] and internal forces of the owned dofs [N] of a step."""
        self.load, self.internal = load, self.norm(internal)

    def loads(self) -> Floats:
        """Forces of all loads on the owned dofs [N]."""
        total: Floats = np.sum([np.zeros_like(self._mass), *self._bulk.loads()], axis=0)
        return total

    def stays(self, load: float) -> bool:
        """Whether loads with some norm [N] are those of the last step. Local."""
        return abs(load - self.load) <= _SAME_LOAD * load

    def scale(self, load: float, v: Floats, dt: float) -> float:
        """Norm of the forces at work, with which the residual is compared [N].

        Args:
            load: Norm of the loads [N].
            v: Velocities of the owned dofs [m/s].
            dt: Length of the step [s].
        """
        return self.internal + load + _INERTIA_PART * self.norm(self._mass * v) / dt

    def kinetic_energy(self, v: Floats) -> float:
        """Kinetic energy of this rank's part by velocities of the owned dofs [J]. Local."""
        return float(self._mass @ v**2) / 2

    def norm(self, values: Floats) -> float:
        """Euclidean norm of values at the owned dofs of all ranks."""
        return float(np.sqrt(reductions.total(self._comm, values @ values)))
