"""Equilibria, rest and sliding: Hertz, Lame, dragged and clamped blocks, a stack."""

from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from benchmarks.defaults.impacts import Floats, Series
from benchmarks.defaults.settings import Setting
from benchmarks.scenes import Scene
from dolfinx_nts.meshing.parts import add_box, add_rectangle

__all__ = [
    "braking_block",
    "dragged_block",
    "held_block",
    "line_contact",
    "paraboloid",
    "shrink_fit",
    "sphere_in_block",
    "stack",
    "surface_of_both",
]

_COMM = MPI.COMM_SELF
_WITHIN = 0.8  # Fraction of the contact radius within which pressures are compared [-].


def _held(V: fem.FunctionSpace, where: Any, value: Any, axis: int | None = None) -> Any:
    """Prescribe displacements, or their component along an axis, at nodes. Local."""
    if axis is None:
        return fem.dirichletbc(value, fem.locate_dofs_geometrical(V, where), V)
    space, _ = V.sub(axis).collapse()
    dofs = fem.locate_dofs_geometrical((V.sub(axis), space), where)
    function = value if isinstance(value, fem.Function) else fem.Function(space)
    return fem.dirichletbc(function, dofs, V.sub(axis))


def _at(axis: int, place: float) -> Any:
    """Whether points lie on a plane across an axis."""
    return lambda x: np.isclose(x[axis], place, atol=1e-9)


def _pressed(stepper: Any, radius: float, modulus: float, dim: int) -> dict[str, float]:
    """Rms error of nodal pressures against Hertz at the same force, relative to the maximum [-].

    Johnson, Contact Mechanics, chapter 4.

    Args:
        stepper: Of half of a line contact, of a quarter of a point contact, or of a body of
            revolution.
        radius: Of both bodies together [m].
        modulus: Of both bodies together [Pa].
        dim: 2 for half of a line, 3 for a quarter, 0 for a body of revolution.
    """
    (contact,) = stepper.contacts
    force = -float(contact.history.lambda_N.sum()) * {0: 1, 2: 2, 3: 4}[dim]
    if dim == 2:
        a = np.sqrt(4 * force * radius / (np.pi * modulus))
        largest = 2 * force / (np.pi * a)
    else:
        a = (3 * force * radius / (4 * modulus)) ** (1 / 3)
        largest = 1.5 * force / (np.pi * a**2)
    r = np.linalg.norm(stepper.x[contact.nodes.nodes, : 2 if dim == 3 else 1], axis=1) / a
    within = r < _WITHIN
    errors = contact.pressure[within] / largest - np.sqrt(1 - r[within] ** 2)
    return {"pressure": float(np.sqrt(np.mean(errors**2)))}


def _graded(X: Floats) -> None:
    """Make cells smaller near the origin. Local."""
    X[:] = 0.8 * X**2.2 + 0.2 * X


