"""Impacts: rods, balls, a rigid mass, cubes with edges, and a pile."""

from collections.abc import Callable
from itertools import combinations, product
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from benchmarks.defaults.settings import Setting
from benchmarks.scenes import Scene
from dolfinx_nts.meshing.parts import add_box, add_solid_ball

__all__ = [
    "ball_on_block",
    "balls_of_revolution",
    "cubes",
    "mass_on_rod",
    "pile",
    "rod_on_wall",
    "rods",
]

Floats = np.ndarray[Any, np.dtype[np.float64]]
_COMM = MPI.COMM_SELF
# Rods in units of E = rho = c = 1: length, side, speed.
_LENGTH, _SIDE, _SPEED = 1.0, 0.1, 1e-3
# Interval of the plateau of the force between two reflections, in units of L/c.
_PLATEAUS = ((0.1, 0.9), (1.1, 1.9))
# Ball, and block below it [SI].
BALL = {"radius": 0.5, "gap": 0.005, "speed": 1.0, "height": 0.4, "width": 1.6}
BALL_END = 0.68
# Balls of revolution in dimensionless units: flattening, Poisson's ratio.
_FLAT, _NU = 1e-3, 0.3


class Series:
    """Values of each step.

    Args:
        stepper: The stepper.
        values: Returns values of the present step.
    """

    def __init__(self, stepper: Any, values: Callable[[], Any]) -> None:
        self._stepper, self._values = stepper, values
        self._times: list[float] = []
        self._rows: list[Any] = []

    def record(self) -> None:
        """Append the values of a step."""
        self._times.append(self._stepper.t)
        self._rows.append(self._values())

    @property
    def times(self) -> Floats:
        """Ends of the steps, shape ``(s,)`` [s]."""
        return np.array(self._times)

    @property
    def rows(self) -> Floats:
        """Values of the steps, shape ``(s, ...)``."""
        return np.array(self._rows)


def _rods(
    setting: Setting, num_cells: int, courant: float, ratio: int
) -> tuple[Any, list[nts.Body], nts.Diagnostics]:
    """Make a rod that strikes a resting rod ``ratio`` times as long, a rigid plane if it is 0."""

    def build(model: Any) -> None:
        for name, low, length in (("struck", -ratio * _LENGTH, ratio), ("striker", 0.0, 1)):
            if length:
                size, cells = (_SIDE, _SIDE, length * _LENGTH), (1, 1, length * num_cells)
                add_box(model, name, corner=(0.0, 0.0, low), size=size, cells=cells)

    mesh, cells, facets, tag = nts.read_mesh(build, _COMM)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.SaintVenantKirchhoff(E=1.0, nu=0.0, rho=1.0)
    names = ["striker", "struck"] if ratio else ["striker"]
    bodies = [nts.Body(V, cells, tag[name], material) for name in names]
    segments: nts.Surface | nts.Obstacle = nts.RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    if ratio:
        segments = nts.Surface(V, facets, tag["struck_top"])
    pair = setting.pair(nts.Surface(V, facets, tag["striker_bottom"]), segments)
    stepper = nts.EnergyMomentum(bodies, [pair], dt=courant * _LENGTH / num_cells)
    stepper.set_velocity(bodies[0], (0.0, 0.0, -_SPEED))
    return stepper, bodies, nts.Diagnostics(stepper)


def _plateau(forces: Series, dt: float, expected: float) -> float:
    """Root mean square of the difference from the plateau, relative to it [-]."""
    middle = forces.times - dt / 2
    within = np.any([(middle > a) & (middle < b) for a, b in _PLATEAUS], axis=0)
    return float(np.sqrt(np.mean((forces.rows[within] / expected - 1) ** 2)))


def rods(setting: Setting, *, num_cells: int, courant: float) -> Scene:
    """Rod that strikes a rod of twice its length (St. Venant's problem).

    The force is rho c v A/2 until the wave of the short rod returns at 2 L/c, and with it the
    rods part with half of the speed.

    Args:
        setting: Contact.
        num_cells: Cells along the short rod.
        courant: Cells that a wave crosses in a step.
    """
    stepper, (short, long), diagnostics = _rods(setting, num_cells, courant, 2)
    forces = Series(stepper, lambda: float(diagnostics.contact_force()[2]))

    def judge() -> dict[str, float]:
        parting = diagnostics.body_velocity(short)[2] - diagnostics.body_velocity(long)[2]
        return {
            "force on the plateau": _plateau(forces, stepper.dt, _SPEED * _SIDE**2 / 2),
            "restitution": abs(float(parting) / _SPEED - 0.5),
        }

    return Scene(stepper, long, judge, forces.record, t_end=2.6 * _LENGTH)


