"""Other schemes, elements and laws; rotated, large and tiny scenes."""

from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from stress.impact import impact
from stress.meetings import cube, falls, plate
from stress.parts import RUBBER, Part, ball, box, box_blocks, from_blocks, rotation
from stress.rows import CRUSHED, Case, Setup
from stress.world import Frame, Touch, World

__all__ = ["CASES"]

_TURNS = {
    "upside down": rotation((1, 0, 0), np.pi),
    "on its side": rotation((0, 1, 0), np.pi / 2),
    "1 rad about (1, 2, 3)": rotation((1, 2, 3), 1.0),
    "2.5 rad about (3, -1, 2)": rotation((3, -1, 2), 2.5),
}
_LENGTHS = (1e-6, 1e-3, 1e3)
_LAWS = {
    "elastic": nts.LagrangeMultiplier(),
    "plastic": nts.LagrangeMultiplier("plastic"),
    "penalty": nts.Penalty(),
}
UNSTABLE = "stable"


def ring(radius: float, wall: float, width: float, cells: int = 48) -> Part:
    """Ring about the z axis: four grids around it; sides inner and outer."""
    quarter = box_blocks((1, 1, width), (cells // 4, 2, 1))
    angle = np.pi / 2 * (quarter[..., 0] + np.arange(4)[:, None, None, None])
    r, z = radius - wall * quarter[..., 1], np.broadcast_to(quarter[..., 2], angle.shape)
    blocks = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1)

    def side(x: Any) -> Any:
        r = np.hypot(x[..., 0], x[..., 1])
        ends = np.ptp(x[..., 2], axis=1) < width / 2
        return np.where(ends, "end", np.where(r.mean(axis=1) > radius - wall / 2, "outer", "inner"))

    return from_blocks(list(blocks), side)


def folded(comm: MPI.Comm, law: str, speed: float = 2.2) -> Setup:
    """Ring thrown so that its top and its bottom fly towards each other. Collective."""

    def velocity(x: Any) -> Any:
        return np.array([0.7 - 0.1 * x[2], 0.3 * x[0] - speed * x[1], 0.2 + 0 * x[0]])

    parts = {"ring": ring(1.0, 0.06, 0.2).made(RUBBER, velocity)}
    touch = Touch("ring.inner", "ring.inner", {"enforcement": _LAWS[law]})
    return Setup(World(comm, parts).stepper([touch], 0.005), 0.85, ledger=law != "elastic")


def pressed(
    comm: MPI.Comm,
    depth: float,
    kind: Any = nts.NeoHookean,
    law: Any = None,
    cell: str = "hexahedron",
    degree: int = 1,
) -> Setup:
    """Stiff punch on a soft block, in static equilibrium. Collective.

    Args:
        comm: Communicator.
        depth: Way of the punch, block 1 m high [m].
        kind: Kind of material.
        law: Enforcement.
        cell: Type of the cells.
        degree: Of the displacement.
    """
    parts = {
        "block": box((1, 1, 1), (4, 4, 4)).made(kind(1e5, 0.3, 1e3)),
        "punch": box((0.6, 0.6, 0.3), (2, 2, 1)).at(0.21, 0.17, 1).made(kind(1e9, 0.3, 1e3)),
    }
    world = World(comm, parts, cell, degree)
    u = fem.Function(world.V)
    ends = [world.dofs("block.bottom"), world.dofs("punch.top")]

    def update(t: float) -> None:
        u.x.array.reshape(-1, 3)[ends[1], 2] = -depth * t

    bcs = [fem.dirichletbc(u, dofs.astype(np.int32)) for dofs in ends]
    touch = Touch("block.top", "punch.all", {"enforcement": law})
    stepper = world.stepper([touch], 0.05, nts.QuasiStatic, bcs=bcs, update=update)
    return Setup(stepper, 1.0, ledger=True, supported=True)


def squashed(comm: MPI.Comm, part: float, kind: Any = nts.NeoHookean) -> Setup:
    """Cube compressed to a fraction of its height, in static equilibrium. Collective."""
    world = World(comm, {"cube": box((1, 1, 1), (4, 4, 4)).made(kind(1e5, 0.3, 1e3))})
    u = fem.Function(world.V)
    ends = [world.dofs("cube.bottom"), world.dofs("cube.top")]

    def update(t: float) -> None:
        u.x.array.reshape(-1, 3)[ends[1], 2] = -(1 - part) * t

    bcs = [fem.dirichletbc(u, dofs.astype(np.int32)) for dofs in ends]
    stepper = world.stepper([], 0.05, nts.QuasiStatic, bcs=bcs, update=update)
    return Setup(stepper, 1.0, ledger=True, supported=True)


def explicit(comm: MPI.Comm, speed: float, h: float = 0.002) -> Setup:
    """Ball strikes a plate by central differences. Collective."""
    parts = {
        "ball": ball(0.5, 0.1, cells=4).at(0.03, 0.02, 0.52).flying(0, 0.5 * speed, -speed),
        "plate": box((2, 2, 0.25), (7, 7, 1)).at(-1, -1, -0.25),
    }
    touch = Touch("ball.outer", "plate.top", {"enforcement": nts.Penalty()})
    return Setup(World(comm, parts).stepper([touch], h, nts.CentralDifference), 0.4, ledger=True)


_CUBE, _CORNER = cube(0.5, 3).at(0.03, 0.02, 0.04), cube(0.5, 2, "corner").at(0.03, 0.02, 0.04)
_FINE = plate(2.0, 6)
CASES = [
    *(
        Case("ball on plate, turned", "rotation", name, partial(impact, frame=Frame(turn)))
        for name, turn in _TURNS.items()
    ),
    *(
        Case(
            "cube on its corner, turned",
            "rotation",
            name,
            partial(falls, upper=_CORNER, lower=_FINE, frame=Frame(turn)),
        )
        for name, turn in _TURNS.items()
    ),
    *(
        Case("ball on plate", "all lengths times", a, partial(impact, frame=Frame(length=a)))
        for a in _LENGTHS
    ),
    *(
        Case(
            f"cube on plate, {law}",
            "all lengths times",
            a,
            partial(falls, upper=_CUBE, lower=_FINE, law=_LAWS[law], frame=Frame(length=a)),
        )
        for law in ("plastic", "penalty")
        for a in _LENGTHS
    ),
    *(
        Case(
            f"cube on plate, degree 2, {cell}",
            "stands on",
            pose,
            partial(
                falls,
                upper=cube(0.5, 1, pose).at(0.03, 0.02, 0.04),
                lower=plate(2.0, 3),
                cell=cell,
                degree=2,
            ),
        )
        for cell in ("hexahedron", "tetrahedron")
        for pose in ("corner", "edge", "face")
    ),
    *(
        Case(
            "cube on plate, two half passes",
            "cells of plate : of cube",
            f"{s}:{n}",
            partial(
                falls,
                upper=cube(0.8, n).at(0.01, 0.02, 0.05),
                lower=plate(2.0, s),
                law=nts.Penalty(),
                both=True,
            ),
        )
        for s, n in ((1, 6), (4, 4), (16, 1))
    ),
    *(Case("ring folds onto itself", "law", law, partial(folded, law=law)) for law in _LAWS),
    *(
        Case("hard punch on a soft block", "depth", d, partial(pressed, depth=d))
        for d in (0.05, 0.2, 0.5)
    ),
    *(
        Case(
            "hard punch on a soft block, depth 0.2",
            "elements",
            f"{cell}, degree {k}",
            partial(pressed, depth=0.2, cell=cell, degree=k),
        )
        for cell, k in (("tetrahedron", 1), ("hexahedron", 2), ("tetrahedron", 2))
    ),
    *(
        Case("neo-Hookean cube", "height left", p, partial(squashed, part=p))
        for p in (0.5, 0.2, 0.1)
    ),
    *(
        Case(
            "St. Venant-Kirchhoff cube",
            "height left",
            p,
            partial(squashed, part=p, kind=nts.SaintVenantKirchhoff),
            stops,
        )
        for p, stops in ((0.5, None), (0.2, CRUSHED))
    ),
    *(
        Case(
            "neo-Hookean ball on plate, h = 0.001",
            "speed",
            v,
            partial(impact, speed=v, h=0.001, num_steps=int(240 / v), kind=nts.NeoHookean),
        )
        for v in (5.0, 10.0, 20.0)
    ),
    *(
        Case("ball on plate, central differences", "speed", v, partial(explicit, speed=v))
        for v in (0.1, 1.0, 3.0)
    ),
    Case(
        "ball on plate, central differences",
        "h",
        0.05,
        partial(explicit, speed=1.0, h=0.05),
        UNSTABLE,
        cuts=0,
    ),
]
