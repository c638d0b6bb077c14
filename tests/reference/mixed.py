"""Full mixed system of energy-momentum contact, the reference solver.

Equations (53)-(58) of Franke, Hesch and Betsch (2011) for frictionless
contact: besides the positions, every contact has its normal d, its
``f`` = (xi, eta, slack) and six multipliers as unknowns; nothing is
condensed. Differences from the paper: all constraints are imposed at
the end of the step (the last index of (58) is a misprint), the
discrete gradient is the averaged one, and the slack, whose row (57)
only says that its contact force vanishes, is complementary to the
pressure,

    p - max(0, p - c (slack - slack_reference)) = 0,  p = -lambda_1.

``slack_reference`` 0 is the plastic node impact of the paper, the gap
of the old state to the same segment is the elastic one, and ``-inf``
switches a contact off. Dense matrices, small scenes.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse

from reference import nts

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BulkCallback = Callable[[Array], tuple[Array, Array | scipy.sparse.spmatrix]]

UNKNOWNS = 12  # per contact: normal, f, multipliers


@dataclass(frozen=True)
class Contacts:
    """Contacts of one step and their state at its start.

    Args:
        pairs: Node and segment vertices, numbers of nodes (s, 1 + k).
        orientation: Sign of ``a_1 x a_2`` per segment (s,).
        slack_reference: See the module's equation (s,).
        scale: The constant c of that equation [N/m].
    """

    pairs: IntArray
    orientation: Array
    slack_reference: Array
    scale: float


@dataclass(frozen=True)
class Solution:
    """End of a step.

    Args:
        x: Positions (n, 3).
        normal: Unit normals (s, 3).
        f: xi, eta and slack (s, 3).
        multipliers: lambda_1 ... lambda_6 (s, 6).
        iterations: Newton iterations.
    """

    x: Array
    normal: Array
    f: Array
    multipliers: Array
    iterations: int


def _contact_state(x_pair: Array, orientation: float) -> Array:
    """Return ``z`` with normal, xi and slack from the projection."""
    xi, gap, normal, status = nts.project(x_pair, orientation)
    if status:
        raise RuntimeError("projection did not converge")
    return np.concatenate((x_pair.ravel(), normal, xi, [gap]))


def _invariants(z: Array) -> Array:
    return nts.invariants(z[:-6].reshape(-1, 3), z[-6:-3], z[-3:-1], z[-1])


def contact_block(
    z_n: Array, z: Array, multipliers: Array, slack_reference: float, scale: float
) -> tuple[Array, Array]:
    """Return residual and Jacobian of one contact.

    Rows: force on the positions (53)-(55), the normal (56), xi (57),
    the slack's complementarity, the six constraints (58). Columns: z,
    multipliers.
    """
    size = len(z)
    slack = size - 1
    pi_n, pi = _invariants(z_n), _invariants(z)
    W = nts.average_gradient(pi_n, pi)
    D_mid, D_end = nts.invariants_gradient((z_n + z) / 2), nts.invariants_gradient(z)
    theta = W.T @ multipliers

    residual = np.concatenate((D_mid.T @ theta, nts.constraints(pi)))
    jacobian = np.zeros((size + 6, size + 6))
    theta_change = np.tensordot(multipliers, nts.average_hessian(pi_n, pi), 1) @ D_end
    geometric = np.tensordot(theta, nts.invariants_hessians((size - 9) // 3), 1) / 2
    jacobian[:size, :size] = D_mid.T @ theta_change + geometric
    jacobian[:size, size:] = (W @ D_mid).T
    jacobian[size:, :size] = nts.constraints_gradient(pi) @ D_end

    pressure = -multipliers[0]
    jacobian[slack] = 0
    if pressure - scale * (z[slack] - slack_reference) > 0:
        residual[slack] = scale * (z[slack] - slack_reference)
        jacobian[slack, slack] = scale
    else:
        residual[slack] = pressure
        jacobian[slack, size] = -1
    return residual, jacobian


def assemble(
    bulk: BulkCallback, contacts: Contacts, x_n: Array, unknowns: Array
) -> tuple[Array, Array]:
    """Return residual and Jacobian of the whole system.

    Args:
        bulk: Residual and tangent of the momentum balance without
            contact, at the positions (n, 3).
        contacts: The contacts.
        x_n: Positions at the start of the step (n, 3).
        unknowns: Positions, then (normal, f, multipliers) per contact.
    """
    num = x_n.size
    x = unknowns[:num].reshape(-1, 3)
    R, K = bulk(x)
    residual, jacobian = np.zeros(len(unknowns)), np.zeros((len(unknowns), len(unknowns)))
    residual[:num] = R
    jacobian[:num, :num] = K.toarray() if scipy.sparse.issparse(K) else K
    for s, pair in enumerate(contacts.pairs):
        own = num + UNKNOWNS * s + np.arange(UNKNOWNS)
        dofs = np.concatenate(((3 * pair[:, None] + np.arange(3)).ravel(), own))
        z_n = _contact_state(x_n[pair], contacts.orientation[s])
        block = contact_block(
            z_n, unknowns[dofs[:-6]], unknowns[dofs[-6:]], contacts.slack_reference[s],
            contacts.scale,
        )  # fmt: skip
        residual[dofs] += block[0]
        jacobian[np.ix_(dofs, dofs)] += block[1]
    return residual, jacobian


def start_values(contacts: Contacts, x_n: Array, x: Array) -> Array:
    """Return unknowns at positions ``x``: projections, no multipliers."""
    own = np.zeros((len(contacts.pairs), UNKNOWNS))
    for row, pair, sign in zip(own, contacts.pairs, contacts.orientation, strict=True):
        row[:6] = _contact_state(x[pair], sign)[-6:]
    return np.concatenate((x.ravel(), own.ravel()))


def solve_step(
    bulk: BulkCallback,
    contacts: Contacts,
    x_n: Array,
    x_start: Array,
    *,
    tol: float = 1e-13,
    max_iter: int = 40,
) -> Solution:
    """Solve one step by Newton's method.

    Args:
        bulk: See ``assemble``.
        contacts: The contacts, fixed in the step.
        x_n: Positions at the start of the step (n, 3).
        x_start: First guess of the positions (n, 3).
        tol: Bound on the last change of the positions, normals and f
            (lengths of order one).
        max_iter: Bound on the iterations.

    Raises:
        RuntimeError: No convergence.
    """
    num = x_n.size
    unknowns = start_values(contacts, x_n, x_start)
    own = np.tile(np.repeat([True, False], 6), len(contacts.pairs))
    geometric = np.concatenate((np.full(num, True), own))
    for iteration in range(max_iter):
        residual, jacobian = assemble(bulk, contacts, x_n, unknowns)
        # Equilibrated, as rows are forces and lengths.
        rows = np.abs(jacobian).max(axis=1)
        change = np.linalg.solve(jacobian / rows[:, None], -residual / rows)
        unknowns = unknowns + change
        if np.abs(change[geometric]).max() <= tol:
            own = unknowns[num:].reshape(-1, UNKNOWNS)
            x = unknowns[:num].reshape(-1, 3)
            return Solution(x, own[:, :3], own[:, 3:6], own[:, 6:], iteration + 1)
    raise RuntimeError(f"no convergence in {max_iter} iterations")
