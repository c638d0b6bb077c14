"""Statics of bodies supported by contact alone, and of bodies under tools."""

from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from stress.parts import RUBBER, ball, box
from stress.rows import CRUSHED, Case, Setup
from stress.world import NODAL, Touch, World

__all__ = ["CASES"]

_WEIGHT, _SIDE = 9.81, 0.1  # of a block [N], its edge [m]


def rests(comm: MPI.Comm, mu: float, cell: str = "hexahedron") -> Setup:
    """A block of 1 kg in static equilibrium on a wider block. Collective."""
    rubber = nts.NeoHookean(1e6, 0.3, 1e3)
    low = box((3 * _SIDE, 3 * _SIDE, _SIDE), (6, 6, 2)).at(-_SIDE, -_SIDE, -_SIDE)
    parts = {"low": low.made(rubber), "top": box((_SIDE,) * 3, (4, 4, 4)).made(rubber)}
    world = World(comm, parts, cell)
    held = fem.dirichletbc(np.zeros(3), world.dofs("low.bottom").astype(np.int32), world.V)
    touch = Touch("top.bottom", "low.top", {"friction": nts.Coulomb(mu)} if mu else {})
    load = nts.Gravity([world.bodies["top"]], lambda t: (0, 0, -_WEIGHT * min(t / 0.5, 1.0)))
    pairs = [
        nts.ContactPair(*map(world.surface, (touch.nodes, touch.segments)), **(NODAL | touch.how))
    ]
    stepper = nts.QuasiStatic(list(world.bodies.values()), pairs, dt=0.25, bcs=[held], loads=[load])

    def check() -> str:
        force = nts.Diagnostics(stepper).contact_force()[2]
        return "" if abs(force / _WEIGHT - 1) < 1e-6 else f"contact holds {force:.6g} N"

    return Setup(stepper, 1.0, check, ledger=True, supported=True)


def irons(comm: MPI.Comm, scheme: Any, how: dict[str, Any]) -> Setup:
    """A punch of rubber that is pressed into a block, and dragged along it. Collective."""
    block = box((2, 0.8, 0.5), (12, 4, 3)).at(0, 0, -0.5).made(nts.NeoHookean(1e5, 0.3, 1e3))
    punch = box((0.4, 0.4, 0.2), (4, 4, 2)).at(0.2, 0.2, 1e-3).made(nts.NeoHookean(1e6, 0.3, 1e3))
    world = World(comm, {"block": block, "punch": punch})
    u = fem.Function(world.V)
    ends = [world.dofs(side).astype(np.int32) for side in ("block.bottom", "punch.top")]

    def update(t: float) -> None:
        down, along = min(4 * t, 1.0), max(t - 0.25, 0.0)
        u.x.array.reshape(-1, 3)[ends[1]] = 1.2 * along, 0, -0.06 * down

    bcs = [fem.dirichletbc(u, dofs) for dofs in ends]
    touch = Touch("punch.bottom", "block.top", {"friction": nts.Coulomb(0.3)} | how)
    stepper = world.stepper([touch], 0.0125, scheme, bcs=bcs, update=update)

    def check() -> str:
        along, aside, up = nts.Diagnostics(stepper).contact_force()
        # Friction, and the slope of the dent.
        held = abs(aside) < 0.02 * up and 0.25 * up < -along < 0.45 * up
        return "" if held else f"force {along:.3g}, {aside:.3g}, {up:.3g} N"

    return Setup(stepper, 1.0, check, ledger=True, supported=True)


def snaps(comm: MPI.Comm, speed: float) -> Setup:
    """A ball thrown at a shallow arch with clamped ends. Collective."""
    span, rise, thick = 2.0, 0.15, 0.04
    arch = box((span, 0.4, thick), (24, 3, 2)).at(-span / 2, -0.2, 0)
    arch = arch.moved(lambda x: (x[0], x[1], x[2] + rise * np.cos(np.pi * x[0] / span)))
    sphere = ball(0.15, 0.05, cells=3).at(0, 0, rise + thick + 0.16)
    heavy = nts.NeoHookean(1e6, 0.3, 5e3)
    world = World(comm, {"arch": arch.made(RUBBER), "ball": sphere.made(heavy, (0, 0, -speed))})
    held = fem.dirichletbc(
        np.zeros(3), world.dofs("arch.left+arch.right").astype(np.int32), world.V
    )
    touch = Touch("ball.outer", "arch.top")
    stepper = world.stepper([touch], 4e-3, bcs=[held])
    return Setup(stepper, 0.8, supported=True)


def squeezes(comm: MPI.Comm, way: float, h: float = 0.05, cells: int = 4) -> Setup:
    """A thick hollow ball between two hard walls that close. Collective."""
    soft, hard = nts.NeoHookean(1e5, 0.3, 1e3), nts.NeoHookean(1e7, 0.3, 1e3)
    wall = box((1.6, 1.6, 0.2), (5, 5, 1)).made(hard)
    parts = {
        "ball": ball(0.5, 0.3, cells=cells).made(soft),
        "low": wall.at(-0.8, -0.8, -0.72),
        "high": wall.at(-0.8, -0.8, 0.52),
    }
    world = World(comm, parts)
    u = fem.Function(world.V)
    ends = [world.dofs(side).astype(np.int32) for side in ("low.bottom", "high.top")]

    def update(t: float) -> None:
        for dofs, sign in zip(ends, (1, -1), strict=True):
            u.x.array.reshape(-1, 3)[dofs, 2] = sign * way * t

    bcs = [fem.dirichletbc(u, dofs) for dofs in ends]
    touches = [Touch("ball.outer", "low.top"), Touch("ball.outer", "high.bottom")]
    stepper = world.stepper(touches, h, bcs=bcs, update=update)
    return Setup(stepper, 1.0, ledger=True, supported=True)


_IRONS = (
    ("QuasiStatic", nts.QuasiStatic, {}),
    ("EnergyMomentum", nts.EnergyMomentum, {}),
    ("GeneralizedAlpha", nts.GeneralizedAlpha, {"enforcement": nts.LagrangeMultiplier("plastic")}),
)
CASES = [
    *(
        Case(f"block rests on a block, {cell}", "mu", mu, partial(rests, mu=mu, cell=cell))
        for cell in ("hexahedron", "tetrahedron")
        for mu in (0.05, 0.3, 1.0)
    ),
    *(
        # Non-matching facets of the dent cause a lateral force, which inertia relief carries.
        Case(
            f"block rests on a block, {cell}",
            "mu",
            0,
            partial(rests, mu=0.0, cell=cell),
            warns="only contact without friction holds",
            energy_error=1e-7,
        )
        for cell in ("hexahedron", "tetrahedron")
    ),
    *(
        Case("punch that irons a block", "scheme", name, partial(irons, scheme=scheme, how=how))
        for name, scheme, how in _IRONS
    ),
    *(
        Case("ball between walls", "way", w, partial(squeezes, way=w), may_stop=True)
        for w in (0.3, 0.4, 0.5)
    ),
    *(
        Case("ball on a shallow arch", "m/s", s, partial(snaps, speed=s), stops)
        for s, stops in ((1, None), (2, None), (3, CRUSHED))
    ),
]
