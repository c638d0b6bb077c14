"""Friction, weight and supports: bodies that must rest, and bodies that must slide."""

from collections.abc import Callable
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from stress.parts import RUBBER, Array, Part, ball, box, rotation
from stress.rows import CRUSHED, Case, Setup
from stress.world import Touch, World

__all__ = ["CASES"]

_G = 9.81
_STONE = nts.SaintVenantKirchhoff(E=1e7, nu=0.2, rho=2e3, stiffness_damping=2e-3)


def weight(t: float) -> tuple[float, float, float]:
    """Gravity that grows smoothly within half a second."""
    return 0.0, 0.0, -_G * min(t / 0.5, 1.0)


_FLOOR = nts.RigidPlane((0, 0, 0), (0, 0, 1))
_LAWS: dict[str, dict[str, Any]] = {
    "exact": {"friction": nts.Coulomb(0.5)},
    "tangential spring": {"friction": nts.Coulomb(0.5, eps_T=1e6)},
    "penalty": {"enforcement": nts.Penalty(1e6), "friction": nts.Coulomb(0.5, eps_T=1e6)},
}


def stays(
    stepper: Any, moved: float, least: float = 0.0, axes: tuple[int, ...] = (0, 1, 2)
) -> Callable[[], str]:
    """Check how far the centres of mass have moved. Collective.

    Args:
        stepper: The stepper.
        moved: Largest distance allowed [m].
        least: Least distance [m].
        axes: Coordinates that count.
    """
    diagnostics = nts.Diagnostics(stepper)

    def centres() -> Array:
        return np.array([diagnostics.centre_of_mass(b)[list(axes)] for b in stepper.bodies])

    start = centres()

    def check() -> str:
        way = float(np.linalg.norm(centres() - start, axis=1).max())
        return "" if least <= way <= moved else f"moved {way:.3g}, not {least:g} to {moved:g}"

    return check


def stack(comm: MPI.Comm, law: str, blocks: int = 5, until: float = 10.0) -> Setup:
    """Blocks upon each other, of different width, without motion. Collective."""
    parts, touches, below = {}, [], None
    for number in range(blocks):
        width, name = 0.4 * (1 - 0.075 * number * 5 / max(blocks, 5)), f"block {number}"
        block = box((width, width, 0.2), (2, 2, 1)).at(-width / 2, -width / 2, 0.2 * number)
        parts[name] = block.made(_STONE)
        under: Any = _FLOOR if below is None else f"{below}.top"
        touches.append(Touch(f"{name}.bottom", under, _LAWS[law]))
        below = name
    checks: list[Callable[[], str]] = []

    def check_rest(t: float) -> None:
        """Add a check that nothing moves in the second half of the run."""
        if t > until / 2 and len(checks) < 3:
            checks.append(stays(stepper, 1e-5))

    stepper = World(comm, parts).stepper(touches, 0.02, gravity=weight, update=check_rest)
    checks += [stays(stepper, 1e-6, axes=(0, 1)), stays(stepper, 0.02, axes=(2,))]

    def check() -> str:
        return next(filter(None, (check() for check in checks)), "")

    return Setup(stepper, until, check, ledger=True, supported=True)


def cards(comm: MPI.Comm, mu: float) -> Setup:
    """A card that leans against another, both 20 degrees from upright. Collective."""
    angle, height, thick = np.deg2rad(20.0), 0.6, 0.06
    # Inner faces at x = 0 before the rotation; the right card is lower.
    left = box((thick, 0.4, height), (1, 3, 6)).at(-thick, -0.2, 0)
    right = box((thick, 0.3, 0.8 * height), (1, 2, 5)).at(0, -0.16, 0)
    foot = 0.8 * height * np.sin(angle)
    left = left.turned(rotation((0, 1, 0), angle)).at(-foot - 1e-4, 0, 0)
    right = right.turned(rotation((0, 1, 0), -angle)).at(foot + 1e-4, 0, 0)
    # Each stands on its outer edge, or on the inner one.
    parts = {
        name: card.at(0, 0, -card.X[:, 2].min()).made(_STONE)
        for name, card in (("left", left), ("right", right))
    }
    how = {"friction": nts.Coulomb(mu, eps_T=1e6)}
    touches = [Touch(f"{name}.bottom", _FLOOR, how) for name in parts]
    touches.append(Touch("right.left", "left.right", how))
    stepper = World(comm, parts).stepper(touches, 0.01, gravity=weight)
    check = stays(stepper, 0.01) if mu > 0.4 else stays(stepper, 10.0, 0.1)
    return Setup(stepper, 1.5, check, ledger=True, supported=True)


