"""Forces of the present state in explicit steps, which the next step begins with."""

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.archive import Archive
from dolfinx_nts.common.arrays import Floats, GlobalInts
from dolfinx_nts.contact.explicit.all_springs import AllSprings
from dolfinx_nts.integrators.explicit_forms import ExplicitBulk
from dolfinx_nts.parallel import reductions

__all__ = ["PresentForces"]


class PresentForces:
    """Accelerations by the last forces, and what steps need to know of these. Collective.

    Args:
        bulk: Forces on the bodies, to whose total contact is added.
        springs: Contact of all pairs.
        mobility: Inverse of the mass where the displacement of an owned node is free, otherwise 0,
            shape ``(n, d)`` [1/kg].

    Attributes:
        acceleration: Acceleration of the owned nodes, shape ``(n, d)`` [m/s^2].
        power: Sum of force times acceleration on this rank [N m/s^2].
        strain_energy: Strain energy, on all ranks together [J].
        known: Whether the forces belong to the present state.
    """

    def __init__(self, bulk: ExplicitBulk, springs: AllSprings, mobility: Floats) -> None:
        self._bulk, self._springs, self._mobility = bulk, springs, mobility
        self.acceleration: Floats = np.zeros_like(mobility)
        self.power = self.strain_energy = 0.0
        self.known = False

    def begin(self) -> None:
        """Take the last evaluation for a state that was set."""
        total = self._bulk.total
        self._springs.accept()
        np.multiply(self._mobility, total, out=self.acceleration)
        self.power = float(np.vdot(total, self.acceleration))
        comm = self._bulk.rate.function_space.mesh.comm
        self.strain_energy = reductions.total(comm, self._bulk.strain_energy)

    def kick(self, dt: float, rate: Floats) -> float:
        """Take the last evaluation for the end of a step of length dt [s]. Local.

        Completes velocities ``rate``, shape ``(n, d)`` [m/s], where they are free, and returns by
        how much the power has changed on this rank [N m/s^2].
        """
        before, total = self.power, self._bulk.total
        self.power = _kernels.kick(dt, self._mobility, total, self.acceleration, rate)
        return self.power - before

    def serialize(self, archive: Archive, node_ids: GlobalInts, x: Floats) -> None:
        """Serialize the forces, if they are known, so that none are evaluated anew.

        Args:
            archive: The archive.
            node_ids: Numbers of the owned nodes, see `node_numbering`, shape ``(n,)``.
            x: Positions of the local nodes, shape ``(l, 3)`` [m].
        """
        self.known = archive.same("forces_are_known", self.known)
        if not self.known:
            return
        for number, force in enumerate((self.acceleration, *self._bulk.forces)):
            force[:] = archive.nodal(f"force/{number}", node_ids, force)
        # A step sums it in another order, so that a new sum would differ in the last digit.
        self.strain_energy = archive.same("strain_energy", self.strain_energy)
        stored = archive.local("power", None if archive.giving else [np.array(self.power)])
        anew = np.vdot(self._bulk.total, self.acceleration)
        self.power = float(anew if stored is None else stored[0])
        self._springs.serialize(archive, x)
