r"""Direction of negative curvature of the potential energy at an equilibrium, if there is one.

The equilibrium is unstable if the tangent A has a negative eigenvalue. Conjugate gradients on A x =
b with any definite preconditioner B detect it: on the Krylov space A is definite as long as the
curvatures :math:`d = p^T A p` of all search directions are positive. Newton's method misses modes
that are absent from its residual, as in the buckling of a straight column. A random b contains all
modes. With the nodal stiffness D and independent random numbers :math:`\xi` of unit variance let
:math:`b = \sqrt{D} \xi`. As long as no curvature is negative, residuals are r = q(A B) b, where the
polynomial q(t) is a product of factors :math:`1 - t/\theta` with :math:`\theta > 0`. A left
eigenvector w of A B with a negative eigenvalue therefore has :math:`|w^T r| > |w^T b|`. But
:math:`w^T b` is a random number with the standard deviation :math:`|\sqrt D w|`. With a residual of
:math:`|D^{-1/2} r| < \delta` the probability to miss a negative eigenvalue is at most
:math:`\sqrt{2/\pi}\, \delta`: the probability of :math:`|\xi| < \delta` for one number.

With factors of a complete system: on the displacements that keep active constraints, :math:`G^T x =
0`, the tangent A has as many negative eigenvalues as the symmetric complete matrix has in excess of
the number of constraints (Sylvester's law of inertia, counted by the signs of pivots). If there are
any, inverse iteration with random forces finds one: with :math:`A x_i = f_i + G \lambda_i` the
curvatures are :math:`x_i^T A x_j = x_i^T f_j`, and the next forces are :math:`D x_i` with the nodal
stiffness D. The modes closest to the limit grow fastest.
"""

from collections.abc import Callable

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions

__all__ = ["lowest_ritz_vector", "negative_curvature_direction"]

# Residual that ends the search, relative to the random force on one unknown [-]. It bounds the
# probability of a miss by 0.024; smaller values take more iterations.
_LEFT = 0.03
# Curvature, relative to that of the preconditioner [-], below which it is negative. Closer to 0 it
# may be round-off, or belong to a state just beyond the limit.
_NEGATIVE = -1e-3
# Largest number of iterations, after which the result is None. Usual preconditioners take fewer.
_MOST = 30

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


def negative_curvature_direction(
    comm: MPI.Comm,
    b: Floats,
    weight: Floats,
    precondition: Callable[[Floats], Floats],
    act: Callable[[Floats], Floats],
) -> Floats | None:
    """Search the Krylov space of a random force for a negative curvature. Collective.

    Args:
        comm: Communicator.
        b: Random force on the owned unknowns, projected on the constraints, shape ``(m,)`` [N].
        weight: Square root of their stiffness, the same shape [(N/m)^(1/2)].
        precondition: Returns approximate displacements for forces, projected on the constraints.
        act: Returns the forces of such displacements, projected on the constraints.

    Returns:
        Direction of arbitrary length, or None if all curvatures are positive.
    """
    r = b
    directions, forces = np.empty((2, 0, len(b)))
    curvatures: Floats = np.empty(0)
    for _ in range(_MOST):
        p = precondition(r)
        # The preconditioner may be nonsymmetric, so all previous directions are orthogonalised.
        parts = reductions.total(comm, np.array([*(forces @ p), p @ r]))
        expected = abs(parts[-1])
        p = p - (parts[:-1] / curvatures) @ directions
        y = act(p)
        curvature, slope = reductions.total(comm, [float(p @ y), float(p @ r)])
        if curvature < _NEGATIVE * expected:
            return p
        if not curvature > 0:
            return None
        r = r - slope / curvature * y
        scaled = r / weight
        if reductions.total(comm, float(scaled @ scaled)) < _LEFT**2:
            return None
        directions, forces = np.vstack([directions, p]), np.vstack([forces, y])
        curvatures = np.append(curvatures, curvature)
    return None
