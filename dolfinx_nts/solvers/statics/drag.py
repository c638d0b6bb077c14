"""Viscous resistance in statics: pseudo-transient continuation.

At a limit point or a saddle of the energy there is no equilibrium close by for the next load. The
tangent is indefinite, and no active set is consistent. With a large enough resistance c,

    R(u) + c (u - u_ref) = 0

has a definite tangent and one solution near u_ref. A sequence of these problems, each one starting
from the last solution and with less resistance, decreases the energy in a pseudo-time. It ends at
an equilibrium, which is stable as a rule (C. T. Kelley, D. E. Keyes, SIAM J. Numer. Anal. 35
(1998)).
"""

from collections.abc import Iterator
from contextlib import contextmanager

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.precond.tangent import Tangent

__all__ = ["Drag"]


class Drag:
    """Resistance of the nodes against displacements from a state, proportional to their stiffness.

    Args:
        bulk: Residual of the bodies, whose derivative includes the resistance.
        tangent: Matrix of the derivative, which also includes the resistance.
    """

    def __init__(self, bulk: Bulk, tangent: Tangent) -> None:
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
        """Context in which the resistance acts on residual and tangent. Local.

        Args:
            part: Resistance relative to the stiffness of the nodes [-].
            reference: Displacements of the owned dofs without resistance, ``(d n,)`` [m].
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
        """Force on the owned dofs, 0 where u is prescribed, shape ``(d n,)`` [N]. Local."""
        force: Floats = (self._resistance * (self._nodes - self._reference)).ravel()
        force[self._bulk.is_prescribed] = 0
        return force
