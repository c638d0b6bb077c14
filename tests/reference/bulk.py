"""Bulk and sample geometries of the independent reference program.

Trilinear hexahedra of St. Venant-Kirchhoff material with consistent
mass, 2x2x2 Gauss points and the energy-momentum time integration used
by Franke, Hesch and Betsch (2011) for the bodies. No DOLFINx, small
scenes. Cells have their vertices in tensor order.
"""

from collections.abc import Callable
from itertools import permutations

import numpy as np
import numpy.typing as npt
import scipy.sparse

from reference.nts import shape_functions

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


def box(shape: tuple[int, int, int], size: tuple[float, float, float]) -> tuple[Array, IntArray]:
    """Return nodes (n, 3) and cells (c, 8) of a box with a corner at the origin."""
    (nx, ny, nz), grid = shape, np.add(shape, 1)[::-1]
    nodes = np.indices(grid).reshape(3, -1).T[:, ::-1] * np.divide(size, shape)
    number = np.arange(np.prod(grid)).reshape(grid)
    cells = [
        number[c : c + 2, b : b + 2, a : a + 2].ravel()
        for c in range(nz)
        for b in range(ny)
        for a in range(nx)
    ]
    return nodes, np.array(cells)


def rotation(axis: Array, angle: float) -> Array:
    """Return the rotation matrix about ``axis`` (Rodrigues)."""
    u = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    skew = np.cross(np.eye(3), u)
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew


def renumberings(k: int) -> list[tuple[list[int], int]]:
    """Return the vertex orders of the same segment, each with its sign.

    The sign is -1 where the order reverses ``a_1 x a_2``.
    """
    if k == 3:
        orders = [list(order) for order in permutations(range(3))]
        return [(order, round(np.linalg.det(np.eye(3)[order]))) for order in orders]
    square = np.array([[0, 1], [2, 3]])
    turned = [np.rot90(square, n) for n in range(4)]
    return [(t.ravel().tolist(), 1) for t in turned] + [(t.T.ravel().tolist(), -1) for t in turned]


def sample_pairs(
    k: int, orientation: float, *, num: int = 12, seed: int = 0
) -> tuple[Array, Array, Array, Array]:
    """Return random distorted pairs with known projections.

    Segments of size one, vertices moved by up to 0.15 in every
    direction (quadrilaterals are twisted), rotated and translated at
    random. Projections lie inside and slightly outside the segments,
    gaps between -0.3 and 0.3.

    Returns:
        x_pair (num, 1 + k, 3), orientation (num,), xi (num, 2) and
        gap (num,).
    """
    rng = np.random.default_rng([seed, k, int(orientation > 0)])
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])[:k]
    x_pair = np.empty((num, 1 + k, 3))
    xi = rng.uniform(-0.1, 0.6 if k == 3 else 1.1, (num, 2))
    gap = rng.uniform(0.02, 0.3, num) * np.where(np.arange(num) % 2, 1, -1)
    for pair, at, distance in zip(x_pair, xi, gap, strict=True):
        turn = rotation(rng.normal(size=3), rng.uniform(0, np.pi))
        pair[1:] = (corners + rng.uniform(-0.15, 0.15, (k, 3))) @ turn.T + rng.normal(size=3)
        phi, dphi, _ = shape_functions(at, k)
        normal = orientation * np.cross(*(dphi @ pair[1:]))
        pair[0] = phi @ pair[1:] + distance * normal / np.linalg.norm(normal)
    return x_pair, np.full(num, float(orientation)), xi, gap


def taylor_order(function: Callable[[Array], Array], x: Array, d: Array, slope: Array) -> float:
    """Return the lowest observed order of the Taylor remainder.

    ``|f(x + h d) - f(x) - h slope|`` over four halvings of h, largest
    entry; the order is 2 if ``slope`` is the derivative along ``d``.
    """
    steps = 0.02 / 2.0 ** np.arange(5)
    start = function(x)
    remainders = [np.abs(function(x + h * d) - start - h * slope).max() for h in steps]
    return float(np.log2(np.divide(remainders[:-1], remainders[1:])).min())


