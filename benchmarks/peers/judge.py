"""Energy, momenta, overlap and rebound from the nodal positions and velocities of a run."""

from typing import NamedTuple

import numpy as np

from benchmarks.peers.hexahedra import Hexahedra
from benchmarks.peers.scene import Floats, Run, Scene

__all__ = ["Verdict", "judge"]


class Verdict(NamedTuple):
    """Numbers of a run.

    Attributes:
        energy_change: Change of kinetic and strain energy from start to end, relative [-].
        momentum_error, angular_momentum_error: Largest change at any step, relative to the size
            at the start [-].
        overlap: Depth of the deepest node or centre of a facet of the ball in the plate at the
            end of any step [m].
        rebound: Velocity of the centre of mass of the ball along z at the end [m/s].
    """

    energy_change: float
    momentum_error: float
    angular_momentum_error: float
    overlap: float
    rebound: float


def judge(scene: Scene, run: Run) -> Verdict:
    """Evaluate a run from the positions and velocities of its nodes."""
    bodies = Hexahedra.of(scene.X, scene.cells)
    volumes = Hexahedra.of_one_point(scene.X, scene.cells) if run.has_one_point else bodies
    momenta = [bodies.momentum(v, run.has_lumped_mass) for v in run.v]
    linear = np.array([p.sum(axis=0) for p in momenta])
    pairs = list(zip(run.x, momenta, strict=True))
    angular = np.array([np.cross(x, p).sum(axis=0) for x, p in pairs])
    energy = [
        np.vdot(v, p) / 2 + volumes.energy_of_volume(x) + bodies.energy_of_shape(x)
        for v, (x, p) in ((run.v[i], pairs[i]) for i in (0, -1))
    ]
    ball = np.unique(scene.ball)
    mass = bodies.momentum(np.ones_like(scene.X))[ball, 2].sum()
    return Verdict(
        energy[1] / energy[0] - 1,
        *(_largest_change(momentum) for momentum in (linear, angular)),
        max(_overlap(scene, x) for x in run.x),
        float(momenta[-1][ball, 2].sum() / mass),
    )


def _largest_change(values: Floats) -> float:
    change = np.linalg.norm(values - values[0], axis=1).max()
    return float(change / np.linalg.norm(values[0]))


def _overlap(scene: Scene, x: Floats) -> float:
    """Depth of the ball below the top of the plate, as a height field over x and y [m]."""
    facets = x[scene.outer]
    points = np.concatenate([x[np.unique(scene.outer)], facets.mean(axis=1)])
    points = points[points[:, 2] < x[scene.top, 2].max()]
    triangles = x[scene.top[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)]
    corner = triangles[:, 0]
    sides = np.stack([triangles[:, 1] - corner, triangles[:, 2] - corner], axis=2)
    offset = points[:, None] - corner
    place = np.einsum("tij,ptj->pti", np.linalg.inv(sides[:, :2]), offset[..., :2])
    above = (place >= 0).all(axis=2) & (place.sum(axis=2) <= 1)
    depth = np.einsum("tj,ptj->pt", sides[:, 2], place) - offset[..., 2]
    return float(np.where(above, depth, 0.0).max(initial=0.0))