def rod_on_wall(setting: Setting) -> Scene:
    """Rod that strikes a rigid plane: force rho c v A until 2 L/c, rebound with its speed."""
    stepper, (rod,), diagnostics = _rods(setting, 40, 0.5, 0)
    forces = Series(stepper, lambda: float(diagnostics.contact_force()[2]))

    def judge() -> dict[str, float]:
        rebound = float(diagnostics.body_velocity(rod)[2]) / _SPEED
        return {
            "force on the plateau": _plateau(forces, stepper.dt, _SPEED * _SIDE**2),
            "rebound": abs(rebound - 1),
        }

    return Scene(stepper, rod, judge, forces.record, t_end=2.4 * _LENGTH)


def mass_on_rod(setting: Setting) -> Scene:
    """Rigid mass on a clamped rod of the same mass: force rho c v A exp(-c t/L) until 2 L/c."""
    num_cells, side = 40, _SIDE

    def build(model: Any) -> None:
        size, high = (side, side, _LENGTH), 2.5 * side
        add_box(model, "rod", corner=(0, 0, 0), size=size, cells=(1, 1, num_cells))
        corner, mass = (-0.5 * side, -0.5 * side, _LENGTH + 1e-9), (2 * side, 2 * side, high)
        add_box(model, "mass", corner=corner, size=mass, cells=(1, 1, 1))

    mesh, cells, facets, tag = nts.read_mesh(build, _COMM)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rod = nts.Body(V, cells, tag["rod"], nts.SaintVenantKirchhoff(E=1.0, nu=0.0, rho=1.0))
    mass = nts.RigidBody(V, cells, tag["mass"], _LENGTH / (10 * side))
    sides = (nts.Surface(V, facets, tag[name]) for name in ("rod_top", "mass_bottom"))
    foot = fem.locate_dofs_topological(V, 2, facets.find(tag["rod_bottom"]))
    clamp = fem.dirichletbc(np.zeros(3), foot, V)
    dt = 0.5 * _LENGTH / num_cells
    stepper = nts.EnergyMomentum([rod, mass], [setting.pair(*sides)], dt=dt, bcs=[clamp])
    stepper.set_velocity(mass, (0.0, 0.0, -_SPEED))
    diagnostics = nts.Diagnostics(stepper)
    forces = Series(stepper, lambda: -float(diagnostics.contact_force()[2]))

    def judge() -> dict[str, float]:
        middle = forces.times - dt / 2
        within, expected = (middle > 0.1) & (middle < 1.9), np.exp(-middle)
        error = forces.rows / (_SPEED * side**2) - expected
        velocity = float(diagnostics.body_velocity(mass)[2]) / _SPEED
        return {
            "force": float(np.sqrt(np.mean(error[within] ** 2))),
            "velocity": abs(velocity + np.exp(-1.9)),
        }

    return Scene(stepper, rod, judge, forces.record, t_end=1.9 * _LENGTH)


