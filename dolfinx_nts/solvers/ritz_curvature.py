r"""Direction of negative curvature of the energy from the factors of a complete system.

On the displacements that keep active constraints, :math:`G^T x = 0`, the tangent A has as many
negative eigenvalues as the symmetric complete matrix has in excess of the number of constraints
(Sylvester's law of inertia, counted by the signs of pivots). If there are any, inverse iteration
with random forces finds one: with :math:`A x_i = f_i + G \lambda_i` the curvatures are :math:`x_i^T
A x_j = x_i^T f_j`, and the next forces are :math:`D x_i` with the nodal stiffness D. The modes
closest to the limit grow fastest.
"""

from collections.abc import Callable

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions

__all__ = ["lowest_ritz_vector"]

# Largest number of inverse iterations, after which the lowest Ritz vector so far is returned.
_ROUNDS = 6
# Ratio of eigenvalues of the Gram matrix [-] below which vectors are linearly dependent.
_DEPENDENT = 1e-10


def lowest_ritz_vector(
    comm: MPI.Comm, forces: Floats, stiffness: Floats, solve: Callable[[Floats], Floats]
) -> Floats:
    """Ritz vector of the lowest curvature. Collective.

    Args:
        comm: Communicator.
        forces: Random forces on the owned unknowns, shape ``(k, m)`` [N].
        stiffness: Stiffness of the owned unknowns, shape ``(m,)`` [N/m].
        solve: Returns the displacements for forces, both of shape ``(m,)``.

    Returns:
        Vector of the lowest curvature relative to the stiffness, shape ``(m,)``.
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
