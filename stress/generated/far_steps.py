"""Steps that move bodies by up to several facets before they touch, in statics and dynamics."""

from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any

import numpy as np

import dolfinx_nts as nts
from stress.generated.case import Case
from stress.generated.checks import Obstacle, Touching, unbalanced
from stress.generated.judge import Array, column_force
from stress.generated.scene import Grid, Scene, grid

__all__ = ["CASES"]

_H = 0.25  # facet [m]
_HEIGHT = 8 * _H
_RHO, _E = 1e3, 1e6  # kg/m^3, Pa
# So stiff that waves, 1 km/s, are some times as fast as the bodies, and a step.
_E_MOVING, _DT = 1e9, 0.01  # Pa, s
_GAPS = (0.1, 0.3, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0)  # facets
TARGETS = ("plane", "sphere", "surface", "pair", "reverse", "mortar", "self", "edges")
# Loads relative to the load at first contact: below and above it.
_LOADS = (0.7, 1.3, 3.0)
# Motion of a body in one step without contact [facets].
_WAYS = (0.4, 1.5, 6.0)


class _Column:
    """A column with its bottom at height 0, above its contact partner.

    Args:
        target: One of `TARGETS`.
        gap: Between both [m].
        modulus: Young's modulus [Pa].
        moving: Whether impact is judged.

    Attributes:
        scene: The scene.
        pairs: Contact pairs.
        held: Support of the block, where there is one.
        touching: Judge.
    """

    def __init__(self, target: str, gap: float, modulus: float, moving: bool = False) -> None:
        """Make bodies, pairs and the judge."""
        self.dim = 3 if target in ("surface", "edges") else 2
        self.side = _H if self.dim == 3 else 2 * _H
        sides = (self.side,) * (self.dim - 1)
        low = -gap - 2 * _H
        has_block = target in ("pair", "reverse", "mortar", "self")
        cells = tuple(round(side / _H) for side in sides)
        grids = {"column": grid((0,) * self.dim, (*sides, _HEIGHT), (*cells, 8))}
        if has_block:
            # Nodes of the block keep the bottom of the column flat, as the closed form assumes.
            across = 16 if target == "reverse" else 4
            grids["block"] = grid((-0.6 * _H, low), (4 * _H, 2 * _H), (across, 2))
        if target == "self":
            grids = {"column": grids["column"].joined(grids["block"])}
        elif target == "edges":
            grids = {"column": _prism(0.0), "block": _prism(-gap, across=True)}
        material = nts.NeoHookean(E=modulus, nu=0.0, rho=_RHO)
        self.scene = scene = Scene(grids, material)
        self.held, segments = [], None
        if target == "self":
            self.held.append(scene.held("column", lambda x: x[1] < -gap / 2))
        elif has_block or target == "edges":
            self.held.append(scene.held("block"))
        is_whole = target in ("self", "edges")
        nodes = scene.surface("column", None if is_whole else _at(0.0))
        body = scene.boundary("column", lambda x: x[-1] > -gap / 2)
        if target == "self":
            segments = nodes
            other = scene.boundary("column", lambda x: x[-1] < -gap / 2)
        elif target == "edges":
            segments = scene.surface("block")
            other = scene.boundary("block")
        elif has_block:
            segments, other = scene.surface("block", _at(-gap)), scene.boundary("block")
        else:
            segments, other = self._obstacle(target, gap)
        self._gap, self._column = gap, body
        if target == "reverse":
            nodes, segments, body, other = segments, nodes, other, body
        self.nodes = nodes
        if target == "mortar":
            self.pairs = [
                nts.ContactPair(
                    nodes, segments, method="mortar", enforcement=nts.LagrangeMultiplier()
                )
            ]
        else:
            self.pairs = [
                nts.ContactPair(
                    nodes, segments, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
                )
            ]
        if target == "edges":
            self.pairs.append(
                nts.ContactPair(
                    nodes, segments, method="edge-to-edge", enforcement=nts.LagrangeMultiplier()
                )
            )
        self.touching = Touching(body, other, _H, modulus, target == "mortar", moving)

    def _obstacle(self, target: str, gap: float) -> tuple[Any, Obstacle]:
        if target == "sphere":
            centre, radius = np.array([_H, -gap - 4 * _H]), 4 * _H
            return nts.RigidSphere(centre, radius), Obstacle(
                lambda p: np.linalg.norm(p - centre, axis=1) - radius
            )
        flat = Obstacle(lambda p: p[:, -1] + gap)
        if target == "plane":
            zero = (0.0,) * (self.dim - 1)
            return nts.RigidPlane((*zero, -gap), (*zero, 1.0)), flat
        x = np.linspace(-2 * _H, 3 * _H, 4)
        points = np.stack([*np.meshgrid(x, x), np.full((4, 4), -gap)], axis=-1).reshape(-1, 3)
        ids = np.arange(16).reshape(4, 4)
        facets = np.stack([ids[:-1, :-1], ids[:-1, 1:], ids[1:, :-1], ids[1:, 1:]], axis=-1)
        return nts.RigidSurface(points, facets.reshape(-1, 4), (0, 0, 99)), flat

    def passed(self, x: Array, allowed: float) -> str:
        """Report that the middle of the column is below its contact partner, or return ""."""
        depth = -self._gap - float((self._column.weights @ x)[:, -1].mean()) - allowed
        return f"the column has passed by {depth / _H:.3g} facets" if depth > 0 else ""

    def forces(self, target: str) -> tuple[Any, Any] | None:
        """Column nodes with multipliers, and their values; None if other nodes have multipliers."""
        if target in ("self", "edges"):
            return None
        return self.nodes.nodes, self.pairs[0].history.lambda_N


