"""NumPy twin of the contact kernels, one node-segment pair at a time.

Written from the equations of Franke, Hesch and Betsch (2011),
"Energy-momentum consistent integration of frictional multibody contact
problems"; numbers in parentheses are theirs, corrections are stated
where used. The oracle of the C++ kernels: it shares no code with them.

A pair is ``x_pair`` of shape ``(1 + k, 3)``: the node, then ``k`` = 3
or 4 segment vertices in Basix order (reference cell: unit triangle, or
unit square in tensor order). The full coordinates of one contact are
``z = (x_pair, normal, xi, slack)``, flattened, of length
``3 (1 + k) + 6``. The gap is positive when open.
"""

from collections.abc import Callable
from functools import cache
from types import SimpleNamespace

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

NUM_CONSTRAINTS = 6


def shape_functions(xi: Array, k: int) -> tuple[Array, Array, Array]:
    """Return ``phi`` (k,), ``dphi`` (2, k) and ``d2phi`` (2, 2, k)."""
    r, s = xi
    if k == 3:
        dphi = np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
        return np.array([1 - r - s, r, s]), dphi, np.zeros((2, 2, 3))
    phi = np.array([(1 - r) * (1 - s), r * (1 - s), (1 - r) * s, r * s])
    dphi = np.array([[s - 1, 1 - s, -s, s], [r - 1, -r, 1 - r, r]])
    d2phi = np.zeros((2, 2, 4))
    d2phi[0, 1] = d2phi[1, 0] = [1, -1, -1, 1]
    return phi, dphi, d2phi


def project(x_pair: Array, orientation: float) -> tuple[Array, float, Array, int]:
    """Project the node onto the segment, unclamped, by Newton.

    Returns:
        ``xi`` (2,), gap, normal (3,) and status: 0 converged, else 1
        with NaN in the other results.
    """
    x_node, x_segment = x_pair[0], x_pair[1:]
    k = len(x_segment)
    xi = np.full(2, 1 / 3 if k == 3 else 1 / 2)
    update = np.inf
    for _ in range(50):
        phi, dphi, d2phi = shape_functions(xi, k)
        tangents, difference = dphi @ x_segment, x_node - phi @ x_segment
        metric = tangents @ tangents.T
        if not np.linalg.det(metric) > 1e-24 * metric[0, 0] * metric[1, 1]:
            break
        if update <= 1e-9:  # quadratic convergence: the last update reached round-off
            cross = np.cross(*tangents)
            normal = orientation * cross / np.linalg.norm(cross)
            return xi, float(difference @ normal), normal, 0
        A = metric - d2phi @ x_segment @ difference
        if np.linalg.det(A) == 0:
            break
        xi = xi + (step := np.linalg.solve(A, tangents @ difference))
        update = np.abs(step).max() / (1 + np.abs(xi).max())
    return np.full(2, np.nan), np.nan, np.full(3, np.nan), 1


def distance(x_pair: Array) -> float:
    """Distance of the node to the segment, which ends at its edges.

    Lines of constant ``r`` are straight: the nearest point of each is known,
    and the nearest of many lines is found on finer and finer grids.
    """
    x_node, x_segment = x_pair[0], x_pair[1:]
    begin, right, top = x_segment[:3]
    end = x_segment[3] if len(x_segment) == 4 else right
    low, high, nearest = 0.0, 1.0, np.inf
    for _ in range(8):
        r = np.linspace(low, high, 65)[:, None]
        start, line = begin + r * (right - begin), (1 - r) * (top - begin) + r * (end - right)
        square = np.maximum(np.sum(line**2, axis=1), np.finfo(float).tiny)
        s = np.clip(np.sum((x_node - start) * line, axis=1) / square, 0, 1)
        lengths = np.linalg.norm(x_node - start - s[:, None] * line, axis=1)
        best, step = r[lengths.argmin(), 0], (high - low) / 64
        nearest = min(nearest, lengths.min())
        low, high = max(0.0, best - 2 * step), min(1.0, best + 2 * step)
    return float(nearest)