class Bulk:
    """Bodies of St. Venant-Kirchhoff material.

    Args:
        X: Reference nodes (n, 3).
        cells: Hexahedra (c, 8), vertices in tensor order.
        lmbda: First Lame parameter.
        mu: Shear modulus.
        rho: Reference density.
    """

    def __init__(self, X: Array, cells: IntArray, *, lmbda: float, mu: float, rho: float) -> None:
        """Tabulate gradients and weights, and assemble the mass matrix."""
        self.num_nodes, self.cells = len(X), cells
        delta = np.eye(3)
        pair = np.einsum("ik,jl->ijkl", delta, delta)
        self.C = lmbda * np.einsum("ij,kl->ijkl", delta, delta)
        self.C = self.C + mu * (pair + pair.transpose(0, 1, 3, 2))

        points = (1 + np.array([-1, 1]) / np.sqrt(3)) / 2
        bits = np.array([[v & 1, v >> 1 & 1, v >> 2 & 1] for v in range(8)])
        self.gradients, self.weights = [], []
        mass = np.zeros((self.num_nodes, self.num_nodes))
        for point in np.array(np.meshgrid(points, points, points)).reshape(3, 8).T:
            factors = np.where(bits, point, 1 - point)
            phi = factors.prod(axis=1)
            dphi = np.array([(2 * bits[:, a] - 1) * np.delete(factors, a, 1).prod(axis=1)
                             for a in range(3)])  # fmt: skip
            jacobian = np.einsum("av,cvi->cia", dphi, X[cells])
            weight = np.linalg.det(jacobian) / 8
            if np.any(weight <= 0):
                raise ValueError("expected cells with positive volume")
            self.gradients.append(np.einsum("av,caj->cvj", dphi, np.linalg.inv(jacobian)))
            self.weights.append(weight)
            for cell, w in zip(cells, weight, strict=True):
                mass[np.ix_(cell, cell)] += rho * w * np.outer(phi, phi)
        self.mass = np.kron(mass, np.eye(3))

    def _strain(self, x: Array, gradient: Array) -> tuple[Array, Array]:
        F = np.einsum("cvi,cvj->cij", x[self.cells], gradient)
        return F, (F.transpose(0, 2, 1) @ F - np.eye(3)) / 2

    def internal(
        self, x_n: Array, x: Array, *, conserving: bool = True, sparse: bool = False
    ) -> tuple[Array, Array | scipy.sparse.csr_matrix]:
        """Return the internal force (3n,) of a step and its tangent.

        The stress is that of the mean Green-Lagrange strain of the two
        states, or, unless ``conserving``, that of the mean configuration.
        """
        n, C = self.num_nodes, self.C.reshape(9, 9)
        force, blocks = np.zeros((n, 3)), np.zeros((len(self.cells), 24, 24))
        for gradient, weight in zip(self.gradients, self.weights, strict=True):
            (F_n, E_n), (F, E) = self._strain(x_n, gradient), self._strain(x, gradient)
            F_mid, E_mid = (F_n + F) / 2, (E_n + E) / 2
            if not conserving:
                F, E_mid = self._strain((x_n + x) / 2, gradient)
            S = weight[:, None, None] * (E_mid.reshape(-1, 9) @ C).reshape(-1, 3, 3)
            np.add.at(force, self.cells, gradient @ S @ F_mid.transpose(0, 2, 1))
            geometric = gradient @ S @ gradient.transpose(0, 2, 1) / 2
            B_mid, B = (
                np.einsum("cik,cvl->cvikl", each, gradient).reshape(-1, 24, 9)
                for each in (F_mid, F)
            )
            blocks += weight[:, None, None] / 2 * (B_mid @ C) @ B.transpose(0, 2, 1)
            blocks += np.einsum("cvw,ij->cviwj", geometric, np.eye(3)).reshape(-1, 24, 24)
        dofs = (3 * self.cells[:, :, None] + np.arange(3)).reshape(-1, 24)
        rows, columns = np.repeat(dofs, 24, axis=1), np.tile(dofs, 24)
        entries = blocks.ravel(), (rows.ravel(), columns.ravel())
        tangent = scipy.sparse.csr_matrix(entries, shape=(3 * n, 3 * n))
        return force.ravel(), tangent if sparse else tangent.toarray()

    def step(self, x_n: Array, v_n: Array, dt: float) -> Callable[[Array], tuple[Array, Array]]:
        """Return the callback ``x -> (R, K)`` of one time step.

        Momentum balance divided by the step, the end velocity
        eliminated by ``v = 2 (x - x_n) / dt - v_n``.
        """

        def residual(x: Array) -> tuple[Array, Array]:
            force, tangent = self.internal(x_n, x)
            inertia = self.mass @ (2 / dt**2 * (x - x_n) - 2 / dt * v_n).ravel()
            return inertia + force, 2 / dt**2 * self.mass + tangent

        return residual

    def strain_energy(self, x: Array) -> float:
        """Return the strain energy."""
        energy = 0.0
        for gradient, weight in zip(self.gradients, self.weights, strict=True):
            _, E = self._strain(x, gradient)
            energy += np.einsum("c,cij,ijkl,ckl->", weight, E, self.C, E) / 2
        return float(energy)

    def kinetic_energy(self, v: Array) -> float:
        """Return the kinetic energy."""
        return float(v.ravel() @ self.mass @ v.ravel() / 2)

    def momenta(self, x: Array, v: Array) -> Array:
        """Return linear and angular momentum about the origin, (6,)."""
        p = (self.mass @ v.ravel()).reshape(-1, 3)
        return np.concatenate((p.sum(axis=0), np.cross(x, p).sum(axis=0)))
