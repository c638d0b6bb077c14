"""Guides of rigid bodies in a step: how they lead the bodies, and what they take."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import in_space, moments, resultants
from dolfinx_nts.model.reaction import Reaction, total_reactions
from dolfinx_nts.parallel import reductions
from dolfinx_nts.solvers.linear_fields import LinearFields, combined, nearest, rigid_motions

__all__ = ["Guides"]


class Guides:
    """Guides of the rigid bodies of a stepper; a free body has one that leaves all free.

    Args:
        comm: Communicator.
        bodies: Linear fields over each rigid body.

    Attributes:
        prescribed: Displacement of the guided point and Cayley vector of the rotation, for each of
            ``b`` bodies in the step, shape ``(b, 6)``, in the plane ``(b, 3)``.
    """

    def __init__(self, comm: MPI.Comm, bodies: Sequence[LinearFields]) -> None:
        """Keep the bodies, which no step leads as yet."""
        self._comm, self._bodies = comm, tuple(bodies)
        self.prescribed: Floats = np.array([np.zeros(body.free.shape[1]) for body in bodies])

    def prescribe(self, t_n: float, t: float) -> None:
        """Lead the bodies from t_n to t [s] in the next step. Local.

        Raises:
            TypeError, ValueError: The motion of a guide is none, see `Motion`.
        """
        self.prescribed = np.array([body.prescribed(t_n, t) for body in self._bodies])

    def remaining(self, part: float) -> Floats:
        """Displacements [m] and rotation vectors [rad] of the way after a part of it. Local."""
        return (1 - part) * self._with_halves(self.prescribed, np.arctan)

    def motion_between(self, first: float, last: float) -> Floats:
        """The same as `prescribed` between two parts of the way, from 0 to 1 [-]. Local.

        Bodies turn about axes that stay, by angles that add up, as Cayley vectors do not.
        """
        if last - first == 1.0 or not self.are_moving:
            return self.prescribed
        return self._with_halves((last - first) * self.remaining(0.0), np.tan)

    def _with_halves(self, amounts: Floats, function: np.ufunc) -> Floats:
        """Amounts with a function of half of the length of each turn in the place of it. Local."""
        dim = len(self._bodies[0].point)
        half = np.linalg.norm(amounts[:, dim:], axis=1, keepdims=True) / 2
        factor = np.where(half > 0, function(half) / np.where(half > 0, half, 1.0), 1.0)
        return np.hstack([amounts[:, :dim], factor * amounts[:, dim:]])

    @property
    def are_moving(self) -> bool:
        """Whether they lead any body somewhere in the step. Local."""
        return bool(self.prescribed.any())

    def turns(self) -> list[tuple[str, float]]:
        """Names of the bodies, and angles by which the guides turn them [rad]. Local."""
        turns = []
        for i, body in enumerate(self._bodies):
            half = np.arctan(np.linalg.norm(self.prescribed[i, len(body.point) :]) / 2)
            turns.append((body.body.name, 2 * float(half)))
        return turns

    def constrained(self, x: Floats) -> Floats:
        """Part of displacements, rigid motions of the bodies as declared, that is not free.

        Collective. Displacements of the owned nodes have the shape ``(n, d)`` [m].
        """
        part = np.zeros_like(x)
        for body in self._bodies:
            sums: Floats = reductions.total(self._comm, body.values.T @ x[body.nodes])
            motions = rigid_motions(body.reference)
            amounts = nearest(motions, body.products, sums)
            amounts = amounts - body.free.T @ (body.free @ amounts)
            part[body.nodes] = body.values @ combined(amounts, motions)
        return part

    def reactions(self, force: Floats, x: Floats, du: Floats) -> tuple[Reaction, ...]:
        """Forces on the guided bodies in a step, see `Supports.reactions`. Collective.

        Args:
            force: What nodal forces leave of the balance, shape ``(n, d)`` [N].
            x: Positions at which they act, of the local nodes, shape ``(l, 3)`` [m].
            du: Displacements of the owned nodes in the step, shape ``(n, d)`` [m].

        Returns:
            The reaction of each guide, in the order of the bodies.
        """
        guided = [body.nodes for body in self._bodies if body.body.guide is not None]
        if not guided:
            return ()
        V, vectors = self._bodies[0].body.V, in_space(force)
        turning = moments(np.asarray(np.cross(x[: len(du)], vectors), dtype=np.float64), V)
        resultant = resultants(vectors, V)
        parts = np.column_stack([resultant, turning, (force * du).sum(axis=1)])
        sums = np.array([parts[nodes].sum(axis=0) for nodes in guided])
        return total_reactions(self._comm, sums, resultant.shape[1])