def _linearise(x_pair: Array, orientation: float) -> dict[str, Array]:
    """Return the quantities of (29)-(36) at the projection point.

    ``T`` and ``N`` (2, 3(1+k)) are ``[a_alpha, -phi_K a_alpha]`` and
    ``[0, -phi_K,alpha n]``. Two signs differ from the paper:
    ``A = metric - gap n . x_,alphabeta`` (32), and the projection
    responds with ``A dxi = (dx_s - dx_bar) . a + gap n . dx_bar,alpha``
    (31). ``D = A^-1 (T - gap N)`` is the gradient of ``xi``, its index
    is up.
    """
    xi, gap, normal, _ = project(x_pair, orientation)
    x_segment = x_pair[1:]
    phi, dphi, d2phi = shape_functions(xi, len(x_segment))
    tangents = dphi @ x_segment
    metric = tangents @ tangents.T
    curvature = d2phi @ x_segment @ normal
    weights = np.concatenate(([1.0], -phi))
    T = np.array([np.outer(weights, a).ravel() for a in tangents])
    N = np.array([np.outer(np.concatenate(([0.0], -dp)), normal).ravel() for dp in dphi])
    D = np.linalg.solve(metric - gap * curvature, T - gap * N)
    gradient = np.outer(weights, normal).ravel()
    return {"T": T, "N": N, "D": D, "gradient": gradient, "metric": metric, "curvature": curvature}


def gap_gradient(x_pair: Array, orientation: float) -> Array:
    """Return ``[n, -phi_K n]``, the gradient of the gap (3(1+k),)."""
    return _linearise(x_pair, orientation)["gradient"]


def projection_gradient(x_pair: Array, orientation: float) -> Array:
    """Return the gradient of the projection ``xi``, (2, 3(1+k))."""
    return _linearise(x_pair, orientation)["D"]


def convective_slip(x_n: Array, x: Array, orientation: float) -> tuple[Array, ...]:
    """Return slip (2,), force and its gradient at t_{n+1} (2, 3(1+k)).

    (60)-(64), in an orthonormal frame of the metric at t_n: covariant
    components ``t_a`` and those in the frame, ``t_i``, are related by
    ``t_a = R_ia t_i`` with the metric ``R^T R``, R upper triangular.
    """
    xi_n, xi = (project(y, orientation)[0] for y in (x_n, x))
    R = np.linalg.cholesky(_linearise(x_n, orientation)["metric"]).T
    D_m = projection_gradient((x_n + x) / 2, orientation)
    return R @ (xi - xi_n), R @ D_m, R @ projection_gradient(x, orientation)


def gap_hessian(x_pair: Array, orientation: float) -> Array:
    """Return the Hessian of the gap, (3(1+k), 3(1+k)).

    ``d(dg) = (dx_s - dx_bar) . dn - n . dx_bar,alpha dxi^alpha`` with
    ``dn = -a^alpha (n . dx_bar,alpha + curvature_alphabeta dxi^beta)``.
    """
    q = _linearise(x_pair, orientation)
    normal_change = q["N"] - q["curvature"] @ q["D"]
    return q["T"].T @ np.linalg.solve(q["metric"], normal_change) + q["N"].T @ q["D"]


def invariants(x_pair: Array, normal: Array, xi: Array, slack: float) -> Array:
    """Return the invariants (41): 17 on quadrilaterals, 12 on triangles."""
    edges = x_pair[2:] - x_pair[1]  # x_i - x_1
    to_node = x_pair[0] - x_pair[1]
    upper = np.triu_indices(len(edges))
    with_normal = [to_node @ normal], edges @ normal
    with_edges = edges @ to_node, (edges @ edges.T)[upper]
    return np.concatenate((*with_normal, xi, [slack], [normal @ normal], *with_edges))


@cache
def invariants_hessians(k: int) -> Array:
    """Return the constant Hessians of the invariants, (n, nz, nz)."""
    size = 3 * (1 + k) + 6

    # x_s, x_1, ..., x_k and the normal are these matrices times z
    x_node, x_1, *others, normal = np.eye(size)[:-3].reshape(2 + k, 3, size)
    to_node, edges = x_node - x_1, [x - x_1 for x in others]
    products = [(to_node, normal), *((e, normal) for e in edges)]
    products += [None] * 3  # xi, eta and the slack are linear
    products += [(normal, normal), *((e, to_node) for e in edges)]
    products += [(edges[i], edges[j]) for i in range(k - 1) for j in range(i, k - 1)]
    zero = np.zeros((size, size))
    return np.array([zero if p is None else p[0].T @ p[1] + p[1].T @ p[0] for p in products])


