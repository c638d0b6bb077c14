"""Chamfered blocks on flat ones: the kink of the segments lies anywhere inside a facet."""

from functools import partial
from itertools import product

import numpy as np

import dolfinx_nts as nts
from stress.generated.case import Case
from stress.generated.checks import FORCE, Touching
from stress.generated.judge import Array
from stress.generated.scene import Grid, Scene, from_axes, grid

__all__ = ["CASES"]

# Facets of the base are 1 m long.
_E = 1e6
_MATERIAL = nts.NeoHookean(E=_E, nu=0.3, rho=1e3)
_PLACES = tuple(range(9))
_SLOPES = (0.1, 0.3, 1.0)
# Dimension, simplices, degree.
_ELEMENTS = {
    "quadrilaterals": (2, False, 1),
    "quadrilaterals2": (2, False, 2),
    "triangles2": (2, True, 2),
    "hexahedra": (3, False, 1),
    "hexahedra2": (3, False, 2),
    "tetrahedra": (3, True, 1),
    "tetrahedra2": (3, True, 2),
}
# Gap under the sole that counts as zero, relative to the indentation [-].
_OPENING = 0.25
_HEIGHT, _SPEED, _DT = 0.02, 1.0, 0.002  # m, m/s, s


def _block(dim: int, kink: float, slope: float, height: float) -> Grid:
    """Block with its sole at a height and a chamfer on its right."""
    axes = [kink - 2 + np.array([0.0, 1.05, 2.0, 3.0]), np.array([0.0, 0.8, 1.6])]
    if dim == 3:
        axes.insert(1, np.array([0.2, 1.1]))

    def chamfered(*x: Array) -> tuple[Array, ...]:
        rise = slope * np.maximum(x[0] - kink, 0)
        return (*x[:-1], height + rise + x[-1] * (1.6 - rise) / 1.6)

    return from_axes(*axes).moved(chamfered)


def _kink(rng: np.random.Generator, element: str, place: int, slope: float, what: str) -> str:
    """Judge a block that touches at rest, is pressed or flies."""
    dim, simplices, degree = _ELEMENTS[element]
    slope *= rng.uniform(0.9, 1.1)
    kink = 3.0 + (place + rng.uniform(0.3, 0.7)) / 9
    if place == 0:
        kink = 3.0
    flat, deep = ((0.0,) * (dim - 1), (1.5,) * (dim - 2))
    base = grid((*flat, -1), (5, *deep, 1), (5, *(2 for _ in deep), 1))
    height = _HEIGHT * rng.uniform(0.8, 1.2) if what == "impact" else 0.0
    grids = {"base": base, "block": _block(dim, kink, slope, height)}
    scene = Scene(grids, _MATERIAL, simplices, degree)
    nodes = scene.surface("base", lambda x: np.isclose(x[-1], 0))

    def is_sole(x: Array) -> Array:
        return np.isclose(x[-1], height + slope * np.maximum(x[0] - kink, 0))

    segments = scene.surface("block", is_sole)
    pair = nts.ContactPair(nodes, segments, method="mortar", enforcement=nts.LagrangeMultiplier())
    boundaries = scene.boundary("base"), scene.boundary("block")
    touching = Touching(*boundaries, 1.0, _E, mortar=True, moving=what == "impact")
    held = [scene.held("base", lambda x: np.isclose(x[-1], -1))]
    bodies = list(scene.bodies.values())
    if what == "impact":
        return _impact(scene, pair, nts.EnergyMomentum(bodies, [pair], dt=_DT, bcs=held), height)
    down = 0.02 * rng.uniform(0.5, 1.5) if what == "pressed" else 0.0
    top = scene.held("block", lambda x: np.isclose(x[-1], 1.6), (*flat, -down))
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=[*held, top])
    before = scene.positions(stepper)
    stepper.advance()
    force = pair.history.lambda_N
    if what == "rests":
        total = np.abs(force).sum()
        return f"force {total:.4g} N, and none is right" if total > FORCE * _E else ""
    x = scene.positions(stepper)
    # The sole stays in contact, for any position of the nodes of the base below it.
    under = scene.X[nodes.nodes]
    is_under = (under[:, 0] > kink - 1.9) & (under[:, 0] < kink - 0.1)
    if dim == 3:
        is_under &= np.abs(under[:, 1] - 0.65) < 0.35
    there = x[nodes.nodes[is_under]]
    inside = boundaries[1].depth(x, there) > 0
    opening = np.where(inside, 0, boundaries[1].distance(x, there)).max() / down
    if opening > _OPENING:
        return f"the sole is open by {opening:.2f} of the indentation"
    return touching.wrong(before, x, (nodes.nodes, force))


def _impact(scene: Scene, pair: nts.ContactPair, stepper: nts.EnergyMomentum, height: float) -> str:
    """Judge the first force on a block that flies down."""
    block = scene.bodies["block"]
    stepper.set_velocity(block, (0.0,) * (scene.dim - 1) + (-_SPEED,))
    own = scene.nodes("block")
    for _ in range(int(height / (_SPEED * _DT)) + 2):
        before = scene.positions(stepper)[own, -1].min()
        stepper.advance()
        force = np.abs(pair.history.lambda_N).sum()
        if force > FORCE * _E:
            # With mean gaps, surfaces may touch slightly before the last step of free flight ends.
            early = before - 1.5 * _SPEED * _DT
            return f"force {force:.4g} N at a height of {before:.3g} m" if early > 0 else ""
    return "no force after the surfaces have met"


CASES = [
    *(
        Case(
            f"mortar kink, {what}, {element}",
            f"kink-{what}-{element}-place{place}-slope{slope}",
            partial(_kink, element=element, place=place, slope=slope, what=what),
        )
        for what, element, place, slope in product(
            ("rests", "pressed", "impact"), _ELEMENTS, _PLACES, _SLOPES
        )
        if what == "rests" or slope == 0.3
    ),
]