def slope(comm: MPI.Comm, part: float) -> Setup:
    """Block on a slope of 20 degrees, mu a part of the tangent. Collective."""
    angle = np.deg2rad(20.0)
    weight = _G * np.array([np.sin(angle), 0, -np.cos(angle)])
    block = box((0.5, 0.4, 0.15), (3, 2, 1)).made(_STONE)
    touch = Touch("block.bottom", _FLOOR, {"friction": nts.Coulomb(part * np.tan(angle))})
    stepper = World(comm, {"block": block}).stepper([touch], 0.01)
    body = stepper.bodies[0]
    # It grows, so that the block is pressed before it slides.
    load = nts.Gravity([body], lambda t: weight * min(t / 0.3, 1.0))
    stepper = type(stepper)(stepper.bodies, stepper.pairs, dt=0.01, loads=[load])
    way = max(0.0, _G * (np.sin(angle) - part * np.tan(angle) * np.cos(angle)) / 2)
    check = stays(stepper, 1e-3) if part > 1 else stays(stepper, way, 0.2 * way)
    # Exactly at the friction angle vibration would decide.
    check = stays(stepper, 0.05) if part == 1 else check
    return Setup(stepper, 1.0, check, ledger=True, supported=True)


def twisted(comm: MPI.Comm, degrees: float) -> Setup:
    """Bar, clamped at one end and twisted at the other. Collective."""
    world = World(comm, {"bar": box((0.2, 0.2, 1.0), (3, 3, 12)).at(-0.1, -0.1, 0).made(RUBBER)})
    V = world.V
    u = fem.Function(V)
    ends = [world.dofs("bar.bottom"), world.dofs("bar.top")]
    X = V.tabulate_dof_coordinates()[ends[1]]

    def update(t: float) -> None:
        Q = rotation((0, 0, 1), np.deg2rad(degrees) * t)
        u.x.array.reshape(-1, 3)[ends[1]] = X @ (Q - np.eye(3)).T

    bcs = [fem.dirichletbc(u, dofs.astype(np.int32)) for dofs in ends]
    stepper = world.stepper([], 0.01, bcs=bcs, update=update)
    return Setup(stepper, 1.0, ledger=True, supported=True)


def spinning(comm: MPI.Comm, spin: float) -> Setup:
    """Ball that is dropped on the floor while it spins. Collective."""
    centre = np.array([0, 0, 0.35])

    def velocity(x: Array) -> Array:
        return np.cross([0, spin, 0.3 * spin], x.T - centre).T

    part: Part = ball(0.3, 0.1, cells=4).at(*centre).made(RUBBER, velocity)
    touch = Touch("ball.outer", _FLOOR, {"friction": nts.Coulomb(0.3)})
    stepper = World(comm, {"ball": part}).stepper([touch], 0.01, gravity=(0, 0, -_G))
    # It rolls away in the direction of its spin.
    check = stays(stepper, 10.0, 0.01 * spin, axes=(0,))
    return Setup(stepper, 1.0, check, ledger=True, supported=True)


CASES = [
    *(
        Case("stack of five blocks, 10 s", "friction", law, partial(stack, law=law))
        for law in _LAWS
    ),
    *(
        Case("stack of blocks, 5 s", "blocks", n, partial(stack, law="exact", blocks=n, until=5.0))
        for n in (8, 15)
    ),
    *(Case("card house", "mu", mu, partial(cards, mu=mu)) for mu in (0.1, 0.6)),
    *(Case("block on a slope", "mu / tan", p, partial(slope, part=p)) for p in (0.9, 1.0, 1.1)),
    *(
        Case("bar twisted", "degrees", d, partial(twisted, degrees=d), stops)
        for d, stops in ((90, None), (360, None), (720, CRUSHED))
    ),
    *(
        Case("spinning ball on the floor", "rad/s", s, partial(spinning, spin=s), stops)
        for s, stops in ((2, None), (5, None), (20, CRUSHED))
    ),
]
