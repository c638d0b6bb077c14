"""Forces, pressures, friction and overlap from the nodal positions of a run.

Contact forces are the forces of the cells at the nodes, so that all codes are judged alike. The
pressure is that of Hertz for the force, the traction that of Cattaneo and Mindlin (K. L. Johnson,
Contact Mechanics, chapters 4 and 7).
"""

from typing import NamedTuple

import numpy as np

from benchmarks.peers.hexahedra import Hexahedra
from benchmarks.peers.scene import NU, E, Floats, Ints
from benchmarks.press.scene import MU, NUM_DOWN, RADIUS, WIDTH, Scene

__all__ = ["Verdict", "judge"]

_STIFFNESS = E / (1 - NU**2) / 2  # E* of two bodies [Pa]
# Part of the contact radius in which pressures are compared [-]: the finer mesh has a node there in
# each of its cells, while at the rim the error of a node is that of a whole cell.
_WITHIN = 0.85


class Verdict(NamedTuple):
    """Numbers of a run.

    Attributes:
        force: Pressing force before the block is dragged [N].
        balance: Largest difference of the forces on both bodies, relative to it [-].
        pressure_error: Root mean square of the difference of nodal pressures from Hertz, of both
            bodies, relative to the greatest pressure [-].
        traction_error: That of tangential tractions from Cattaneo and Mindlin while the block is
            dragged, relative to mu times the greatest pressure [-].
        sliding: Tangential over pressing force at the end, relative to mu [-].
        overlap: Depth of the deepest node in the other body, relative to the sagitta a^2/2R [-].
    """

    force: float
    balance: float
    pressure_error: float
    traction_error: float
    sliding: float
    overlap: float


class _Side(NamedTuple):
    """One body in contact.

    Attributes:
        x: Its nodes, from left to right, shape ``(k, 3)`` [m].
        force: What contact does to them, those along y together, the same shape [N].
        pressure, traction: Pressing and tangential force per area, shape ``(k,)`` [Pa].
    """

    x: Floats
    force: Floats
    pressure: Floats
    traction: Floats

    @classmethod
    def of(cls, X: Floats, x: Floats, forces: Floats, nodes: Ints) -> "_Side":
        """The body of nodes along x and y, with the forces of the cells on all nodes."""
        force = forces[nodes].sum(axis=1)
        area = WIDTH * np.convolve(np.diff(X[nodes[:, 0], 0]), [0.5, 0.5])
        pressing = np.sign(force[:, 2].sum()) * force[:, 2]
        return cls(x[nodes[:, 0]], force, pressing / area, np.abs(force[:, 0]) / area)

    def errors(self, force: Floats) -> tuple[Floats, Floats]:
        """Differences of pressure and traction from theory, relative to p0 and mu p0."""
        tangential, _, pressing = np.abs(force)
        a, p0 = _hertz(pressing)
        middle = self.x[:, 0] @ self.pressure / self.pressure.sum()
        s = np.abs(self.x[:, 0] - middle) / a
        within = s < _WITHIN
        sticking = np.sqrt(max(1 - tangential / (MU * pressing), 0.0))
        pressure = np.sqrt(1 - s[within] ** 2)
        traction = pressure - np.sqrt(np.fmax(sticking**2 - s[within] ** 2, 0.0))
        return self.pressure[within] / p0 - pressure, self.traction[within] / p0 / MU - traction


def _hertz(force: float) -> tuple[float, float]:
    """Contact radius [m] and greatest pressure [Pa] of a line contact."""
    a = np.sqrt(4 * force * RADIUS / (WIDTH * np.pi * _STIFFNESS))
    return a, 2 * force / (WIDTH * np.pi * a)


def judge(scene: Scene, x: Floats) -> Verdict:
    """Judge a run by the positions of its nodes, shape ``(steps + 1, n, 3)`` [m].

    The first step, in which contact has few nodes, counts for balance and overlap only.
    """
    cells = Hexahedra.of(scene.X, scene.cells)
    forces, pressures, tractions, balance, overlap = [], [], [], 0.0, 0.0
    for step, now in enumerate(x[1:], start=1):
        of_cells = cells.forces(now)
        sides = [_Side.of(scene.X, now, of_cells, nodes) for nodes in (scene.outer, scene.top)]
        upper, lower = (side.force.sum(axis=0) for side in sides)
        forces.append(upper)
        balance = max(balance, float(np.abs(upper + lower)[[0, 2]].max() / abs(upper[2])))
        sagitta = _hertz(abs(upper[2]))[0] ** 2 / (2 * RADIUS)
        overlap = max(overlap, _overlap(*sides) / sagitta)
        if step > 1:
            errors = [side.errors(upper) for side in sides]
            pressures += [error for error, _ in errors]
            tractions += [error for _, error in errors if step > NUM_DOWN]
    last = np.abs(forces[-1])
    return Verdict(
        float(abs(forces[NUM_DOWN - 1][2])),
        balance,
        *(float(np.sqrt(np.mean(np.concatenate(some) ** 2))) for some in (pressures, tractions)),
        float(last[0] / last[2] / MU),
        overlap,
    )


def _overlap(upper: _Side, lower: _Side) -> float:
    """Largest penetration of a node of either body into the other [m]."""
    (x, _, z), (x_lower, _, z_lower) = upper.x.T, lower.x.T
    depths = np.interp(x, x_lower, z_lower) - z, z_lower - np.interp(x_lower, x, z)
    return float(max(0.0, *(depth.max() for depth in depths)))
