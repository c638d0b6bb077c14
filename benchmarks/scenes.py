"""Scenes of the benchmarks: meshes of adjustable size, bodies and steppers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from mpi4py import MPI

from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.meshing.parts import add_box, add_hollow_ball, add_solid_ball

__all__ = [
    "ELEMENTS",
    "SCHEMES",
    "Element",
    "Scene",
    "Scheme",
    "ball_on_plate",
    "pile",
    "row_of_balls",
    "sliding_block",
]


class Scheme(NamedTuple):
    """Integrator and law of contact.

    Attributes:
        integrator: Class of the stepper.
        enforcement: Makes the law of normal contact.
        method: Of `nts.ContactPair`.
    """

    integrator: Any
    enforcement: Callable[[], Any]
    method: str = "node-to-segment"

    def pair(self, nodes: nts.Surface, segments: Any, friction: Any = None) -> nts.ContactPair:
        """Contact of nodes with segments or with an obstacle."""
        return nts.ContactPair(
            nodes=nodes,
            segments=segments,
            enforcement=self.enforcement(),
            friction=friction,
            method=self.method,
        )


def _impact(law: str) -> Callable[[], nts.LagrangeMultiplier]:
    return lambda: nts.LagrangeMultiplier(law)


SCHEMES = {
    "EM elastic": Scheme(nts.EnergyMomentum, _impact("elastic")),
    "EM plastic": Scheme(nts.EnergyMomentum, _impact("plastic")),
    "EM resolved": Scheme(nts.EnergyMomentum, _impact("resolved")),
    "EM penalty": Scheme(nts.EnergyMomentum, nts.Penalty),
    "EM mortar": Scheme(nts.EnergyMomentum, _impact("elastic"), "mortar"),
    "EM resolved, mortar": Scheme(nts.EnergyMomentum, _impact("resolved"), "mortar"),
    "statics": Scheme(nts.QuasiStatic, nts.LagrangeMultiplier),
    "statics, penalty": Scheme(nts.QuasiStatic, nts.Penalty),
    "statics, mortar": Scheme(nts.QuasiStatic, nts.LagrangeMultiplier, "mortar"),
    "midpoint": Scheme(nts.Midpoint, _impact("plastic")),
    "generalised-alpha": Scheme(nts.GeneralizedAlpha, _impact("plastic")),
    "central differences": Scheme(nts.CentralDifference, nts.Penalty),
}


class Element(NamedTuple):
    """Cells and degree of the displacement.

    Attributes:
        cell: ``"hexahedron"`` or ``"tetrahedron"``.
        degree: Of the displacement.
        one_point: Terms with one point a cell, None for those of the package.
    """

    cell: str
    degree: int
    one_point: tuple[str, ...] | None = None


ELEMENTS = {
    "default": Element("hexahedron", 1),
    "full": Element("hexahedron", 1, ()),
    "degree 2": Element("hexahedron", 2),
    "tetrahedra": Element("tetrahedron", 1),
    "tetrahedra, degree 2": Element("tetrahedron", 2),
}


@dataclass(frozen=True)
class Scene:
    """A stepper that is ready to run, with functions that evaluate its state.

    Attributes:
        stepper: The stepper.
        body: Body that is watched.
        judge: Values at the end by name. Collective.
        record: Called after each step. Collective.
        t_end: Time at the end, where the scene knows it [s].
    """

    stepper: Any
    body: nts.Body
    judge: Callable[[], dict[str, float]] = dict
    record: Callable[[], None] = lambda: None
    t_end: float = 0.0


def ball_on_plate(
    comm: MPI.Comm,
    scheme: str,
    h: float | None,
    *,
    n: int = 6,
    E: float = 1e5,
    rho: float = 1e3,
    nu: float = 0.4,
    wall: float = 0.2,
    law: str = "SaintVenantKirchhoff",
    friction: Any = None,
    element: str = "default",
) -> Scene:
    """Hollow ball that flies obliquely onto a free plate.

    For n = 6 that is ``nts.examples.ball_plate()``. Collective.

    Args:
        comm: Communicator of the mesh.
        scheme: Key of `SCHEMES`.
        h: Step [s]; None: what central differences choose.
        n: Cells along an edge of the cubed ball.
        E: Young's modulus [Pa].
        rho: Density [kg/m^3].
        nu: Poisson's ratio.
        wall: Thickness of the ball [m]; it has a layer of cells for each n // 3 in 0.2 m, and
            at least two.
        law: Name of the material of the package.
        friction: Law of friction or None.
        element: Key of `ELEMENTS`.
    """

    def build(model: Any) -> None:
        add_hollow_ball(
            model,
            "ball",
            centre=(0.0, -0.5, 1.05),
            inner_radius=1.0 - wall,
            outer_radius=1.0,
            cells_per_edge=n,
            layers=max(2, round(n // 3 * wall / 0.2)),
            cell=ELEMENTS[element].cell,
        )
        cells = (10 * n // 6, 10 * n // 6, max(1, n // 6))
        add_box(
            model,
            "plate",
            corner=(-2.0, -2.0, -0.4),
            size=(4.0, 4.0, 0.4),
            cells=cells,
            cell=ELEMENTS[element].cell,
        )

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    kind = ELEMENTS[element]
    V = fem.functionspace(mesh, ("Lagrange", kind.degree, (3,)))
    material = getattr(nts, law)(E, nu, rho, one_point=kind.one_point)
    ball, plate = (nts.Body(V, cells, tag[name], material) for name in ("ball", "plate"))
    outer, top = (nts.Surface(V, facets, tag[name]) for name in ("ball_outer", "plate_top"))
    pair = SCHEMES[scheme].pair(outer, top, friction)
    stepper = SCHEMES[scheme].integrator([ball, plate], [pair], dt=h)
    stepper.set_velocity(ball, (0.0, 1.0, -1.0))
    return Scene(stepper, ball)


def row_of_balls(comm: MPI.Comm, scheme: str, h: float, *, n: int, number: int) -> Scene:
    """Hollow balls in a row that strike a long plate, all with the same motion.

    Collective.

    Args:
        comm: Communicator of the mesh.
        scheme: Key of `SCHEMES`.
        h: Step [s].
        n: Cells along an edge of a cubed ball.
        number: Number of balls.
    """
    names = [f"ball {k}" for k in range(number)]

    def build(model: Any) -> None:
        for k, name in enumerate(names):
            add_hollow_ball(
                model,
                name,
                centre=(4.0 * k + 2.0, 0.0, 1.02),
                inner_radius=0.8,
                outer_radius=1.0,
                cells_per_edge=n,
                layers=2,
            )
        size, cells = (4.0 * number, 4.0, 0.4), (2 * n * number, 2 * n, 2)
        add_box(model, "plate", corner=(0.0, -2.0, -0.4), size=size, cells=cells)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(1e5, 0.4, 1e3)
    *balls, plate = (nts.Body(V, cells, tag[name], rubber) for name in (*names, "plate"))
    top = nts.Surface(V, facets, tag["plate_top"])
    outer = (nts.Surface(V, facets, tag[f"{name}_outer"]) for name in names)
    pairs = [SCHEMES[scheme].pair(surface, top) for surface in outer]
    stepper = SCHEMES[scheme].integrator([*balls, plate], pairs, dt=h)
    for ball in balls:
        stepper.set_velocity(ball, (0.3, 0.2, -1.0))
    return Scene(stepper, balls[0])


def sliding_block(comm: MPI.Comm, scheme: str, h: float, *, n: int, friction: Any = None) -> Scene:
    """Block that is pressed on a wider block in the first step and then pulled along it.

    All (n + 1)^2 nodes of its bottom touch; with a coefficient of friction of 0.3 they stick
    at first, and after some steps all slip. Collective.

    Args:
        comm: Communicator of the mesh.
        scheme: Key of `SCHEMES`.
        h: Step [s], of which the first second is that of pressing.
        n: Cells along an edge of the block.
        friction: Law of friction or None.
    """

    def build(model: Any) -> None:
        wide, high = round(1.2 * n) + 1, 0.4
        table = {"corner": (-0.6, -0.6, -high), "size": (1.2, 1.2, high), "cells": (wide, wide, 3)}
        add_box(model, "table", **table)
        cells = (n, n, max(3, n // 11))
        add_box(model, "block", corner=(-0.5, -0.5, 0.0), size=(1.0, 1.0, high), cells=cells)

    mesh, tags, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.SaintVenantKirchhoff(1e5, 0.3, 1e3, one_point=())
    block, table = (nts.Body(V, tags, tag[name], material) for name in ("block", "table"))
    bottom, table_top = (nts.Surface(V, facets, tag[n]) for n in ("block_bottom", "table_top"))
    pair = SCHEMES[scheme].pair(bottom, table_top, friction)
    way, rest = (fem.Constant(mesh, (0.0, 0.0, 0.0)) for _ in range(2))
    low, top = (
        fem.locate_dofs_topological(V, 2, facets.find(tag[name]))
        for name in ("table_bottom", "block_top")
    )
    bcs = [fem.dirichletbc(rest, low, V), fem.dirichletbc(way, top, V)]

    def update(t: float) -> None:
        slide = 0.01 * max(t - 1.0, 0.0)
        way.value[:] = [slide, slide / 3, -0.01 * min(t, 1.0)]

    integrator = SCHEMES[scheme].integrator
    stepper = integrator([block, table], [pair], dt=h, bcs=bcs, update=update)
    return Scene(stepper, block)


def pile(comm: MPI.Comm, scheme: str, h: float | None, *, n: int, friction: Any = None) -> Scene:
    """Cube of n^3 soft balls that falls in a box, where each ball touches its neighbours.

    Collective.

    Args:
        comm: Communicator of the mesh.
        scheme: Key of `SCHEMES`.
        h: Step [s]; None: what central differences choose.
        n: Balls along an edge.
        friction: Law of friction or None.
    """
    radius, distance = 0.1, 0.201
    places = [(i, j, k) for i in range(n) for j in range(n) for k in range(n)]

    def build(model: Any) -> None:
        for number, (i, j, k) in enumerate(places):
            # Layers lean, so that balls roll over each other.
            centre = (distance * i + 0.02 * k, distance * j - 0.01 * k, distance * k + radius)
            shape = {"centre": centre, "radius": radius, "cells_per_edge": 3, "layers": 1}
            add_solid_ball(model, f"ball {number}", **shape)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.NeoHookean(1e5, 0.3, 1e3)
    balls = [nts.Body(V, cells, tag[f"ball {number}"], rubber) for number in range(len(places))]
    ends = (-2 * radius, distance * n + radius)
    walls = [nts.RigidPlane((0.0, 0.0, -1e-3), (0.0, 0.0, 1.0))]
    for axis in (0, 1):
        for end, sign in zip(ends, (1.0, -1.0), strict=True):
            point, normal = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
            point[axis], normal[axis] = end, sign
            walls.append(nts.RigidPlane(point, normal))
    enforcement = SCHEMES[scheme].enforcement()
    pairs = nts.all_pairs(
        balls, obstacles=walls, enforcement=enforcement, friction=friction, method="node-to-segment"
    )
    weight = nts.Gravity(balls, (0.0, 0.0, -9.81))
    stepper = SCHEMES[scheme].integrator(balls, pairs, dt=h, loads=[weight])
    for ball in balls:
        stepper.set_velocity(ball, (0.2, 0.1, -1.0))
    return Scene(stepper, balls[-1])
