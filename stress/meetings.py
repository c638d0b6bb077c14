"""Contact configurations: corners, edges, holes, layers, several contacts at once."""

from collections.abc import Callable
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx_nts as nts
from stress.parts import Array, Part, ball, box, from_blocks, rotation
from stress.rows import Case, Setup, above
from stress.world import Frame, Touch, World

__all__ = ["CASES"]

_H = 0.01
# A cube that stands on a corner, on an edge, on a face.
_POSES = {
    "corner": rotation((1, -1, 0), np.arctan(np.sqrt(2))),
    "edge": rotation((0, 1, 0), np.pi / 4),
    "face": np.eye(3),
}
# Single nodes indent a fine mesh.
PIERCED = "sank into"
# Contact forces that push overlapping bodies apart.
_CLOSING = {"plastic": nts.LagrangeMultiplier("plastic"), "penalty": nts.Penalty()}


def cube(side: float, cells: int, pose: str = "face") -> Part:
    """Cube whose lowest point is the origin."""
    part = box((side,) * 3, (cells,) * 3).at(*(-side / 2,) * 3).turned(_POSES[pose])
    lowest = part.X[part.X[:, 2] <= part.X[:, 2].min() + 1e-9].mean(axis=0)
    return part.at(*-lowest)


def plate(size: float = 2.0, cells: int = 4, thickness: float = 0.3) -> Part:
    """Plate with its top in z = 0, its middle at the origin."""
    return box((size, size, thickness), (cells, cells, 1)).at(-size / 2, -size / 2, -thickness)


def falls(
    comm: MPI.Comm,
    upper: Part,
    lower: Part,
    *,
    side: str = "all",
    segments: str = "top",
    velocity: tuple[float, float, float] = (0.0, 0.0, -1.0),
    until: float = 0.6,
    h: float = _H,
    cell: str = "hexahedron",
    degree: int = 1,
    law: Any = None,
    both: bool = False,
    frame: Frame | None = None,
    **how: Any,
) -> Setup:
    """One body flies against another one. Collective.

    Args:
        comm: Communicator.
        upper: What flies.
        lower: What it strikes.
        side: Side of the upper part that may touch,
        segments: and that of the lower part.
        velocity: Of the upper part [m/s].
        until: Time at the end [s], before it is seen in the frame.
        h: Step [s], as well.
        cell: Type of the cells.
        degree: Of the displacement.
        law: Enforcement; None: multipliers with elastic impact.
        both: Whether there are two half passes.
        frame: How the scene is seen.
        **how: For `World.stepper`: the scheme.
    """
    parts = {"upper": upper.flying(*velocity), "lower": lower}
    world = World(comm, parts, cell, degree, frame)
    touch = Touch(f"upper.{side}", f"lower.{segments}", {"enforcement": law}, both)
    stepper = world.stepper([touch], h, **how)
    check = above(stepper, *stepper.bodies, up=world.frame.turn[:, 2])
    return Setup(stepper, world.frame.length * until, check, ledger=law is not None)


def plate_with_hole(radius: float) -> Part:
    """Square plate of 2 x 2 x 0.3 with a round hole: four grids around it."""
    t, r = np.linspace(-1, 1, 5), np.linspace(0, 1, 3)[:, None]
    outer = np.stack([np.ones(5), t], axis=-1)
    inner = radius * np.stack([np.cos(np.pi / 4 * t), np.sin(np.pi / 4 * t)], axis=-1)
    flat = inner + r[..., None] * (outer - inner)
    blocks = []
    for turn in range(4):
        Q = rotation((0, 0, 1), turn * np.pi / 2)[:2, :2]
        layer = np.stack([flat @ Q.T] * 2, axis=2)
        z = np.broadcast_to(np.array([-0.3, 0.0])[:, None], (*layer.shape[:3], 1))
        blocks.append(np.concatenate([layer, z], axis=-1))

    def side(x: Array) -> Any:
        height, away = x[..., 2].mean(axis=1), np.hypot(*x[..., :2].T).max(axis=0)
        around = np.where(away < 1.01 * radius, "hole", "rim")
        return np.where(height > -1e-9, "top", np.where(height < -0.29, "bottom", around))

    return from_blocks(blocks, side)


def bent(curvature: float) -> Part:
    """Thick plate bent to a bowl (positive) or over a ridge (negative)."""

    def move(x: Array) -> Any:
        bend = x[0] ** 2 + x[1] ** 2 if curvature > 0 else x[0] ** 2
        return x[0], x[1], x[2] + curvature * bend

    return plate(2.0, 6).moved(move)


def through_hole(comm: MPI.Comm, play: float) -> Setup:
    """Ball through a hole that is wider by some part of its radius. Collective."""
    radius = 0.4
    parts = {
        "ball": ball(radius, 0.2, cells=4).at(0, 0, 0.5).flying(0, 0, -2),
        "plate": plate_with_hole(radius * (1 + play)),
    }
    touches = [Touch("ball.outer", "plate.top+plate.hole")]
    return Setup(World(comm, parts).stepper(touches, _H), 0.8)


