"""Contact of whole boundaries of closed bodies: no body passes through another."""

from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from stress.parts import Part, ball, box, rotation
from stress.rows import Case, Setup
from stress.world import NODAL, World

__all__ = ["CASES", "RANDOM"]

_NOTHING: dict[str, Any] = {}
_PLASTIC: dict[str, Any] = {"enforcement": nts.LagrangeMultiplier("plastic")}
_SPRINGS: dict[str, Any] = {"enforcement": nts.Penalty()}
_DISSIPATIVE = [_PLASTIC, _SPRINGS]
_LAWS = {"elastic": _NOTHING, "plastic": _PLASTIC, "springs": _SPRINGS}
_AT_RANDOM = [
    nts.EnergyMomentum,
    nts.EnergyMomentum,
    nts.Midpoint,
    nts.GeneralizedAlpha,
    nts.CentralDifference,
]
_THICKNESS = 0.1
_OBSTACLES = {
    "sphere": nts.RigidSphere((0, 0, -_THICKNESS / 2), _THICKNESS / 2),
    "cylinder": nts.RigidCylinder((0, 0, -_THICKNESS / 2), (0, 1, 0), _THICKNESS / 2),
}


def flush(comm: MPI.Comm, cells: int, layers: int | None = None) -> Setup:
    """Cube that falls on a cube of the same width, or a slice of both. Collective."""
    depth, num_deep = (1.0, cells) if layers is None else (0.25, layers)
    rubber = nts.NeoHookean(1e5, 0.3, 1e3)
    low = box((1, depth, 1), (3, min(num_deep, 3), 3)).made(rubber)
    top = box((1, depth, 1), (cells, num_deep, cells)).at(0, 0, 1.02).made(rubber, (0, 0, -1))
    world = World(comm, {"low": low, "top": top})
    held = fem.dirichletbc(np.zeros(3), world.dofs("low.bottom"), world.V)
    pairs = nts.all_pairs([world.bodies["top"], world.bodies["low"]], **NODAL)
    stepper = world.stepper([], 5e-3, pairs=pairs, bcs=[held])
    return Setup(stepper, 0.4, _bounces(stepper, world.bodies["top"]), supported=True)


def through(comm: MPI.Comm, ratio: float, how: dict[str, Any]) -> Setup:
    """Block that moves several plate thicknesses in the step of its impact. Collective."""
    speed, dt = ratio * _THICKNESS / 1e-3, 1e-3
    stone = nts.NeoHookean(1e3 * (20 * speed) ** 2, 0.3, 1e3)
    plate = box((0.5, 0.5, _THICKNESS), (3, 3, 2)).at(-0.25, -0.25, -_THICKNESS).made(stone)
    block = box((0.2, 0.2, 0.2), (2, 2, 2)).at(-0.1, -0.1, 0.02).made(stone, (0, 0, -speed))
    world = World(comm, {"plate": plate, "block": block})
    held = fem.dirichletbc(np.zeros(3), world.dofs("plate.left+plate.right"), world.V)
    pairs = nts.all_pairs(list(world.bodies.values()), **(NODAL | how))
    stepper = world.stepper([], dt, pairs=pairs, bcs=[held])
    until = (5 + 0.4 / (ratio * _THICKNESS)) * dt
    check = _bounces(stepper, world.bodies["block"])
    return Setup(stepper, until, check, ledger=True, supported=True)


def obstacle(comm: MPI.Comm, name: str, ratio: float) -> Setup:
    """Block that flies at a round obstacle as thick as a plate. Collective."""
    speed = ratio * _THICKNESS / 1e-3
    stone = nts.NeoHookean(1e3 * (20 * speed) ** 2, 0.3, 1e3)
    block = box((0.2, 0.2, 0.2), (4, 4, 4)).at(-0.1, -0.1, 0.02).made(stone, (0, 0, -speed))
    world = World(comm, {"block": block})
    pairs = nts.all_pairs(list(world.bodies.values()), obstacles=[_OBSTACLES[name]], **NODAL)
    stepper = world.stepper([], 1e-3, pairs=pairs)
    until = (5 + 0.4 / (ratio * _THICKNESS)) * 1e-3
    return Setup(stepper, until, _bounces(stepper, world.bodies["block"]))


