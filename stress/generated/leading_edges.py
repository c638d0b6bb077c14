"""Blocks with leading edges of 75 to 150 degrees that slide over a floor."""

from functools import partial
from itertools import product

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from stress.generated.case import Case
from stress.generated.judge import nodal_mass
from stress.generated.scene import Grid, Scene, grid

__all__ = ["CASES", "TOLERANCE"]

# Difference of T/N from the coefficient of friction [-]: the floor tilts under the block by about
# this angle, and hat functions in mortar contact give 0.49 to 0.53 at 0.5.
TOLERANCE = 0.06
_H, _E = 0.25, 2e5  # m, Pa
_ANGLES = (75, 90, 95, 105, 120, 135, 150)
_G = 2.0  # m/s^2
_DT, _STEPS, _LAST, _SPEED = 1e-2, 30, 4, 1.0  # s, -, -, m/s


def _scene(rng: np.random.Generator, dim: int, angle: float, rho: float, gap: float) -> Scene:
    """Floor, and a block that leans forward."""
    x0 = _H * (2 + rng.uniform(0.1, 0.9))
    middle = (0.0,) * (dim - 2)
    floor = grid(
        (0, *middle, -2 * _H),
        (12 * _H, *(3 * _H for _ in middle), 2 * _H),
        (12, *(2 for _ in middle), 2),
    )
    block = grid(
        (x0, *(0.4 * _H for _ in middle), gap),
        (3 * _H, *(2 * _H for _ in middle), 2 * _H),
        (3, *(1 for _ in middle), 2),
    )

    def leaning(*x: np.ndarray) -> tuple[np.ndarray, ...]:
        return (x[0] + np.tan(np.radians(angle - 90)) * (x[-1] - gap), *x[1:])

    grids: dict[str, Grid] = {"floor": floor, "block": block.moved(leaning)}
    return Scene(grids, nts.NeoHookean(E=_E, nu=0.3, rho=rho))


def _pair(scene: Scene, mu: float, method: str) -> nts.ContactPair:
    """Contact of the floor's nodes with the block, with the package's own choice or a method."""
    friction = nts.Coulomb(mu) if mu else None
    sides = scene.surface("floor"), scene.surface("block")
    if method == "default":
        return nts.ContactPair(*sides, friction=friction)
    return nts.ContactPair(*sides, nts.LagrangeMultiplier("plastic"), friction, method)


def _static(rng: np.random.Generator, dim: int, angle: float, mu: float, method: str) -> str:
    """Press and slide; the ratio of the reactions is the coefficient of friction."""
    scene = _scene(rng, dim, angle, 1.0, 0.0)
    pair = _pair(scene, mu, method)
    lead = fem.Constant(scene.V.mesh, np.zeros(dim))

    def update(t: float) -> None:
        lead.value[0] = _H * max(t - 0.2, 0) / 0.8
        lead.value[-1] = -0.005 * min(t, 0.2) / 0.2

    held = [
        scene.held("floor", lambda x: np.isclose(x[-1], -2 * _H)),
        scene.held("block", lambda x: np.isclose(x[-1], 2 * _H), lead),
    ]
    bodies = list(scene.bodies.values())
    stepper = nts.QuasiStatic(bodies, [pair], dt=0.1, bcs=held, update=update)
    worst = mu
    for step in stepper.run(until=1.0):
        force = step.reactions[1].force
        if force[-1] >= 0:
            return f"no force presses the block at t = {step.t:.1f}"
        ratio = -force[0] / force[-1]
        if step.t > 0.55 and abs(ratio - mu) > abs(worst - mu):
            worst = ratio
    return f"T/N = {worst:.3f}, {mu} expected" if abs(worst - mu) > TOLERANCE else ""


def _dynamic(rng: np.random.Generator, dim: int, angle: float, mu: float, method: str) -> str:
    """Throw the block along the floor; the ratio of momenta is the coefficient of friction."""
    scene = _scene(rng, dim, angle, 1e3, 1e-4)
    pair = _pair(scene, mu, method)
    floor, block = scene.bodies.values()
    held = [scene.held("floor", lambda x: np.isclose(x[-1], -2 * _H))]
    gravity = np.zeros(dim)
    gravity[-1] = -_G
    loads = [nts.Gravity([block], gravity)]
    stepper = nts.EnergyMomentum([floor, block], [pair], dt=_DT, bcs=held, loads=loads)
    speed = np.zeros(dim)
    speed[0] = _SPEED
    stepper.set_velocity(block, speed)
    mass = nodal_mass(scene.X, scene.cells_of("block"))
    mass /= mass.sum()
    centre = []
    for _ in range(_STEPS):
        stepper.advance()
        centre.append(mass @ scene.positions(stepper))
    # Mean velocities of the last steps, which are the velocities at their midpoints.
    velocity = (centre[-1] - centre[-1 - _LAST]) / (_LAST * _DT)
    change = velocity - speed - gravity * _DT * (_STEPS - _LAST / 2)
    ratio = -change[0] / change[-1]
    return f"T/N = {ratio:.3f}, {mu} expected" if abs(ratio - mu) > TOLERANCE else ""


CASES = [
    Case(
        f"leading edge, {name}, {method}",
        f"edge-{name}-{dim}d-{method}-{angle}-mu{mu}",
        partial(function, dim=dim, angle=angle, mu=mu, method=method),
    )
    for (name, function), method, dim, angle, mu in product(
        (("statics", _static), ("dynamics", _dynamic)),
        ("node-to-segment", "mortar", "default"),
        (2, 3),
        _ANGLES,
        (0.0, 0.5),
    )
]
