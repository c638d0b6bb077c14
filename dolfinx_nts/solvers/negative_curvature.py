r"""A motion along which the energy of bodies and loads falls from an equilibrium, if there is one.

The equilibrium is unstable if the tangent A has a negative eigenvalue. Conjugate gradients on
A x = b with any definite preconditioner show it: on the space that they span A is definite as long
as all curvatures :math:`d = p^T A p` of their directions are positive. Newton's method does not see
what its residual has no part of, as the buckling of a straight column; a random b has a part of
everything. With the stiffness D of the nodes and independent numbers :math:`\xi` of unit variance
let :math:`b = \sqrt{D} \xi`. As long as no curvature is negative, residuals are r = q(A B) b with a
polynomial q(t), a product of factors :math:`1 - t/\theta` with :math:`\theta > 0`, and a left
eigenvector w of A B with an eigenvalue that is negative has :math:`|w^T r| > |w^T b|`. But
:math:`w^T b` is a random number with the standard deviation :math:`|\sqrt D w|`, so that a residual
of :math:`|D^{-1/2} r| < \delta` leaves a negative eigenvalue unseen with a probability of at most
:math:`\sqrt{2/\pi}\, \delta`: that of :math:`|\xi| < \delta` for a single number.
"""

from collections.abc import Callable

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.parallel import reductions

__all__ = ["negative_curvature_direction"]

# Residual that ends the search, in parts of the random force of one unknown [-].
_LEFT = 0.03
# Curvature relative to that of the preconditioner [-] which counts as negative: less is round-off
# of products, or a state just beyond the limit.
_NEGATIVE = -1e-3
# Iterations after which nothing is known: preconditioners that serve Newton's method take fewer.
_MOST = 30


def negative_curvature_direction(
    comm: MPI.Comm,
    b: Floats,
    weight: Floats,
    precondition: Callable[[Floats], Floats],
    act: Callable[[Floats], Floats],
) -> Floats | None:
    """Search along conjugate directions. Collective.

    Args:
        comm: Communicator.
        b: Random force on the owned unknowns, without a part in constraints, shape ``(m,)`` [N].
        weight: Square root of their stiffness, the same shape [(N/m)^(1/2)].
        precondition: Returns the approximate displacements for forces, as constraints let them be.
        act: Returns the forces of such displacements, without a part in constraints.

    Returns:
        Displacements of any size, None where all curvatures are positive.
    """
    r = b
    directions, forces = np.empty((2, 0, len(b)))
    curvatures: Floats = np.empty(0)
    for _ in range(_MOST):
        p = precondition(r)
        # Preconditioners need not be symmetric: directions are conjugate to all before them.
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
