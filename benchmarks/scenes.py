"""Scenes of the benchmarks: meshes of any fineness, and what runs on them."""

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import gmsh
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.meshing.gmsh import MeshData, add_box, add_hollow_ball

__all__ = [
    "ELEMENTS",
    "SCHEMES",
    "Scene",
    "ball_on_plate",
    "bar_on_wall",
    "pressed_block",
    "sliding_block",
]

SCHEMES: dict[str, tuple[Any, Any]] = {
    "EM elastic": (nts.EnergyMomentum, lambda: nts.LagrangeMultiplier("elastic")),
    "EM plastic": (nts.EnergyMomentum, lambda: nts.LagrangeMultiplier("plastic")),
    "EM penalty": (nts.EnergyMomentum, nts.Penalty),
    "statics": (nts.QuasiStatic, nts.LagrangeMultiplier),
    "statics, penalty": (nts.QuasiStatic, nts.Penalty),
    "midpoint": (nts.Midpoint, lambda: nts.LagrangeMultiplier("plastic")),
    "generalised-alpha": (nts.GeneralizedAlpha, lambda: nts.LagrangeMultiplier("plastic")),
    "central differences": (nts.CentralDifference, nts.Penalty),
}


# Cells, degree of the displacement, terms with one point a cell.
ELEMENTS: dict[str, tuple[str, int, list[str]]] = {
    "full": ("hexahedron", 1, []),
    "one point": ("hexahedron", 1, ["lmbda"]),
    "degree 2": ("hexahedron", 2, []),
    "tetrahedra": ("tetrahedron", 1, []),
    "tetrahedra, degree 2": ("tetrahedron", 2, []),
}


@dataclass(frozen=True)
class Scene:
    """A stepper ready to run, and the body that is watched."""

    stepper: Any
    body: nts.Body


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
    friction: Any = None,
    element: str = "full",
) -> Scene:
    """Hollow ball that flies obliquely onto a free plate.

    For n = 6 that is ``meshes/ball_plate.msh``. Collective.

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
            cell=ELEMENTS[element][0],
        )
        cells = (10 * n // 6, 10 * n // 6, max(1, n // 6))
        add_box(
            model,
            "plate",
            corner=(-2.0, -2.0, -0.4),
            size=(4.0, 4.0, 0.4),
            cells=cells,
            cell=ELEMENTS[element][0],
        )

    mesh, cells, facets, tag = _mesh(comm, build)
    _, degree, one_point = ELEMENTS[element]
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    material = nts.SaintVenantKirchhoff(E, nu, rho, one_point=one_point)
    ball, plate = (nts.Body(V, cells, tag[name], material) for name in ("ball", "plate"))
    integrator, enforcement = SCHEMES[scheme]
    pair = nts.ContactPair(
        nodes=nts.Surface(V, facets, tag["ball_outer"]),
        segments=nts.Surface(V, facets, tag["plate_top"]),
        enforcement=enforcement(),
        friction=friction,
    )
    stepper = integrator([ball, plate], [pair], dt=h)
    stepper.set_velocity(ball, (0.0, 1.0, -1.0))
    return Scene(stepper, ball)


# Data of the bar, SI units: length, edge of the section, E and rho, speed.
BAR_LENGTH, BAR_SIDE, BAR_SPEED = 10.0, 1.0, 1e-3


def bar_on_wall(
    comm: MPI.Comm, scheme: str, h: float | None, *, cells: int, element: str = "full"
) -> Scene:
    """Bar with E = rho = c = 1, Poisson's ratio 0, that strikes a rigid wall.

    So slow that linear theory holds: from the touch at t = 0 on the mean
    velocity grows linearly, from -v to v, in 2 L/c. Collective.

    Args:
        comm: Communicator of the mesh.
        scheme: Key of `SCHEMES`.
        h: Step [s]; None: what central differences choose.
        cells: Number along the bar.
        element: Key of `ELEMENTS`.
    """

    def build(model: Any) -> None:
        size = (BAR_SIDE, BAR_SIDE, BAR_LENGTH)
        kind = ELEMENTS[element][0]
        add_box(model, "bar", corner=(0.0, 0.0, 0.0), size=size, cells=(1, 1, cells), cell=kind)

    mesh, tags, facets, tag = _mesh(comm, build)
    V = fem.functionspace(mesh, ("Lagrange", ELEMENTS[element][1], (3,)))
    bar = nts.Body(V, tags, tag["bar"], nts.SaintVenantKirchhoff(1.0, 0.0, 1.0))
    integrator, enforcement = SCHEMES[scheme]
    pair = nts.ContactPair(
        nodes=nts.Surface(V, facets, tag["bar_bottom"]),
        segments=nts.RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        enforcement=enforcement(),
    )
    stepper = integrator([bar], [pair], dt=h)
    stepper.set_velocity(bar, (0.0, 0.0, -BAR_SPEED))
    return Scene(stepper, bar)


def sliding_block(comm: MPI.Comm, scheme: str, h: float, *, n: int, friction: Any = None) -> Scene:
    """Block that is pressed on a wider one in the first step, and then drawn over it.

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

    mesh, tags, facets, tag = _mesh(comm, build)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.SaintVenantKirchhoff(1e5, 0.3, 1e3, one_point=())
    block, table = (nts.Body(V, tags, tag[name], material) for name in ("block", "table"))
    integrator, enforcement = SCHEMES[scheme]
    pair = nts.ContactPair(
        nodes=nts.Surface(V, facets, tag["block_bottom"]),
        segments=nts.Surface(V, facets, tag["table_top"]),
        enforcement=enforcement(),
        friction=friction,
    )
    way, rest = (fem.Constant(mesh, (0.0, 0.0, 0.0)) for _ in range(2))
    low, top = (
        fem.locate_dofs_topological(V, 2, facets.find(tag[name]))
        for name in ("table_bottom", "block_top")
    )
    bcs = [fem.dirichletbc(rest, low, V), fem.dirichletbc(way, top, V)]

    def update(t: float) -> None:
        slide = 0.01 * max(t - 1.0, 0.0)
        way.value[:] = [slide, slide / 3, -0.01 * min(t, 1.0)]

    stepper = integrator([block, table], [pair], dt=h, bcs=bcs, update=update)
    return Scene(stepper, block)


