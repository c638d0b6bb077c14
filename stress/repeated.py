"""Long runs: many impacts, many turns."""

from collections.abc import Iterator
from functools import partial
from itertools import combinations
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx_nts as nts
from stress.parts import RUBBER, Array, Part, ball, box, box_blocks, from_blocks
from stress.rows import Case, Setup
from stress.world import Touch, World

__all__ = ["CASES"]

_RADIUS = 0.3
# A plate or box that hardly moves.
_HEAVY = nts.SaintVenantKirchhoff(E=1e6, nu=0.3, rho=1e7)


class Impacts:
    """Counts how often the pairs of a stepper begin to press.

    It replaces the stepper of a `Setup` and counts in ``run``.
    """

    def __init__(self, stepper: Any, least: int) -> None:
        """Start at zero."""
        self.stepper, self.least, self.count = stepper, least, 0

    def run(self, until: float, control: nts.StepControl | None = None) -> Iterator[nts.StepReport]:
        """Run and count."""
        touching = [False] * len(self.stepper.pairs)
        for report in nts.EnergyMomentum.run(self.stepper, until, control):
            before = touching
            comm = self.stepper.u.function_space.mesh.comm
            counts = np.array([pair.history.active.sum() for pair in self.stepper.pairs])
            touching = (comm.allreduce(counts) > 0).tolist()
            self.count += sum(now and not was for now, was in zip(touching, before, strict=True))
            yield report

    def check(self) -> str:
        """Whether there were enough."""
        return "" if self.count >= self.least else f"{self.count} impacts, expected {self.least}"


def counted(stepper: Any, until: float, least: int) -> Setup:
    """Scene that counts its impacts."""
    impacts = Impacts(stepper, least)
    stepper.run = impacts.run
    return Setup(stepper, until, impacts.check)


def between_plates(comm: MPI.Comm, impacts: int) -> Setup:
    """Ball between two free plates, 0.1 m from each. Collective."""
    slab = box((1.2, 1.2, 0.4), (4, 4, 1)).at(-0.6, -0.6, 0).made(_HEAVY)
    parts = {
        "ball": ball(_RADIUS, 0.1).at(0.02, 0.03, _RADIUS).flying(0.0, 0.01, -1.0),
        "floor": slab.at(0, 0, -0.5),
        "ceiling": slab.at(0, 0, 2 * _RADIUS + 0.1),
    }
    touches = [Touch("ball.outer", "floor.top"), Touch("ball.outer", "ceiling.bottom")]
    # Between 0.5 and 0.6 s per impact: later impact times depend on round-off.
    return counted(World(comm, parts).stepper(touches, 0.02), 0.65 * impacts, impacts)


def crate() -> Part:
    """Box with a cubic cavity of 1.5 m: all cells of a grid but the inner ones.

    Sides: ``wall 0`` to ``wall 5`` inside and ``outer``.
    """
    ticks = np.array([-1.0, -0.75, 0.0, 0.75, 1.0])
    grid = ticks[np.round(box_blocks((4,) * 3, (4,) * 3)).astype(int)]
    blocks = [
        grid[i : i + 2, j : j + 2, k : k + 2]
        for i, j, k in np.ndindex(4, 4, 4)
        if not all(1 <= index <= 2 for index in (i, j, k))
    ]

    def side(x: Array) -> Any:
        middle = x.mean(axis=1)
        axis = np.abs(middle).argmax(axis=1)
        at = middle[np.arange(len(x)), axis]
        walls = np.char.add("wall ", (2 * axis + (at > 0)).astype(str))
        return np.where(np.abs(at) < 0.76, walls, "outer")

    return from_blocks(blocks, side)


def in_a_box(comm: MPI.Comm, impacts: int) -> Setup:
    """Five balls in a closed box. Collective."""
    rng = np.random.default_rng(5)
    places = 0.4 * np.array([(1, 1, 1), (-1, -1, 1), (1, -1, -1), (-1, 1, -1), (0.1, 0, 0.05)])
    names = [f"ball {n}" for n in range(len(places))]
    parts = {
        name: ball(_RADIUS, 0.1).at(*place).flying(*rng.uniform(-1, 1, 3))
        for name, place in zip(names, places, strict=True)
    }
    parts["box"] = crate().made(_HEAVY)
    # A node touches one facet of a surface: at an edge of the cavity it needs two surfaces.
    balls = "+".join(f"{name}.outer" for name in names)
    touches = [Touch(balls, f"box.wall {wall}") for wall in range(6)]
    touches += [Touch(f"{a}.outer", f"{b}.outer") for a, b in combinations(names, 2)]
    return counted(World(comm, parts).stepper(touches, 0.01), 5.0, impacts)


def turning(comm: MPI.Comm, until: float) -> Setup:
    """Box that turns without contact. Collective."""
    brick = box((0.6, 0.4, 0.2), (3, 2, 1)).at(-0.3, -0.2, -0.1)
    spin = np.array([0.5, 0.3, 4.0])

    def velocity(x: Array) -> Array:
        return np.cross(spin, x.T).T

    parts = {"brick": brick.made(RUBBER, velocity)}
    return Setup(World(comm, parts).stepper([], 0.05), until)


CASES = [
    Case("ball between two plates", "impacts", 50, partial(between_plates, impacts=50)),
    Case("five balls in a box", "impacts", 50, partial(in_a_box, impacts=50)),
    Case("turning without contact", "T", 100.0, partial(turning, until=100.0)),
]