def invariants_gradient(z: Array) -> Array:
    """Return the gradient of the invariants at ``z``, affine in ``z``."""
    k = (len(z) - 9) // 3
    gradient = invariants_hessians(k) @ z
    gradient[k : k + 3, -3:] += np.eye(3)
    return gradient


def _num_vertices(pi: Array) -> int:
    return {12: 3, 17: 4}[len(pi)]


def _coefficients(xi: Array, k: int) -> Array:
    """Return ``c(xi)`` (6, n), the constraints being ``c(xi) . pi + const``.

    The constraints are (42) with one correction: in the fifth and sixth
    the derivatives multiply the products with ``x_s - x_1``, which are
    the invariants i+7 of the paper (it prints i+6).
    """
    phi, dphi, _ = shape_functions(xi, k)
    phi, dphi, num = phi[1:], dphi[:, 1:], k - 1
    c = np.zeros((NUM_CONSTRAINTS, 5 + 2 * num + num * (num + 1) // 2))
    c[0, 0], c[0, 1:k], c[0, k + 2] = 1, -phi, -1
    c[1:3, 1:k] = dphi
    c[3, k + 3] = 1 / 2
    c[4:, k + 4 : 2 * k + 3] = dphi
    for row, dp in zip(c[4:], dphi, strict=True):
        product = np.outer(dp, phi)
        symmetric = product + product.T - np.diag(np.diag(product))
        row[2 * k + 3 :] = -symmetric[np.triu_indices(num)]
    return c


@cache
def _polynomial(k: int) -> Array:
    """Return ``c`` (3, 3, 6, n) by powers of both coordinates.

    ``c`` is at most quadratic in each of them, so that interpolation in
    three points is exact.
    """
    around = np.array([-1.0, 0.0, 1.0])
    values = np.array([[_coefficients((r, s), k) for s in around] for r in around])
    interpolate = np.linalg.inv(np.vander(around, increasing=True))
    return np.einsum("pr,qs,rsmn->pqmn", interpolate, interpolate, values)


def _coefficient_derivatives(xi: Array, k: int) -> tuple[Array, Array]:
    """Return the derivatives ``c_,alpha`` and ``c_,alphabeta``."""
    powers = [np.array([[1.0, z, z * z], [0.0, 1.0, 2 * z], [0.0, 0.0, 2.0]]) for z in xi]
    by_order = np.tensordot(powers[0], np.tensordot(powers[1], _polynomial(k), (1, 1)), (1, 1))
    mixed = by_order[1, 1]
    return (
        np.array([by_order[1, 0], by_order[0, 1]]),
        np.array([[by_order[2, 0], mixed], [mixed, by_order[0, 2]]]),
    )


def constraints(pi: Array) -> Array:
    """Return the six constraints (42) at the invariants ``pi``."""
    k = _num_vertices(pi)
    return _coefficients(pi[k : k + 2], k) @ pi - np.array([0, 0, 0, 0.5, 0, 0])


def constraints_gradient(pi: Array) -> Array:
    """Return the gradient of the constraints, (6, n)."""
    k = _num_vertices(pi)
    gradient = _coefficients(pi[k : k + 2], k)
    gradient[:, k : k + 2] += (_coefficient_derivatives(pi[k : k + 2], k)[0] @ pi).T
    return gradient


def constraints_hessian(pi: Array) -> Array:
    """Return the second derivative of the constraints, (6, n, n)."""
    k = _num_vertices(pi)
    dc, d2c = _coefficient_derivatives(pi[k : k + 2], k)
    hessian = np.zeros((NUM_CONSTRAINTS, len(pi), len(pi)))
    hessian[:, k : k + 2, :] += dc.transpose(1, 0, 2)
    hessian[:, :, k : k + 2] += dc.transpose(1, 2, 0)
    hessian[:, k : k + 2, k : k + 2] += np.einsum("abmp,p->mab", d2c, pi)
    return hessian


def _path(pi_n: Array, pi: Array) -> list[tuple[float, float, Array]]:
    """Return (weight, s, pi(s)) of a Gauss rule far beyond exactness."""
    points, weights = np.polynomial.legendre.leggauss(6)
    points, weights = (1 + points) / 2, weights / 2
    return [(w, s, pi_n + s * (pi - pi_n)) for w, s in zip(weights, points, strict=True)]


def average_gradient(pi_n: Array, pi: Array) -> Array:
    """Return the constraints' gradient averaged from ``pi_n`` to ``pi``.

    It replaces the discrete gradient (59) (whose printed plus must be a
    minus): as directional, free of 0/0 and of a norm of mixed units.
    """
    return sum(w * constraints_gradient(point) for w, _, point in _path(pi_n, pi))


def average_hessian(pi_n: Array, pi: Array) -> Array:
    """Return the derivative of the average gradient with respect to ``pi``."""
    return sum(w * s * constraints_hessian(point) for w, s, point in _path(pi_n, pi))


def contact_conserving(x_pair_n: Array, x_pair: Array, orientation: float) -> tuple:
    """Return the energy-momentum contact, auxiliary unknowns condensed.

    The normal and ``xi`` of both states are projections onto the same
    segment; their multipliers follow from the rows (56), (57) for a
    unit normal multiplier.

    Returns:
        gap_n, gap, force F (nq,), gap gradient at n+1 (nq,), tangent
        dF/dq at n+1 (nq, nq), cosine between the two normals; NaN where
        a projection fails.
    """
    xi_n, gap_n, normal_n, status_n = project(x_pair_n, orientation)
    xi, gap, normal, status = project(x_pair, orientation)
    nq = x_pair.size
    if status_n or status:
        nan = np.full(nq, np.nan)
        return gap_n, gap, nan, nan, np.full((nq, nq), np.nan), np.nan
    z_n = np.concatenate((x_pair_n.ravel(), normal_n, xi_n, [gap_n]))
    z = np.concatenate((x_pair.ravel(), normal, xi, [gap]))
    pi_n = invariants(x_pair_n, normal_n, xi_n, gap_n)
    pi = invariants(x_pair, normal, xi, gap)
    W = average_gradient(pi_n, pi)
    D_mid, D_end = invariants_gradient((z_n + z) / 2), invariants_gradient(z)
    q, y = slice(0, nq), slice(nq, nq + 5)  # positions; normal and xi

    rows = W @ D_mid  # the constraints' discrete gradients in z
    B = rows[1:, y].T
    multipliers = np.concatenate(([1.0], -np.linalg.solve(B, rows[0, y])))
    theta = W.T @ multipliers
    force = theta @ D_mid[:, q]

    change = np.tensordot(multipliers, average_hessian(pi_n, pi), 1)
    T = np.tensordot(theta, invariants_hessians(len(x_pair) - 1), 1) / 2 + D_mid.T @ change @ D_end
    rows_end = constraints_gradient(pi) @ D_end
    dy_dq = -np.linalg.solve(rows_end[1:, y], rows_end[1:, q])
    Z = np.vstack((np.eye(nq), dy_dq, np.zeros((1, nq))))
    tangent = (T[q] - rows[1:, q].T @ np.linalg.solve(B, T[y])) @ Z
    gradient = rows_end[0, q] + rows_end[0, y] @ dy_dq
    return gap_n, gap, force, gradient, tangent, float(normal_n @ normal)


def contact_midpoint(x_pair_n: Array, x_pair: Array, orientation: float) -> tuple:
    """Return the contact of the midpoint scheme, same tuple."""
    _, gap_n, normal_n, status_n = project(x_pair_n, orientation)
    _, gap, normal, status = project(x_pair, orientation)
    x_mid = (x_pair_n + x_pair) / 2
    status_mid = project(x_mid, orientation)[-1]
    force, tangent = gap_gradient(x_mid, orientation), gap_hessian(x_mid, orientation) / 2
    gradient = gap_gradient(x_pair, orientation)
    failed = status_n or status or status_mid
    return gap_n, gap, force, gradient, tangent, np.nan if failed else float(normal_n @ normal)


def _batch(function: Callable) -> Callable:
    """Return ``function`` with a leading pair axis on every array."""

    def batched(*arrays: Array) -> Array | tuple[Array, ...]:
        results = [function(*one) for one in zip(*arrays, strict=True)]
        if isinstance(results[0], tuple):
            return tuple(np.array(column) for column in zip(*results, strict=True))
        return np.array(results)

    return batched


# The twin under the interface of the kernels.
_shared = [project, gap_gradient, gap_hessian, invariants, constraints, constraints_gradient]
_shared += [average_gradient, contact_conserving, contact_midpoint]
batched = SimpleNamespace(**{function.__name__: _batch(function) for function in _shared})