def ball_on_block(
    setting: Setting, *, n: int = 6, dt: float = 0.01, cell: str = "hexahedron", degree: int = 1
) -> Scene:
    """Solid ball of rubber that strikes a block on a smooth floor.

    Args:
        setting: Contact.
        n: Cells along an edge of the ball.
        dt: Step [s].
        cell: Kind of cells.
        degree: Of the displacements.
    """
    radius, width, height = BALL["radius"], BALL["width"], BALL["height"]
    # Not at the middle of the block, so that no symmetry of the mesh prevents lateral motion.
    centre = np.array([0.031, 0.017, radius + BALL["gap"]])

    def build(model: Any) -> None:
        shape = {"centre": centre, "radius": radius, "cells_per_edge": n, "layers": n // 3}
        add_solid_ball(model, "ball", **shape, cell=cell)
        corner, size = (-width / 2, -width / 2, -height), (width, width, height)
        cells = (2 * n - 1, 2 * n - 1, n // 2)
        add_box(model, "block", corner=corner, size=size, cells=cells, cell=cell)

    mesh, cells, facets, tag = nts.read_mesh(build, _COMM)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    rubber = nts.NeoHookean(E=1e5, nu=0.3, rho=1e3)
    ball, block = (nts.Body(V, cells, tag[name], rubber) for name in ("ball", "block"))
    lower = nts.boundary_of(ball, where=lambda x: x[2] < radius)
    top = nts.Surface(V, facets, tag["block_top"])
    foot = fem.locate_dofs_topological(V, 2, facets.find(tag["block_bottom"]))
    held = fem.dirichletbc(np.zeros(3), foot, V)
    stepper = nts.EnergyMomentum([ball, block], [setting.pair(lower, top)], dt=dt, bcs=[held])
    stepper.set_velocity(ball, (0.0, 0.0, -BALL["speed"]))
    diagnostics = nts.Diagnostics(stepper)

    def values() -> tuple[float, float]:
        (contact,) = stepper.contacts
        force = float(diagnostics.contact_force()[2])
        return force, _roughness(stepper.x[contact.nodes.nodes], contact.pressure)

    steps = Series(stepper, values)

    def judge() -> dict[str, float]:
        velocity = diagnostics.body_velocity(ball) / BALL["speed"]
        force, roughness = steps.rows.T
        # Alternating multipliers are averaged, which preserves the peak of a smooth force.
        peak = np.convolve(force, [0.25, 0.5, 0.25], mode="valid").max()
        loaded = force > 0.5 * peak
        return {
            "rebound": float(velocity[2]),
            "sideways": float(np.linalg.norm(velocity[:2])),
            "roughness of the pressure": float(np.nanmean(roughness[loaded])),
            "peak force": float(peak),
        }

    return Scene(stepper, ball, judge, steps.record, t_end=BALL_END)


def _roughness(x: Floats, pressure: Floats) -> float:
    """Nodal pressure about a polynomial of degree 3 in r^2, rms relative to the largest [-]."""
    loaded = pressure > 0
    if loaded.sum() < 12:
        return np.nan
    centre = pressure @ x[:, :2] / pressure.sum()
    s = ((x[:, :2] - centre) ** 2).sum(axis=1)
    within = s < 0.7 * s[loaded].max()
    powers = np.vander(s[within] / s[within].max(), 4)
    fit = powers @ np.linalg.lstsq(powers, pressure[within], rcond=None)[0]
    return float(np.sqrt(np.mean((pressure[within] - fit) ** 2)) / fit.max())


def balls_of_revolution(setting: Setting, *, plane: bool) -> Scene:
    """Ball that strikes a plane or an equal ball so slowly that Hertz' theory holds.

    Johnson, Contact Mechanics, chapter 11.

    Args:
        setting: Contact.
        plane: Whether the ball strikes a rigid plane.
    """
    radii = [1.0] if plane else [1.0, 1.5]
    mesh, cells, _, tag = nts.read_mesh(lambda model: _add_discs(model, radii), _COMM)
    nts.axisymmetric(mesh)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    material = nts.SaintVenantKirchhoff(1.0, _NU, 1.0)
    bodies = [nts.Body(V, cells, tag[n], material) for n in ("upper", "lower")[: len(radii)]]
    near = [nts.boundary_of(body, where=lambda x: np.abs(x[1]) < 0.1) for body in bodies]
    pair = setting.pair(near[0], nts.RigidPlane((0.0, 0.0), (0.0, 1.0)) if plane else near[1])
    # Combined values of both bodies: radius, modulus E*, mass, and approach.
    radius = 1 / sum(1 / r for r in radii)
    modulus, flat = 1 / (1 - _NU**2) / len(radii), _FLAT / radius
    mass = 1 / sum(3 / (4 * np.pi * r**3) for r in radii)
    stiffness = 4 / 3 * modulus * np.sqrt(radius)
    speed = np.sqrt(4 / 5 * stiffness * flat**2.5 / mass)
    duration = 2.9432 * flat / speed
    stepper = nts.EnergyMomentum(bodies, [pair], dt=duration / 50)
    stepper.set_velocity(bodies[0], (0.0, -speed))
    diagnostics = nts.Diagnostics(stepper)
    forces = Series(stepper, lambda: abs(float(diagnostics.contact_force()[0])))

    def judge() -> dict[str, float]:
        smooth = np.convolve(forces.rows, [0.25, 0.5, 0.25], mode="valid")
        impulse = forces.rows.sum() * stepper.dt
        expected = stiffness * flat**1.5
        rough = np.abs(np.diff(forces.rows, 2)).mean() / 4 / expected
        return {
            "largest force": abs(float(smooth.max()) / expected - 1),
            "impulse": abs(float(impulse / (2 * mass * speed)) - 1),
            "alternation of the force": float(rough),
        }

    return Scene(stepper, bodies[0], judge, forces.record, t_end=1.3 * duration)


def _add_discs(model: Any, radii: list[float]) -> None:
    """Add halves of discs on y = 0, the second one below, finer near the origin. Local."""
    occ, size = model.occ, np.sqrt(_FLAT) / 6
    for name, radius in zip(("upper", "lower"), radii, strict=False):
        disc = occ.addDisk(0, radius if name == "upper" else -radius, 0, radius, radius)
        right = occ.addRectangle(0, -4, 0, 4, 8)
        ((_, face),), _ = occ.intersect([(2, disc)], [(2, right)])
        occ.synchronize()
        model.addPhysicalGroup(2, [face], name=name)
    field = model.mesh.field.add("MathEval")
    away = f"Max(0, Sqrt(x*x + y*y) - {9 * size})"
    model.mesh.field.setString(field, "F", f"Min(0.25, {size} + 0.25 * {away})")
    model.mesh.field.setAsBackgroundMesh(field)
    model.mesh.generate(2)


def cubes(setting: Setting) -> Scene:
    """Two cubes that strike each other with crossed edges, and tumble away."""

    def build(model: Any) -> None:
        for name, z in (("lower", 0.0), ("upper", 3.0)):
            shape = {"size": (1.0, 1.0, 1.0), "cells": (3, 3, 3)}
            add_box(model, name, corner=(-0.5, -0.5, z - 0.5), **shape)

    mesh, cells, _, tag = nts.read_mesh(build, _COMM)
    X, is_up, root = mesh.geometry.x, mesh.geometry.x[:, 2] > 1.5, np.sqrt(0.5)
    X[is_up, 2] -= 3.0
    # Cubes stand on edges, along x and y.
    lower = np.array([[1, 0, 0], [0, root, -root], [0, root, root]])
    upper, above = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ lower, (0.17, 0.12, 1.43421)
    X[~is_up], X[is_up] = X[~is_up] @ lower.T, X[is_up] @ upper.T + above
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.NeoHookean(E=2e4, nu=0.3, rho=10.0)
    bodies = [nts.Body(V, cells, tag[name], material) for name in ("upper", "lower")]
    pairs = nts.all_pairs(
        bodies, enforcement=setting.enforcement, method=setting.method, edges=True
    )
    stepper = nts.EnergyMomentum(bodies, pairs, dt=0.004)
    stepper.set_velocity(bodies[0], (0.1, -0.05, -1.0))
    nodes = [np.unique(V.dofmap.list[body.cells]) for body in bodies]
    x = V.tabulate_dof_coordinates()
    local = [(x[nodes[0]] - above) @ upper, x[nodes[1]] @ lower]
    overlaps = Series(stepper, lambda: _deepest([stepper.x[some] for some in nodes], local))

    def judge() -> dict[str, float]:
        return {"overlap": float(overlaps.rows.max())}

    return Scene(stepper, bodies[0], judge, overlaps.record, t_end=0.4)


def _deepest(x: list[Floats], local: list[Floats]) -> float:
    """Depth of the deepest point of an edge of either unit cube in the other one [m].

    Each cube is an affine image of the unit cube; ``local`` are its nodes there (-1/2 to 1/2).
    """
    corners = np.array(list(product((-0.5, 0.5), repeat=3)))
    ends = [(a, b) for a, b in combinations(corners, 2) if np.count_nonzero(a - b) == 1]
    edges = np.concatenate([np.linspace(a, b, 21) for a, b in ends])
    maps = [
        np.linalg.lstsq(np.c_[start, np.ones(len(start))], now, rcond=None)[0]
        for now, start in zip(x, local, strict=True)
    ]
    depth = 0.0
    for one, other in (maps, maps[::-1]):
        points = (edges @ one[:3] + one[3] - other[3]) @ np.linalg.inv(other[:3])
        depth = max(depth, float((0.5 - np.abs(points).max(axis=1)).max()))
    return depth


def pile(setting: Setting) -> Scene:
    """Eight soft balls that fall into a box: energy error, and overlap of the bodies."""
    radius, distance, places = 0.1, 0.201, list(product((0, 1), repeat=3))

    def build(model: Any) -> None:
        for number, (i, j, k) in enumerate(places):
            centre = (distance * i + 0.02 * k, distance * j - 0.01 * k, distance * k + radius)
            shape = {"centre": centre, "radius": radius, "cells_per_edge": 3, "layers": 1}
            add_solid_ball(model, f"ball {number}", **shape)

    mesh, cells, _, tag = nts.read_mesh(build, _COMM)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.NeoHookean(1e5, 0.3, 1e3)
    balls = [nts.Body(V, cells, tag[f"ball {number}"], rubber) for number in range(len(places))]
    floor = nts.RigidPlane((0.0, 0.0, -1e-3), (0.0, 0.0, 1.0))
    pairs = nts.all_pairs(
        balls, obstacles=[floor], enforcement=setting.enforcement, method=setting.method
    )
    stepper = nts.EnergyMomentum(balls, pairs, dt=0.002, loads=[nts.Gravity(balls, (0, 0, -9.81))])
    for ball in balls:
        stepper.set_velocity(ball, (0.2, 0.1, -1.0))
    diagnostics = nts.Diagnostics(stepper)
    start = diagnostics.linear_momentum()
    mass = sum(body.mass for body in diagnostics.bodies().values())

    def judge() -> dict[str, float]:
        depth = max((overlap.depth for overlap in diagnostics.overlaps()), default=0.0)
        sideways = np.abs((diagnostics.linear_momentum() - start)[:2]).max()
        return {"overlap": float(depth) / radius, "momentum aside": float(sideways) / mass}

    return Scene(stepper, balls[0], judge, t_end=0.1)
