"""The scene by incremental potential contact (Li et al. 2020): ipctk for contact, else NumPy.

Trapezoidal rule, barrier with a potential at every state, projected Newton method with a line
search that no contact passes, SciPy's direct solver.
"""

import time
from typing import Any

import ipctk
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from benchmarks.peers.hexahedra import Hexahedra
from benchmarks.peers.scene import E, Floats, H, Run, Scene, num_steps

__all__ = ["run", "version"]

# Distance below which the barrier acts [m], and its stiffness [Pa].
_REACH, _BARRIER = 0.01, 10 * E
# Largest increment at convergence of Newton's method, per step [m/s].
_TOLERANCE, _MAX_ITERATIONS = 1e-6, 100
# SuperLU orders and factorises matrices declared symmetric faster.
_SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}


def version() -> str:
    """Version of the toolkit."""
    return str(ipctk.__version__)


class _Potential:
    """Elastic and barrier energy, and their derivatives."""

    def __init__(self, scene: Scene) -> None:
        self._bodies = Hexahedra.of(scene.X, scene.cells)
        cells = self._bodies.cells
        dofs = (3 * cells[:, :, None] + np.arange(3)).reshape(len(cells), 24)
        self._rows = np.repeat(dofs, 24, axis=1).ravel(), np.tile(dofs, (1, 24)).ravel()
        self._shape = (scene.X.size,) * 2
        mass = np.einsum("cab,ij->caibj", self._bodies.mass(), np.eye(3))
        self.mass = self._assembled(mass.reshape(-1, 24, 24))
        facets = np.concatenate([scene.outer, scene.top])
        triangles = facets[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3).astype(np.int32)
        edges = ipctk.edges(triangles)
        include = np.isin(np.arange(len(scene.X)), triangles)
        self._mesh = ipctk.CollisionMesh(include, include, scene.X, edges, triangles)
        self._barrier = ipctk.BarrierPotential(_REACH, _BARRIER)

    def _assembled(self, blocks: Floats) -> sparse.csc_matrix:
        return sparse.coo_matrix((blocks.ravel(), self._rows), self._shape).tocsc()

    def _contacts(self, x: Floats) -> tuple[ipctk.NormalCollisions, Floats]:
        vertices = np.asfortranarray(self._mesh.vertices(np.asfortranarray(x)))
        contacts = ipctk.NormalCollisions()
        contacts.build(self._mesh, vertices, _REACH)
        return contacts, vertices

    def energy(self, x: Floats) -> float:
        """Energy [J]."""
        contacts, vertices = self._contacts(x)
        return self._bodies.energy(x) + float(self._barrier(contacts, self._mesh, vertices))

    def forces(self, x: Floats) -> Floats:
        """Gradient, shape ``(n, 3)`` [N]."""
        contacts, vertices = self._contacts(x)
        barrier = self._barrier.gradient(contacts, self._mesh, vertices)
        return self._bodies.forces(x) + self._mesh.to_full_dof(barrier).reshape(-1, 3)

    def stiffness(self, x: Floats, is_projected: bool) -> sparse.csc_matrix:
        """Hessian, with or without the negative eigenvalues of cells [N/m]."""
        blocks = self._bodies.stiffness(x)
        if is_projected:
            values, vectors = np.linalg.eigh(blocks)
            blocks = (vectors * np.fmax(values, 0.0)[:, None]) @ vectors.swapaxes(1, 2)
        contacts, vertices = self._contacts(x)
        barrier = self._barrier.hessian(
            contacts, self._mesh, vertices, ipctk.PSDProjectionMethod.CLAMP
        )
        return self._assembled(blocks) + self._mesh.to_full_dof(barrier)

    def free_part(self, x: Floats, end: Floats) -> float:
        """Fraction of a straight path without contact [-]."""
        ends = [np.asfortranarray(self._mesh.vertices(np.asfortranarray(y))) for y in (x, end)]
        return float(ipctk.compute_collision_free_stepsize(self._mesh, *ends))


def run(scene: Scene) -> Run:
    """Run the scene."""
    potential = _Potential(scene)
    x, v = scene.X, scene.start
    a = np.zeros_like(x)  # of bodies at rest, apart from each other
    positions, velocities, newton = [x], [v], 0
    start = time.process_time()
    for _ in range(num_steps):
        target = x + H * v + H**2 / 4 * a
        y, iterations = _minimised(potential, x, target)
        newton += iterations
        a_new = 4 / H**2 * (y - target)
        v = v + H / 2 * (a + a_new)
        x, a = y, a_new
        positions.append(x)
        velocities.append(v)
    cpu = time.process_time() - start
    return Run(np.array(positions), np.array(velocities), cpu, newton)


def _minimised(potential: _Potential, x: Floats, target: Floats) -> tuple[Floats, int]:
    """Minimise (x - target) M (x - target)/2 + h^2/4 V(x) from x; also return the iterations."""
    share, mass = H**2 / 4, potential.mass

    def value(y: Floats) -> float:
        change = (y - target).ravel()
        return float(change @ (mass @ change)) / 2 + share * potential.energy(y)

    for iteration in range(1, _MAX_ITERATIONS + 1):
        gradient = mass @ (x - target).ravel() + share * potential.forces(x).ravel()
        for is_projected in (False, True):
            matrix = (mass + share * potential.stiffness(x, is_projected)).tocsc()
            step = splu(matrix, **_SYMMETRIC).solve(-gradient)
            if gradient @ step < 0:
                break
        change = step.reshape(-1, 3)
        if np.abs(change).max() <= _TOLERANCE * H:
            return x, iteration
        part, before = potential.free_part(x, x + change), value(x)
        slope = float(gradient @ step)
        while value(x + part * change) > before + 1e-4 * part * slope + 1e-14 * abs(before):
            part /= 2
            if part < 1e-12:
                return x, iteration
        x = x + part * change
    raise RuntimeError(f"expected convergence within {_MAX_ITERATIONS} iterations")