def _at(height: float) -> Callable[[Any], Any]:
    return lambda x: np.isclose(x[-1], height)


def _prism(top: float, across: bool = False) -> Grid:
    """Square prism with its lowest edge at height 0, or across it, with its highest at ``top``."""
    bar = grid((0, -_H, -_H), (4 * _H, 2 * _H, 2 * _H), (3, 2, 2))
    root = np.sqrt(0.5)

    def turned(x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
        y, z = root * (y - z), root * (y + z)
        if across:
            return y + 1.9 * _H, x - 2.1 * _H, z + top - 2 * root * _H
        return x, y, z + 2 * root * _H

    return bar.moved(turned)


def _static(rng: np.random.Generator, target: str, gap: float, load: float) -> str:
    """One step of a column, the bottom of which is pulled down by a load."""
    gap *= _H * rng.uniform(0.95, 1.05)
    column = _Column(target, gap, _E)
    scene, held = column.scene, list(column.held)
    down = (0.0,) * (column.dim - 1)
    loads: list[Any] = []
    first = force = 0.0
    if target == "edges":
        # The ends of the bar go down.
        way = load * gap if load < 1 else gap + 0.1 * load * _H
        ends = lambda x: np.isclose(np.abs(x[0] - 2 * _H), 2 * _H)  # noqa: E731
        held.append(scene.held("column", ends, (*down, -way)))
    else:
        area = column.side ** (column.dim - 1)
        first = column_force((_HEIGHT + gap) / _HEIGHT, _E, area)
        force = load * first
        held.append(scene.held("column", _at(_HEIGHT)))
        bottom = scene.surface("column", _at(0.0))
        loads.append(nts.Traction(bottom, (*down, -force / area)))
    bodies = list(scene.bodies.values())
    stepper = nts.QuasiStatic(bodies, column.pairs, dt=1.0, bcs=held, loads=loads)
    before = scene.positions(stepper)
    step = stepper.advance()
    x = scene.positions(stepper)
    wrong = column.touching.wrong(before, x, column.forces(target)) or column.passed(x, 0.0)
    if wrong or target == "edges":
        return wrong
    # Force of the pair on its nodes, which for `reverse` are those of the block.
    contact = column.pairs[0].history.force[:, column.dim - 1].sum()
    contact *= -1 if target == "reverse" else 1
    wrong = unbalanced([[step.reactions[-1].force[-1]], [contact], [-force]], force)
    expected = max(force - first, 0.0)
    # Nodes of the block press on single points of the bottom, which bends.
    tolerance = 2e-3 if target == "reverse" else 1e-4
    if wrong or target == "sphere" or abs(contact - expected) < tolerance * force:
        return wrong
    return f"contact force {contact:.6g} N, {expected:.6g} N expected"


def _dynamic(rng: np.random.Generator, target: str, gap: float, way: float, how: str) -> str:
    """A column that is thrown, or falls from rest, with a given motion in the first step."""
    gap *= _H * rng.uniform(0.95, 1.05)
    way *= _H * rng.uniform(0.95, 1.05)
    column = _Column(target, gap, _E_MOVING, moving=True)
    scene = column.scene
    bodies = list(scene.bodies.values())
    down, loads = (0.0,) * (column.dim - 1), []
    if how == "falls":
        loads.append(nts.Gravity(bodies, (*down, -2 * way / _DT**2)))
    stepper = nts.EnergyMomentum(bodies, column.pairs, dt=_DT, bcs=column.held, loads=loads)
    if how == "thrown":

        def velocity(x: Any) -> Any:
            v = np.zeros((column.dim, x.shape[1]))
            v[-1] = np.where(x[column.dim - 1] > -gap / 2, -way / _DT, 0.0)
            return v

        stepper.set_velocity(scene.bodies["column"], velocity)
    before = scene.positions(stepper)
    free = way
    for _ in range(int(np.ceil(gap / way)) + 2):
        stepper.advance()
        x = scene.positions(stepper)
        wrong = column.touching.wrong(before, x, column.forces(target), free)
        wrong = wrong or column.passed(x, free / 2)
        if wrong:
            return f"{wrong} at t = {stepper.t:.3g} s"
        # Elastic impact keeps the speed, and gravity adds the same in each step.
        free = float(np.abs(x - before).max()) + (2 * way if how == "falls" else 0.0)
        before = x
    return ""


CASES = [
    *(
        Case(
            f"far step, statics, {target}",
            f"far-static-{target}-gap{gap}-load{load}",
            partial(_static, target=target, gap=gap, load=load),
        )
        for target, gap, load in product(TARGETS, _GAPS, _LOADS)
    ),
    *(
        Case(
            f"far step, dynamics, {target}",
            f"far-{how}-{target}-gap{gap}-way{way}",
            partial(_dynamic, target=target, gap=gap, way=way, how=how),
        )
        for target, gap, way, how in product(TARGETS, _GAPS, _WAYS, ("thrown", "falls"))
        if (how == "thrown" or gap in _GAPS[::3]) and (gap < 2 or way > 1)
    ),
]
