"""Reactions of supports."""

import operator
from typing import NamedTuple

from mpi4py import MPI

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions

__all__ = ["Reaction", "reactions_of", "total_reactions"]


class Reaction(NamedTuple):
    """Force, moment and work of a support or a guide in a step, the same on all ranks.

    The force is the one in the balance of momentum of the scheme: loads, contact forces and
    reactions add up to the rate of momentum. Its product with the displacement increment is the
    work; in statics the mean of the forces at both ends of the step does the work.

    Attributes:
        force: Resultant on the bodies (x, y, z), in the plane (x, y), axisymmetric (y,) [N].
        moment: Moment about the origin (x, y, z), in the plane (z,), axisymmetric () [N m].
        work: Work in the step [J], zero if the support does not move.

    Example:
        >>> ends = fem.locate_dofs_geometrical(V, lambda x: (x[2] < 0.01) | (x[2] > 1.0))
        >>> clamp = fem.dirichletbc(np.zeros(3), ends, V)
        >>> gravity = nts.Gravity(bodies, (0.0, 0.0, -10.0))  # of 1000 kg
        >>> stepper = nts.QuasiStatic(bodies, dt=1.0, bcs=[clamp], loads=[gravity])
        >>> (reaction,) = stepper.advance().reactions
        >>> print(f"{reaction.force[2]:.6g} N, {reaction.work:g} J")
        10000 N, 0 J
    """

    force: tuple[float, ...]
    moment: tuple[float, ...]
    work: float

    def __add__(self, other: "Reaction") -> "Reaction":  # type: ignore[override]
        """Add forces, moments and works. Local."""
        parts = zip(self[:2], other[:2], strict=True)
        force, moment = (tuple(map(operator.add, *both)) for both in parts)
        return Reaction(force, moment, self.work + other.work)


def total_reactions(comm: MPI.Comm, parts: Floats, size: int) -> tuple[Reaction, ...]:
    """Sum reactions over all ranks. Collective.

    Args:
        comm: Communicator.
        parts: Force, moment and work of each reaction on this rank, shape ``(r, m)``.
        size: Number of components of a force.
    """
    sums: Floats = reductions.total(comm, parts)
    return reactions_of(sums, size)


def reactions_of(sums: Floats, size: int) -> tuple[Reaction, ...]:
    """Split an array of reactions into one `Reaction` for each row. Local."""
    rows: list[list[float]] = [list(map(float, row)) for row in sums]
    return tuple(Reaction(tuple(row[:size]), tuple(row[size:-1]), row[-1]) for row in rows)