def bullet(comm: MPI.Comm, stiffer: float) -> Setup:
    """Small block that falls on facets longer than itself. Collective."""
    soft, stiff = nts.NeoHookean(1e6, 0.3, 1e3), nts.NeoHookean(1e6 * stiffer, 0.3, 7.8e3)
    plate = box((1, 1, 0.3), (3, 3, 2)).at(-0.5, -0.5, -0.3).made(soft)
    block = box((0.2, 0.2, 0.2), (2, 2, 2)).at(-0.1, -0.1, 0.02).made(stiff, (0, 0, -3))
    world = World(comm, {"plate": plate, "block": block})
    pairs = nts.all_pairs(list(world.bodies.values()), **NODAL)
    stepper = world.stepper([], 2e-3, pairs=pairs)
    plate_body, diagnostics = world.bodies["plate"], nts.Diagnostics(stepper)

    def above() -> str:
        heights = [diagnostics.centre_of_mass(b)[2] for b in (plate_body, world.bodies["block"])]
        return "" if heights[1] > heights[0] else f"centres of plate and block at {heights}"

    return Setup(stepper, 0.1, above)


def random(comm: MPI.Comm, seed: int) -> Setup:
    """Two or three bodies of any size, turned at random, that fly at each other. Collective."""
    rng = np.random.default_rng(seed)
    parts: dict[str, Part] = {}
    for number in range(rng.integers(2, 4)):
        size, cells = rng.uniform(0.2, 0.6, 3), rng.integers(1, 4, 3)
        shape = box(tuple(size), tuple(cells)).at(*(-size / 2))
        if rng.random() < 0.3:
            shape = ball(size[0] / 2, size[0] / 4, cells=int(cells[0]) + 1)
        far = 1.2 * number * np.array([1.0, 0, 0]) + rng.uniform(-0.15, 0.15, 3)
        turned = shape.turned(rotation(rng.normal(size=3), rng.uniform(0, 3))).at(*far)
        material = nts.NeoHookean(10 ** rng.uniform(5, 6.5), rng.uniform(0.1, 0.45), 1e3)
        velocity = (-2.0 * number, *rng.uniform(-0.2, 0.2, 2))
        parts[f"body {number}"] = turned.made(material, velocity)
    world, scheme = World(comm, parts), _AT_RANDOM[rng.integers(len(_AT_RANDOM))]
    laws = _DISSIPATIVE if scheme is nts.GeneralizedAlpha else [_NOTHING, *_DISSIPATIVE]
    how = _SPRINGS if scheme is nts.CentralDifference else laws[rng.integers(len(laws))]
    if rng.random() < 0.4:
        how = how | {"friction": nts.Coulomb(0.3)}
    dt = None if scheme is nts.CentralDifference else 0.01 * 2 ** rng.uniform(-1, 2)
    pairs = nts.all_pairs(list(world.bodies.values()), **(NODAL | how))
    stepper = world.stepper([], dt, scheme, pairs=pairs)
    # The generalised-alpha method does not conserve the angular momentum.
    return Setup(stepper, 0.6, ledger=True, supported=scheme is nts.GeneralizedAlpha)


def _bounces(stepper: Any, body: nts.Body) -> Any:
    """Check that a body that came down flies up, and not to the side. Collective."""
    diagnostics = nts.Diagnostics(stepper)

    def check() -> str:
        velocity = diagnostics.body_velocity(body)
        aside = np.abs(velocity[:2]).max()
        return "" if velocity[2] > max(0.0, 10 * aside) else f"velocity {velocity}"

    return check


RANDOM = [
    Case("random bodies", "seed", seed, partial(random, seed=seed), may_stop=True)
    for seed in range(200)
]
CASES = [
    *(Case("flush cubes", "cells", n, partial(flush, cells=n)) for n in (2, 3, 4)),
    Case("flush slices", "cells", 4, partial(flush, cells=4, layers=1)),
    *(
        Case(
            f"block through a plate, {law}",
            "thicknesses in a step",
            ratio,
            partial(through, ratio=ratio, how=how),
        )
        for law, how in _LAWS.items()
        for ratio in (0.3, 1.5, 10.0)
    ),
    *(
        Case(
            f"block at a {name}",
            "thicknesses in a step",
            ratio,
            partial(obstacle, name=name, ratio=ratio),
        )
        for name in _OBSTACLES
        for ratio in (0.3, 3.0, 30.0)
    ),
    *(
        Case("small block on long facets", "times as stiff", s, partial(bullet, stiffer=s))
        for s in (1.0, 100.0, 2e5)
    ),
]