def both_sides(comm: MPI.Comm, thickness: float) -> Setup:
    """Two cubes strike a thin plate from both sides at once. Collective."""
    parts = {
        "plate": plate(2.0, 6, thickness),
        "above": cube(0.5, 2).at(0.03, 0.02, 0.02).flying(0, 0, -1),
        "below": cube(0.5, 2).at(0.03, 0.02, -0.52 - thickness).flying(0, 0, 1),
    }
    touches = [Touch("above.bottom", "plate.top"), Touch("below.top", "plate.bottom")]
    return Setup(World(comm, parts).stepper(touches, _H), 0.6)


def between(comm: MPI.Comm, gap: float) -> Setup:
    """A resting cube between two approaching cubes, with a gap on each side. Collective."""
    parts = {
        "middle": cube(0.5, 3),
        "above": cube(0.7, 2).at(0.05, 0.03, 0.5 + gap).flying(0, 0, -1),
        "below": cube(0.7, 2).at(0.02, 0.04, -0.7 - gap).flying(0, 0.2, 1),
    }
    touches = [Touch("middle.top", "above.bottom"), Touch("middle.bottom", "below.top")]
    return Setup(World(comm, parts).stepper(touches, _H), 0.6)


def _fall(scene: str, parameter: str, value: Any, upper: Part, lower: Part, **how: Any) -> Case:
    stops, warns = how.pop("stops", None), how.pop("warns", "")
    build: Callable[[MPI.Comm], Setup] = partial(falls, upper=upper, lower=lower, **how)
    return Case(scene, parameter, value, build, stops, warns)


def _size(segments: int, nodes: int) -> tuple[Part, Part]:
    return cube(0.8, nodes).at(0.01, 0.02, 0.05), plate(2.0, segments)


_DOWN = cube(0.5, 2)
CASES = [
    *(
        _fall("cube on a node", "stands on", pose, cube(0.5, 2, pose).at(0, 0, 0.05), plate())
        for pose in _POSES
    ),
    *(
        _fall("cube on its corner", "falls on", name, cube(0.5, 2, "corner").at(*at), plate())
        for name, at in {
            "an edge between facets": (0.25, 0.0, 0.05),
            "a facet": (0.21, 0.17, 0.05),
            "the rim of the plate": (1.0, 0.1, 0.05),
            "the corner of the plate": (1.0, 1.0, 0.05),
        }.items()
    ),
    *(
        _fall(
            "cube slides off the edge",
            "speed",
            speed,
            _DOWN.at(0.7, 0.02, 0.01),
            plate(),
            side="bottom",
            velocity=(speed, 0.0, -0.2),
            until=1.0,
        )
        for speed in (0.5, 1.0, 3.0)
    ),
    *(Case("ball through a hole", "play", p, partial(through_hole, play=p)) for p in (0.0, 0.02)),
    *(
        _fall(
            "ball on a curved plate",
            "curvature",
            c,
            ball(0.4, 0.2, cells=4).at(0.02, 0.03, 0.42),
            bent(c),
            side="outer",
            velocity=(0.3, 0.1, -1.0),
            until=0.8,
        )
        for c in (1.0, 0.3, -0.3, -1.0)
    ),
    *(
        _fall("cube on a plate", "cells of plate : of cube", f"{s}:{n}", *_size(s, n), stops=stops)
        for s, n, stops in (
            (1, 6, None),
            (2, 4, None),
            (16, 1, PIERCED),
            (24, 1, PIERCED),
            (12, 3, None),
        )
    ),
    *(
        _fall(
            "cube in a plate",
            "depth",
            d,
            _DOWN.at(0.03, 0.02, -d),
            plate(),
            side="bottom",
            velocity=(0.0, 0.0, 0.0),
            warns="starts up to" if d > 0.01 else "",
        )
        for d in (0.0, 0.01, 0.1, 0.2)
    ),
    *(
        _fall(
            f"cube in a plate, {name}",
            "depth",
            0.02,
            _DOWN.at(0.03, 0.02, -0.02),
            plate(),
            side="bottom",
            velocity=(0.0, 0.0, 0.0),
            law=law,
            warns="starts up to",
        )
        for name, law in _CLOSING.items()
    ),
    *(
        _fall(
            "parallel faces",
            "nodes at once",
            (n + 1) ** 2,
            cube(0.8, n).at(0.01, 0.02, 0.005),
            plate(),
            side="bottom",
            cell=cell,
        )
        for n, cell in ((2, "hexahedron"), (4, "tetrahedron"), (8, "hexahedron"))
    ),
    *(
        Case("cubes on both sides", "plate", t, partial(both_sides, thickness=t))
        for t in (0.2, 0.05, 0.02)
    ),
    *(Case("cube between two", "gap", g, partial(between, gap=g)) for g in (0.0, 0.005, 0.02)),
]