def pressed_block(comm: MPI.Comm, scheme: str, h: float) -> Scene:
    """Soft block that leans and slides on a rigid plane, and never parts.

    Its weight holds it down, and it starts close to equilibrium under it; all nodes
    at the bottom touch from the start. Collective.

    Args:
        comm: Communicator of the mesh.
        scheme: Key of `SCHEMES`.
        h: Step [s].
    """

    def build(model: Any) -> None:
        add_box(model, "block", corner=(0.0, 0.0, 0.0), size=(1.0, 1.0, 1.0), cells=(2, 2, 2))

    mesh, tags, facets, tag = _mesh(comm, build)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, tags, tag["block"], nts.SaintVenantKirchhoff(1e4, 0.0, 10.0))
    integrator, enforcement = SCHEMES[scheme]
    pair = nts.ContactPair(
        nodes=nts.Surface(V, facets, tag["block_bottom"]),
        # Overlapping by nothing, so that round-off does not decide who touches.
        segments=nts.RigidPlane((0.0, 0.0, 1e-14), (0.0, 0.0, 1.0)),
        enforcement=enforcement(),
    )
    stepper = integrator([block], [pair], dt=h, loads=[nts.Gravity([block], (0.0, 0.0, -20.0))])
    g, stiffness = 20.0, 1e4 / 10.0  # E / rho
    stepper.set_displacement(
        block, lambda x: [0.0 * x[2], 0.0 * x[2], -g / stiffness * (x[2] - x[2] ** 2 / 2)]
    )
    # Nothing moves across the plane at its height.
    stepper.set_velocity(block, lambda x: [1.0 + 0.3 * x[2], 0.1 * x[2], 0.0 * x[2]])
    return Scene(stepper, block)


def _mesh(comm: MPI.Comm, build: Any) -> MeshData:
    """Mesh of a gmsh model that rank 0 builds."""
    if comm.rank == 0:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        build(gmsh.model)
    try:
        return nts.read_mesh(gmsh.model, comm)
    finally:
        if comm.rank == 0:
            gmsh.finalize()