def line_contact(setting: Setting, *, degree: int) -> Scene:
    """Half of a block with a parabolic lower face, pressed on another block in plane strain.

    Args:
        setting: Contact.
        degree: Of the displacements; cells of degree 2 are twice as large.
    """
    curvature, depth, ratio, zero = 4.0, 0.006, 0.3, np.zeros(2)

    def build(model: Any) -> None:
        for name, y, n in (("low", 0.0, 18 // degree), ("up", 2.0, 24 // degree)):
            add_rectangle(model, name, corner=(0.0, y), size=(1.0, 1.0), cells=(n, n))

    mesh, cells, facets, tag = nts.read_mesh(build, _COMM)
    X, is_up = mesh.geometry.x[:, :2], mesh.geometry.x[:, 1] > 1.5
    X[is_up, 1] -= 2.0
    _graded(X)
    X[is_up, 1] += (1 - X[is_up, 1]) * X[is_up, 0] ** 2 / 2 / curvature
    X[~is_up, 1] *= -1
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    material = nts.SaintVenantKirchhoff(1.0, ratio, 1.0)
    bodies = [nts.Body(V, cells, tag[name], material) for name in ("up", "low")]
    sides = (nts.Surface(V, facets, tag[name]) for name in ("up_bottom", "low_bottom"))
    down = fem.Constant(mesh, zero)
    bcs = [_held(V, _at(1, 1.0), down), _held(V, _at(1, -1.0), zero), _held(V, _at(0, 0.0), 0, 0)]

    def update(t: float) -> None:
        down.value[1] = -depth * t

    stepper = nts.QuasiStatic(bodies, [setting.pair(*sides)], dt=0.25, bcs=bcs, update=update)
    modulus = 0.5 / (1 - ratio**2)

    def judge() -> dict[str, float]:
        return _pressed(stepper, curvature, modulus, 2)

    return Scene(stepper, bodies[0], judge, t_end=1.0)


def paraboloid(setting: Setting, *, cell: str, degree: int, n: int) -> Scene:
    """Quarter of a block with a paraboloid as lower face, pressed on another block.

    Args:
        setting: Contact.
        cell: Kind of cells.
        degree: Of the displacements.
        n: Cells along an edge of the upper block; the lower one has three quarters of them.
    """
    curvature, depth, ratio, zero = 4.0, 0.02, 0.3, np.zeros(3)

    def build(model: Any) -> None:
        for name, z, k in (("low", 0.0, 3 * n // 4), ("up", 2.0, n)):
            shape = {"size": (1.0, 1.0, 1.0), "cells": (k, k, max(3, k // 2)), "cell": cell}
            add_box(model, name, corner=(0.0, 0.0, z), **shape)

    mesh, cells, facets, tag = nts.read_mesh(build, _COMM)
    X, is_up = mesh.geometry.x, mesh.geometry.x[:, 2] > 1.5
    X[is_up, 2] -= 2.0
    _graded(X)
    X[is_up, 2] += (1 - X[is_up, 2]) * (X[is_up, :2] ** 2).sum(axis=1) / 2 / curvature
    X[~is_up, 2] *= -1
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    material = nts.SaintVenantKirchhoff(1.0, ratio, 1.0)
    bodies = [nts.Body(V, cells, tag[name], material) for name in ("up", "low")]
    sides = (nts.Surface(V, facets, tag[name]) for name in ("up_bottom", "low_bottom"))
    down = fem.Constant(mesh, zero)
    bcs = [_held(V, _at(2, 1.0), down), _held(V, _at(2, -1.0), zero)]
    bcs += [_held(V, _at(axis, 0.0), 0, axis) for axis in (0, 1)]

    def update(t: float) -> None:
        down.value[2] = -depth * t

    stepper = nts.QuasiStatic(bodies, [setting.pair(*sides)], dt=0.5, bcs=bcs, update=update)
    modulus = 0.5 / (1 - ratio**2)

    def judge() -> dict[str, float]:
        return _pressed(stepper, curvature, modulus, 3)

    return Scene(stepper, bodies[0], judge, t_end=1.0)


def sphere_in_block(setting: Setting) -> Scene:
    """Rigid sphere that is pressed into a cylinder: a body of revolution and an obstacle."""
    radius, depth, ratio, n, zero = 4.0, 0.006, 0.3, 24, np.zeros(2)

    def build(model: Any) -> None:
        add_rectangle(model, "block", corner=(0.0, 0.0), size=(1.0, 1.0), cells=(n, n))

    mesh, cells, facets, tag = nts.read_mesh(build, _COMM)
    X = mesh.geometry.x[:, :2]
    _graded(X)
    X[:, 1] *= -1
    nts.axisymmetric(mesh)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    block = nts.Body(V, cells, tag["block"], nts.SaintVenantKirchhoff(1.0, ratio, 1.0))
    sphere = nts.RigidSphere(centre=(0.0, radius), radius=radius)
    sphere = sphere.moving(nts.Motion(translation=lambda t: (0.0, -depth * t)))
    pair = setting.pair(nts.Surface(V, facets, tag["block_bottom"]), sphere)
    held = _held(V, _at(1, -1.0), zero)
    stepper = nts.QuasiStatic([block], [pair], dt=0.25, bcs=[held])

    def judge() -> dict[str, float]:
        return _pressed(stepper, radius, 1 / (1 - ratio**2), 0)

    return Scene(stepper, block, judge, t_end=1.0)


def surface_of_both(setting: Setting) -> Scene:
    """Two blocks of one surface that touches itself, pressed between plates: uniform pressure."""
    E, strain, zero = 1.0, 1e-3, np.zeros(2)

    def build(model: Any) -> None:
        for name, y, n in (("low", -1.0, 6), ("up", 0.0, 8)):
            add_rectangle(model, name, corner=(0.0, y), size=(1.0, 1.0), cells=(n, n // 2))

    mesh, cells, _, tag = nts.read_mesh(build, _COMM)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    material = nts.SaintVenantKirchhoff(E, 0.0, 1.0)
    bodies = [nts.Body(V, cells, tag[name], material) for name in ("up", "low")]
    both = nts.boundary_of(*bodies, where=lambda x: np.abs(x[1]) < 0.01)
    down = fem.Constant(mesh, zero)
    bcs = [_held(V, _at(1, 1.0), down), _held(V, _at(1, -1.0), zero)]

    def update(t: float) -> None:
        down.value[1] = -2 * strain * t

    stepper = nts.QuasiStatic(bodies, [setting.pair(both, both)], dt=0.5, bcs=bcs, update=update)
    diagnostics = nts.Diagnostics(stepper)

    def judge() -> dict[str, float]:
        # With Poisson's ratio 0 the energy is that of uniaxial strain, and is stored in the blocks.
        expected = E * strain**2 * (1 - strain / 2) ** 2
        return {"strain energy": abs(diagnostics.strain_energy() / expected - 1)}

    return Scene(stepper, bodies[0], judge, t_end=1.0)


def shrink_fit(setting: Setting) -> Scene:
    """Quarter of a shaft in a hub, with an interference: Lame's pressure at each node."""
    inner, joint, outer, over, E, ratio = 0.025, 0.05, 0.1, 1e-4, 200e9, 0.3

    def build(model: Any) -> None:
        for name, y, n in (("shaft", 0.0, 40), ("hub", 2.0, 52)):
            add_rectangle(model, name, corner=(0.0, y), size=(1.0, 1.0), cells=(n, n // 4))

    mesh, cells, facets, tag = nts.read_mesh(build, _COMM)
    X, is_hub = mesh.geometry.x, mesh.geometry.x[:, 1] > 1.5
    X[is_hub, 1] -= 2.0
    radii = np.where(
        is_hub,
        joint + (outer - joint) * X[:, 1],
        inner + (joint + over - inner) * X[:, 1],
    )
    angles = np.pi / 2 * (1 - X[:, 0])
    X[:, 0], X[:, 1] = radii * np.cos(angles), radii * np.sin(angles)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    steel = nts.NeoHookean(E=E, nu=ratio, rho=7800.0)
    bodies = [nts.Body(V, cells, tag[name], steel) for name in ("shaft", "hub")]
    sides = (nts.Surface(V, facets, tag[name]) for name in ("shaft_top", "hub_bottom"))
    bcs = [_held(V, _at(axis, 0.0), 0, axis) for axis in (0, 1)]
    stepper = nts.QuasiStatic(bodies, [setting.pair(*sides)], dt=1.0, bcs=bcs)
    wider = ((1 - 2 * ratio) * joint**2 + outer**2) / (outer**2 - joint**2)
    narrower = ((1 - 2 * ratio) * joint**2 + inner**2) / (joint**2 - inner**2)
    lame = over / (joint * (1 + ratio) / E * (wider + narrower))

    def judge() -> dict[str, float]:
        pressure = stepper.contacts[0].pressure / lame
        return {
            "mean pressure": abs(float(pressure.mean()) - 1),
            "pressure": float(np.sqrt(np.mean((pressure - 1) ** 2))),
        }

    return Scene(stepper, bodies[0], judge, t_end=1.0)


def dragged_block(setting: Setting) -> Scene:
    """Block that is pressed on a wider block and dragged until it slides everywhere: T = mu N."""
    mu, n, zero = 0.3, 6, np.zeros(3)

    def build(model: Any) -> None:
        table = {"corner": (-0.6, -0.6, -0.4), "size": (1.2, 1.2, 0.4), "cells": (9, 9, 3)}
        add_box(model, "table", **table)
        size, cells = (1.0, 1.0, 0.4), (n, n, 3)
        add_box(model, "block", corner=(-0.5, -0.5, 0.0), size=size, cells=cells)

    mesh, tags, facets, tag = nts.read_mesh(build, _COMM)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(1e5, 0.3, 1e3)
    bodies = [nts.Body(V, tags, tag[name], rubber) for name in ("block", "table")]
    sides = (nts.Surface(V, facets, tag[name]) for name in ("block_bottom", "table_top"))
    pair = setting.pair(*sides, nts.Coulomb(mu))
    way = fem.Constant(mesh, zero)
    bcs = [_held(V, _at(2, 0.4), way), _held(V, _at(2, -0.4), zero)]

    def update(t: float) -> None:
        slide = 0.01 * max(t - 1.0, 0.0)
        way.value[:] = [slide, slide / 3, -0.01 * min(t, 1.0)]

    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, update=update)
    diagnostics = nts.Diagnostics(stepper)

    def judge() -> dict[str, float]:
        force = diagnostics.contact_force()
        friction = float(np.linalg.norm(force[:2])) / abs(float(force[2]))
        return {"T / mu N": abs(friction / mu - 1)}

    return Scene(stepper, bodies[0], judge, t_end=8.0)


def held_block(setting: Setting) -> Scene:
    """Block whose weight two closing jaws carry by friction, without slip.

    Without slip the block sinks by the shear of jaws and block alone, which the same scene with
    common nodes has; what it sinks more counts, relative to the way of the jaws.
    """
    mu, close, n, zero = 0.5, 0.01, 4, np.zeros(2)
    load, rho, E = 4.0, 1.0, 1e3

    def build(model: Any) -> None:
        for name, x, wide, k in (
            ("left", -0.5, 0.5, 3),
            ("block", 0.0, 1.0, n),
            ("right", 1.0, 0.5, 3),
        ):
            size, cells = (wide, 1.0), (max(2, round(k * wide)), k)
            add_rectangle(model, name, corner=(x, 0.0), size=size, cells=cells)

    mesh, tags, facets, tag = nts.read_mesh(build, _COMM)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    rubber = nts.SaintVenantKirchhoff(E, 0.0, rho)
    left, block, right = (
        nts.Body(V, tags, tag[name], rubber) for name in ("left", "block", "right")
    )
    friction = nts.Coulomb(mu)
    pairs = [
        setting.pair(
            nts.Surface(V, facets, tag[f"block_{side}"]),
            nts.Surface(V, facets, tag[f"{side}_{other}"]),
            friction,
        )
        for side, other in (("left", "right"), ("right", "left"))
    ]
    ways = [fem.Constant(mesh, zero) for _ in range(2)]
    bcs = [_held(V, _at(0, x), way) for x, way in zip((-0.5, 1.5), ways, strict=True)]

    def update(t: float) -> None:
        for sign, way in zip((1.0, -1.0), ways, strict=True):
            way.value[0] = sign * close * min(t, 1.0)

    weight = nts.Gravity([block], lambda t: (0.0, -load * max(t - 1.0, 0.0)))
    stepper = nts.QuasiStatic(
        [left, block, right], pairs, dt=0.5, bcs=bcs, update=update, loads=[weight]
    )
    diagnostics, sides = nts.Diagnostics(stepper), []
    contacts = stepper.contacts
    slips: list[Floats] = []

    def record() -> None:
        if stepper.t > 1.25:
            slips.append(_relative(stepper, contacts))
        else:
            sides[:] = [_relative(stepper, contacts)]

    def judge() -> dict[str, float]:
        force = float(np.array(diagnostics.contact_force())[1])
        return {
            "friction over weight": abs(force / load / rho - 1),
            "slip": float(np.abs(slips[-1] - sides[0]).max()) / close,
        }

    return Scene(stepper, block, judge, record, t_end=2.0)


def _relative(stepper: Any, contacts: Any) -> Floats:
    """Heights of nodes above the adjacent facets, interpolated linearly along y [m]."""
    X = stepper.u.function_space.tabulate_dof_coordinates()
    parts = []
    for contact in contacts:
        own, other = contact.nodes.nodes, contact.segments.nodes
        order = np.argsort(X[other, 1])
        moved = (stepper.x - X)[:, 1]
        there = np.interp(X[own, 1], X[other, 1][order], moved[other][order])
        parts.append(moved[own] - there)
    return np.concatenate(parts)


def stack(setting: Setting) -> Scene:
    """Three resting blocks whose weight grows slowly: contact forces equal the weights above."""
    E, rho, g, ramp = 1e4, 10.0, 10.0, 2.0

    def build(model: Any) -> None:
        for number, n in enumerate((3, 2, 3)):
            shape = {"size": (1.0, 1.0, 0.5), "cells": (n, n, 2)}
            add_box(model, f"block {number}", corner=(0.0, 0.0, 0.5 * number), **shape)

    mesh, cells, facets, tag = nts.read_mesh(build, _COMM)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.NeoHookean(E, 0.3, rho)
    bodies = [nts.Body(V, cells, tag[f"block {number}"], material) for number in range(3)]
    floor = nts.RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    bottoms = [nts.Surface(V, facets, tag[f"block {number}_bottom"]) for number in range(3)]
    tops = [nts.Surface(V, facets, tag[f"block {number}_top"]) for number in range(2)]
    pairs = [setting.pair(*sides) for sides in zip(bottoms, [floor, *tops], strict=True)]
    weight = nts.Gravity(
        bodies, lambda t: (0.0, 0.0, -g * np.sin(np.pi / 2 * min(t / ramp, 1.0)) ** 2)
    )
    stepper = nts.EnergyMomentum(bodies, pairs, dt=0.02, loads=[weight])
    diagnostics = nts.Diagnostics(stepper)
    forces = Series(stepper, lambda: diagnostics.pair_resultants()[:, 0, 2])

    def judge() -> dict[str, float]:
        last = forces.rows[forces.times > ramp] / (0.5 * rho * g * np.array([3, 2, 1]))
        return {
            "contact force": float(np.sqrt(np.mean((last - 1) ** 2))),
            "mean of the contact force": float(np.abs(last.mean(axis=0) - 1).max()),
        }

    return Scene(stepper, bodies[0], judge, forces.record, t_end=1.5 * ramp)


def braking_block(setting: Setting) -> Scene:
    """Flat stiff block that slides on a rigid plane until friction stops it: v^2/(2 mu g)."""
    speed, mu, g = 2.0, 0.3, 10.0

    def build(model: Any) -> None:
        add_box(model, "block", corner=(0.0, 0.0, 0.0), size=(1.0, 1.0, 0.25), cells=(4, 4, 2))

    mesh, tags, facets, tag = nts.read_mesh(build, _COMM)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, tags, tag["block"], nts.SaintVenantKirchhoff(1e7, 0.3, 1e3))
    bottom = nts.Surface(V, facets, tag["block_bottom"])
    floor = nts.RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    pair = setting.pair(bottom, floor, nts.Coulomb(mu))
    weight = nts.Gravity([block], (0.0, 0.0, -g))
    stepper = nts.EnergyMomentum([block], [pair], dt=0.01, loads=[weight])
    stepper.set_velocity(block, (speed, 0.0, 0.0))
    diagnostics = nts.Diagnostics(stepper)
    start = diagnostics.centre_of_mass(block)[0]

    def judge() -> dict[str, float]:
        way = float(diagnostics.centre_of_mass(block)[0] - start)
        return {"way": abs(way / (speed**2 / (2 * mu * g)) - 1)}

    return Scene(stepper, block, judge, t_end=1.5 * speed / (mu * g))
