"""Viscous resistance in a solution without inertia, against the motion away from a state.

An equilibrium that turns back at a limit point, or that is a saddle of the energy, has none near
it for the next load, and a node there is wrong both in contact and out of it: the tangent is
indefinite, and no active set is right. With a resistance c that is large enough

    R(u) + c (u - u_ref) = 0

has a definite tangent, and one solution near u_ref. A sequence of these, each from the last one
and with less resistance, is a way in a pseudo-time down the energy of bodies and loads, which ends
at an equilibrium, as a rule a stable one (pseudo-transient continuation, C. T. Kelley, D. E.
Keyes, SIAM J. Numer. Anal. 35 (1998)).
"""

from collections.abc import Iterator
from contextlib import contextmanager

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.tangent import Tangent

__all__ = ["Drag"]


class Drag:
    """Resistance of the nodes against leaving a state, a part of their stiffness.

    Args:
        bulk: Residual of the bodies, the derivative of which gets the resistance.
        tangent: Matrix of that derivative, which gets it too.
    """

    def __init__(self, bulk: Bulk, tangent: Tangent) -> None:
        """Take the stiffness of the nodes as it is now. Collective."""
        self._bulk, self._tangent = bulk, tangent
        self._dim = bulk.rigid.dim
        self._stiffness: Floats = tangent.nodal_stiffness().copy()[:, None]
        self._resistance: Floats = 0 * self._stiffness
        self._reference = self._nodes.copy()

    @property
    def _nodes(self) -> Floats:
        """Displacements of the owned nodes, a view of shape ``(n, d)`` [m]."""
        u: Floats = self._bulk.u.x.array[: self._bulk.num_owned]
        return u.reshape(-1, self._dim)

    @contextmanager
    def acting(self, part: float, reference: Floats) -> Iterator[None]:
        """Context in which it acts on residual and tangent. Local.

        Args:
            part: Resistance relative to the stiffness of the nodes [-].
            reference: Displacements that are not resisted, of the owned dofs, ``(d n,)`` [m].
        """
        before = self._bulk.stabilisation
        resistance = self._resistance = part * self._stiffness
        self._reference = reference.reshape(-1, self._dim).copy()

        def stabilisation(x: Floats) -> Floats:
            y: Floats = resistance * x
            return y if before is None else y + before(x)

        self._bulk.stabilisation, self._tangent.drag = stabilisation, resistance
        try:
            yield
        finally:
            self._bulk.stabilisation, self._tangent.drag = before, 0.0

    def force(self) -> Floats:
        """Force of the resistance on the owned dofs that are not given, ``(d n,)`` [N]. Local."""
        force: Floats = (self._resistance * (self._nodes - self._reference)).ravel()
        force[self._bulk.given] = 0
        return force
