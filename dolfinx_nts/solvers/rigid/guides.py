"""Guides of rigid bodies in a step: prescribed motions and reactions."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import in_space, moments, resultants
from dolfinx_nts.model.reaction import Reaction, total_reactions
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.rigid.linear_fields import LinearFields, combined, nearest, rigid_motions

__all__ = ["Guides"]


class Guides:
    """Guides of the rigid bodies of a stepper; an unguided body has a guide without constraints.

    Args:
        comm: Communicator.
        bodies: Linear fields over each rigid body.

    Attributes:
        prescribed: Prescribed displacement of the guided point and Cayley vector of the rotation,
            for each of ``b`` bodies, shape ``(b, 6)``, in the plane ``(b, 3)``.
    """

    def __init__(self, comm: MPI.Comm, bodies: Sequence[LinearFields]) -> None:
        self._comm, self._bodies = comm, tuple(bodies)
        self.prescribed: Floats = np.array([np.zeros(body.free.shape[1]) for body in bodies])

    def prescribe(self, t_n: float, t: float) -> None:
        """Set the prescribed motions from t_n to t [s]. Local.

        Raises:
            TypeError, ValueError: The motion of a guide is invalid, see `Motion`.
        """
        self.prescribed = np.array([body.prescribed(t_n, t) for body in self._bodies])

    def remaining(self, part: float) -> Floats:
        """Displacements [m] and rotation vectors [rad] remaining after part of the step. Local."""
        return (1 - part) * self._with_halves(self.prescribed, np.arctan)

    def motion_between(self, first: float, last: float) -> Floats:
        """`prescribed` between two fractions of the step, from 0 to 1 [-]. Local.

        Rotation vectors about a fixed axis can be added, Cayley vectors cannot.
        """
        if last - first == 1.0 or not self.are_moving:
            return self.prescribed
        return self._with_halves((last - first) * self.remaining(0.0), np.tan)

    def _with_halves(self, amplitudes: Floats, function: np.ufunc) -> Floats:
        """Convert between rotation and Cayley vectors by a function of half of their length."""
        dim = len(self._bodies[0].point)
        half = np.linalg.norm(amplitudes[:, dim:], axis=1, keepdims=True) / 2
        factor = np.where(half > 0, function(half) / np.where(half > 0, half, 1.0), 1.0)
        return np.hstack([amplitudes[:, :dim], factor * amplitudes[:, dim:]])

    @property
    def are_moving(self) -> bool:
        """Whether any guide moves its body in the step. Local."""
        return bool(self.prescribed.any())

    def by_name(self) -> list[tuple[str, Floats]]:
        """Names of the bodies, each with its row of `prescribed`. Local."""
        names = (body.body.name for body in self._bodies)
        return list(zip(names, self.prescribed, strict=True))

    def turns(self) -> list[tuple[str, float]]:
        """Names of the bodies, each with the angle of its prescribed rotation [rad]. Local."""
        turns = []
        for i, body in enumerate(self._bodies):
            half = np.arctan(np.linalg.norm(self.prescribed[i, len(body.point) :]) / 2)
            turns.append((body.body.name, 2 * float(half)))
        return turns

    def constrained(self, x: Floats) -> Floats:
        """Components of rigid displacements of the bodies that the guides constrain.

        Collective. Displacements of the owned nodes have the shape ``(n, d)`` [m].
        """
        part = np.zeros_like(x)
        for body in self._bodies:
            sums: Floats = reductions.total(self._comm, body.values.T @ x[body.nodes])
            motions = rigid_motions(body.reference)
            amplitudes = nearest(motions, body.products, sums)
            amplitudes = amplitudes - body.free.T @ (body.free @ amplitudes)
            part[body.nodes] = body.values @ combined(amplitudes, motions)
        return part

    def reactions(self, force: Floats, x: Floats, du: Floats, mean: Floats) -> tuple[Reaction, ...]:
        """Forces of the guides in a step, see `Supports.reactions`. Collective.

        Args:
            force: Unbalanced nodal forces, shape ``(n, d)`` [N].
            x: Positions of the local nodes at which the forces act, shape ``(l, 3)`` [m].
            du: Displacements of the owned nodes in the step, shape ``(n, d)`` [m].
            mean: Forces that do the work, shape ``(n, d)`` [N].

        Returns:
            The reaction of each guide, in the order of the bodies.
        """
        guided = [body.nodes for body in self._bodies if body.body.guide is not None]
        if not guided:
            return ()
        V, vectors = self._bodies[0].body.V, in_space(force)
        turning = moments(np.asarray(np.cross(x[: len(du)], vectors), dtype=np.float64), V)
        resultant = resultants(vectors, V)
        parts = np.column_stack([resultant, turning, (mean * du).sum(axis=1)])
        sums = np.array([parts[nodes].sum(axis=0) for nodes in guided])
        return total_reactions(self._comm, sums, resultant.shape[1])
