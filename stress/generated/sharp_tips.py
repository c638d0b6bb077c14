"""Sharp wedges and pyramids pressed into a block or thrown at it, whichever side gives nodes."""

from functools import partial
from itertools import product

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from stress.generated.case import Case
from stress.generated.judge import Array, Ints
from stress.generated.scene import Scene, grid

__all__ = ["CASES"]

_E = 2e5  # Pa
_FLANKS = (20, 45, 60, 75)  # degrees
_CELLS = (4, 8)  # per edge of the block of 1 m
# Depth of the tip below facets [-]: before a vertex is held, relative to facets; and between facets
# and the smooth patches of statics, relative to the depth of the dent.
_DEPTH, _DEPTH_OF_PATCHES = 0.02, 1 / 8
# Depth of tips with springs relative to facets [-]. They sink in by 5/3 of the compression of a
# cell, and below a point cells are compressed most.
_DEPTH_OF_SPRINGS = 0.35
# Relative error of the work of the trapezoidal rule and of the depth before a vertex is held.
_WORK = 0.1
_DT, _STEPS, _SPEED = 5e-3, 60, 0.5  # s, -, m/s


def _scene(rng: np.random.Generator, dim: int, flank: float, cells: int, gap: float) -> Scene:
    """Block, and a stiff body with its tip at the bottom, somewhere above the middle."""
    flat, middle = (0.0,) * (dim - 1), rng.uniform(0.4, 0.6, dim - 1)
    block = grid((*flat, -0.5), (*(1.0 for _ in flat), 0.5), (*(cells for _ in flat), cells // 2))
    tool = grid((*(-0.1 for _ in flat), 0.0), (*(0.2 for _ in flat), 0.2), (*(2 for _ in flat), 2))
    slope = np.tan(np.radians(flank))

    def sharp(*x: Array) -> tuple[Array, ...]:
        part = x[-1] / 0.2
        rise = slope * np.max(np.abs(x[:-1]), axis=0) * (1 - part) + (0.2 + 0.1 * slope) * part
        return (*(s + m for s, m in zip(x[:-1], middle, strict=True)), rise + gap)

    materials = {
        "block": nts.NeoHookean(E=_E, nu=0.0, rho=1e3),
        "tool": nts.NeoHookean(E=1e3 * _E, nu=0.0, rho=1e3),
    }
    return Scene({"block": block, "tool": tool.moved(sharp)}, materials, simplices=True)


def _pair(scene: Scene, side: str, method: str) -> nts.ContactPair:
    sides = [scene.surface(name) for name in (side, "tool" if side == "block" else "block")]
    if method in ("default", "explicit"):
        return nts.ContactPair(*sides)
    return nts.ContactPair(*sides, nts.LagrangeMultiplier(), method=method)


def _tip_depth(scene: Scene, x: Array) -> float:
    """Depth of the tip below the surface of the block [m]."""
    own = scene.nodes("tool")
    tip = own[scene.X[own, -1].argmin()]
    return float(scene.boundary("block").depth(x, x[[tip]])[0])


def _strain_energy(X: Array, x: Array, cells: Ints) -> float:
    """Energy of simplices of a neo-Hookean material with Poisson's ratio 0 [J]."""
    before, now = (np.swapaxes(p[cells[:, 1:]] - p[cells[:, :1]], 1, 2) for p in (X, x))
    F = now @ np.linalg.inv(before)
    dim = X.shape[1]
    volume = np.abs(np.linalg.det(before)) / (2 if dim == 2 else 6)
    density = (F**2).sum(axis=(1, 2)) - dim - 2 * np.log(np.linalg.det(F))
    return float(volume @ density) * _E / 4


def _static(
    rng: np.random.Generator, dim: int, flank: float, cells: int, side: str, method: str
) -> str:
    """The work of the force is the strain energy of the block, and the tip stays outside."""
    scene = _scene(rng, dim, flank, cells, 0.0)
    travel, num_steps = rng.uniform(0.2, 0.6) / cells, 8
    drive = fem.Constant(scene.V.mesh, np.zeros(dim))

    def update(t: float) -> None:
        drive.value[-1] = -travel * t

    held = [
        scene.held("block", lambda x: np.isclose(x[-1], -0.5)),
        scene.held("tool", None, drive),
    ]
    bodies, pairs = list(scene.bodies.values()), [_pair(scene, side, method)]
    stepper = nts.QuasiStatic(bodies, pairs, dt=1 / num_steps, bcs=held, update=update)
    before, last, work = scene.positions(stepper), 0.0, 0.0
    for step in stepper.run(until=1.0):
        below, above = (reaction.force[-1] for reaction in step.reactions)
        if abs(below + above) > 1e-3 * abs(above) + 1e-6:
            return f"reactions {below:.5g} and {above:.5g} N"
        work += travel * step.dt * (last - above) / 2
        last = -above
        limit = _DEPTH / cells + _DEPTH_OF_PATCHES * travel * step.t
        if (depth := _tip_depth(scene, scene.positions(stepper))) > limit:
            return f"tip {depth * cells:.3f} of a facet deep at t = {step.t:.2f}"
    energy = _strain_energy(before, scene.positions(stepper), scene.cells_of("block"))
    if abs(work - energy) > _WORK * energy:
        return f"work {work:.4g} J, strain energy {energy:.4g} J"
    return ""


def _dynamic(
    rng: np.random.Generator, dim: int, flank: float, cells: int, side: str, method: str
) -> str:
    """The tip bounces off without sinking in deeper than the law allows."""
    scene = _scene(rng, dim, flank, cells, 1e-3)
    held = [scene.held("block", lambda x: np.isclose(x[-1], -0.5))]
    bodies, pairs = list(scene.bodies.values()), [_pair(scene, side, method)]
    stepper: nts.EnergyMomentum | nts.CentralDifference
    if method == "explicit":
        stepper = nts.CentralDifference(bodies, pairs, bcs=held)
    else:
        stepper = nts.EnergyMomentum(bodies, pairs, dt=_DT, bcs=held)
    speed = np.zeros(dim)
    speed[-1] = -_SPEED
    stepper.set_velocity(scene.bodies["tool"], speed)
    limit = _DEPTH_OF_SPRINGS / cells
    if method not in ("default", "explicit"):
        limit = _DEPTH / cells + _SPEED * _DT
    own, before = scene.nodes("tool"), scene.positions(stepper)
    for number in range(1, _STEPS + 1):
        *_, step = stepper.run(until=number * _DT)
        now = scene.positions(stepper)
        if (depth := _tip_depth(scene, now)) > limit:
            return f"tip {depth * cells:.3f} of a facet deep at t = {step.t:.3f}"
    fall = (before - now)[own, -1].mean()
    if fall > 0.8 * _SPEED * _DT * _STEPS:
        return f"the tool has moved by {fall:.3f} m, almost as without contact"
    return ""


CASES = [
    Case(
        f"sharp tip, {name}, {method}",
        f"tip-{name}-{dim}d-{method}-nodes-of-{side}-flank{flank}-n{cells}",
        partial(function, dim=dim, flank=flank, cells=cells, side=side, method=method),
    )
    for (name, function, methods) in (
        ("statics", _static, ("node-to-segment", "default")),
        ("dynamics", _dynamic, ("node-to-segment", "mortar", "default", "explicit")),
    )
    for method, dim, flank, cells, side in product(
        methods, (2, 3), _FLANKS, _CELLS, ("block", "tool")
    )
]
