"""A hollow ball strikes a free plate: a sweep of each parameter far beyond usual values."""

from functools import partial
from typing import Any

from mpi4py import MPI

import dolfinx_nts as nts
from stress.parts import ball, box
from stress.rows import CRUSHED, Case, Setup, above
from stress.world import Frame, Touch, World

__all__ = ["CASES"]

_RADIUS, _GAP = 0.5, 0.02
# Elements may be stiff enough, but a step is too long.
THROUGH = "pass through"


def impact(
    comm: MPI.Comm,
    *,
    h: float = 0.01,
    speed: float = 1.0,
    E: float = 1e5,
    rho: float = 1e3,
    E_ratio: float = 1.0,
    rho_ratio: float = 1.0,
    nu: float = 0.4,
    wall: float = 0.2,
    num_steps: int = 60,
    kind: Any = nts.SaintVenantKirchhoff,
    frame: Frame | None = None,
) -> Setup:
    """Ball above a plate of 2 x 2 x 0.25; ratios are ball to plate.

    Args:
        comm: Communicator.
        h: Step [s].
        speed: Of the ball, down and to the side [m/s].
        rho: Density of the ball [kg/m^3].
        E: Young's modulus of the softer body [Pa].
        E_ratio: Ratio of Young's moduli.
        rho_ratio: Ratio of the densities.
        nu: Poisson's ratio of both.
        wall: Thickness of the ball's wall, relative to its radius.
        num_steps: Number of steps.
        kind: Kind of material of both.
        frame: How the scene is seen.
    """
    rubber = kind(E * max(1.0, E_ratio), nu, rho)
    ground = kind(E / min(1.0, E_ratio), nu, rho / rho_ratio)
    shell = ball(_RADIUS, wall * _RADIUS, cells=4)
    parts = {
        "ball": shell.at(0.03, 0.02, _RADIUS + _GAP).made(rubber, (0.0, 0.5 * speed, -speed)),
        "plate": box((2, 2, 0.25), (7, 7, 1)).at(-1, -1, -0.25).made(ground),
    }
    world = World(comm, parts, frame=frame)
    stepper = world.stepper([Touch("ball.outer", "plate.top")], dt=h)
    check = above(stepper, *stepper.bodies, up=world.frame.turn[:, 2])
    return Setup(stepper, num_steps * stepper.dt, check)


def _cases(
    name: str,
    values: dict[Any, str | None],
    scene: str = "ball on plate",
    cuts: int = 6,
    **others: Any,
) -> list[Case]:
    return [
        Case(scene, name, value, partial(impact, **{name: value}, **others), stops, cuts=cuts)
        for value, stops in values.items()
    ]


CASES = [
    *_cases("h", dict.fromkeys((0.001, 0.003, 0.01, 0.03, 0.1))),
    *_cases("speed", {0.1: None, 0.5: None, 1.0: None, 2.0: None, 5.0: CRUSHED}),
    *_cases(
        "speed",
        {3.0: None, 5.0: CRUSHED, 10.0: CRUSHED, 20.0: CRUSHED, 50.0: CRUSHED},
        scene="ball on plate, h = 0.001",
        h=0.001,
        num_steps=120,
    ),
    *_cases(
        "speed",
        {5.0: None, 20.0: None, 50.0: None},
        scene="stiff ball on plate, h = 0.1",
        h=0.1,
        E=1e9,
        num_steps=2,
    ),
    *_cases(
        "speed",
        {5.0: None, 50.0: THROUGH},
        scene="stiff ball on plate, steps as they are, h = 0.1",
        cuts=0,
        h=0.1,
        E=1e9,
    ),
    *_cases("rho", dict.fromkeys((1.0, 10.0, 100.0, 1e3, 1e4))),
    *_cases("E_ratio", dict.fromkeys((1e-4, 1e-2, 1e2, 1e4))),
    *_cases("rho_ratio", dict.fromkeys((1e-4, 1e-2, 1e2, 1e4))),
    *_cases("nu", dict.fromkeys((0.0, 0.3, 0.45, 0.49, 0.499))),
    *_cases("wall", dict.fromkeys((0.25, 0.1, 0.05, 0.025))),
]
