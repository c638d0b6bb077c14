r"""A motion along which the energy falls, by the factors of a whole system.

On the displacements that keep active constraints, :math:`G^T x = 0`, the tangent A has as many
negative eigenvalues as the symmetric matrix of the whole system has more than constraints, which
signs of pivots tell (Sylvester). If there are any, inverse iteration of some random forces finds
a motion of them: with :math:`A x_i = f_i + G \lambda_i` curvatures are
:math:`x_i^T A x_j = x_i^T f_j`, and the next forces are :math:`D x_i` with the stiffness D of the
nodes. What is nearest to the limit grows fastest.
"""

from collections.abc import Callable

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions

__all__ = ["lowest_ritz_vector"]

# Rounds after which the lowest motion so far has to do.
_ROUNDS = 6
# Part of the largest square [-] below which motions depend on each other.
_DEPENDENT = 1e-10


def lowest_ritz_vector(
    comm: MPI.Comm, forces: Floats, stiffness: Floats, solve: Callable[[Floats], Floats]
) -> Floats:
    """Find a motion of negative curvature where there is one. Collective.

    Args:
        comm: Communicator.
        forces: Random forces on the owned unknowns, shape ``(k, m)`` [N].
        stiffness: That of the owned unknowns, shape ``(m,)`` [N/m].
        solve: Returns the displacements for forces, both of shape ``(m,)``.

    Returns:
        The motion of the lowest curvature relative to the stiffness, shape ``(m,)``.
    """
    motions, loads = np.empty((2, 0, forces.shape[1]))
    for _ in range(_ROUNDS):
        new = np.array([solve(force) for force in forces])
        motions, loads = np.vstack([motions, new]), np.vstack([loads, forces])
        squares, curvatures = (
            reductions.total(comm, motions @ each.T) for each in (stiffness * motions, loads)
        )
        size, own = np.linalg.eigh(squares)
        own = own[:, size > _DEPENDENT * size[-1]] / np.sqrt(size[size > _DEPENDENT * size[-1]])
        values, ritz = np.linalg.eigh(own.T @ (curvatures + curvatures.T) / 2 @ own)
        lowest = (own @ ritz).T @ motions
        if values[0] < 0:
            break
        forces = stiffness * lowest[: len(forces)]
    found: Floats = lowest[0]
    return found
