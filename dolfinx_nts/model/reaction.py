"""Reactions of supports."""

from collections.abc import Iterable
from typing import NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.fem.components import in_space, moments
from dolfinx_nts.parallel import reductions

__all__ = ["Reaction", "summed"]


class Reaction(NamedTuple):
    """What a support, or the guide of a rigid body, did to bodies in a step, the same on all ranks.

    The force is the one of the scheme: its product with the increment of the displacement is
    the work of the support, and with loads and contact forces it is the rate of the momentum.

    Attributes:
        force: Resultant on the bodies (x, y, z), in the plane (x, y) [N].
        moment: Moment about the origin (x, y, z), in the plane (z,) [N m].
        work: Work in the step [J], zero where the support does not move.

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


def summed(
    comm: MPI.Comm, parts: Iterable[tuple[Floats, Floats, Floats]]
) -> tuple[Reaction, ...]:
    """Sum the forces of some supports over their nodes. Collective.

    Args:
        comm: Communicator.
        parts: For each support forces at owned nodes, shape ``(n, d)`` [N], positions,
            ``(n, 3)``, and displacements in the step, ``(n, d)`` [m].

    Returns:
        The reaction of each support.
    """
    rows = []
    for force, x, du in parts:
        d = force.shape[1]
        moment = moments(np.cross(x, in_space(force)), d).sum(axis=0)
        rows.append(np.concatenate([force.sum(axis=0), moment, [np.vdot(force, du)]]))
    if not rows:
        return ()
    totals = reductions.total(comm, np.array(rows)).tolist()
    return tuple(Reaction(tuple(row[:d]), tuple(row[d:-1]), row[-1]) for row in totals)
