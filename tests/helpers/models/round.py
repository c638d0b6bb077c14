"""Scenes of bodies with smooth surfaces: rings in the plane, hollow balls."""

from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

import dolfinx_nts as nts
from dolfinx_nts import compat, parts
from helpers.laws import NODAL
from helpers.models.coordinates import coordinates
from helpers.models.plane import turning

__all__ = ["balls", "marble", "plane_mesh", "ring", "ring_mesh", "rings", "tagged", "throw"]

RUBBER = (1.0e5, 0.3, 1.0e3)  # Young's modulus [Pa], Poisson's ratio, density [kg/m^3]


def ring(centre: tuple[float, float], outer: float, cells: int, phase: float = 0.0):
    """Points ``(n, 2)`` and quadrilaterals ``(c, 4)``, two layers, of a ring half as wide inside.

    Its first node is ``phase`` cells from the direction x.
    """
    phi = 2 * np.pi * (np.arange(cells) + phase) / cells
    around = np.stack([np.cos(phi), np.sin(phi)], axis=1)
    radii = outer * np.array([0.5, 0.75, 1.0])
    node = np.arange(3 * cells).reshape(3, cells)
    corners = [node[:-1], np.roll(node, -1, 1)[:-1], node[1:], np.roll(node, -1, 1)[1:]]
    quads = np.stack([corner.ravel() for corner in corners], axis=1)
    return (radii[:, None, None] * around).reshape(-1, 2) + centre, quads


def plane_mesh(comm: MPI.Comm, *parts: Any, cell: str = "quadrilateral") -> mesh.Mesh:
    """Mesh of parts that are points and quadrilaterals, which may be cut into triangles."""
    first = np.cumsum([0, *(len(points) for points, _ in parts)])
    x = np.concatenate([points for points, _ in parts])
    topology = np.concatenate([quads + n for n, (_, quads) in zip(first, parts, strict=False)])
    if cell == "triangle":
        topology = np.concatenate([topology[:, [0, 1, 3]], topology[:, [0, 3, 2]]])
    root = comm.rank == 0
    element = ufl.Mesh(coordinates(cell, 2))
    partitioner = compat.cell_partitioner(mesh.GhostMode.none)
    none = topology[:0]
    return mesh.create_mesh(
        comm=comm,
        cells=topology if root else none,
        x=x if root else x[:0],
        e=element,
        partitioner=partitioner,
    )


def ring_mesh(
    comm: MPI.Comm,
    centres: list[tuple[float, float]],
    cells: int,
    cell: str,
    angle: float,
    outer_radii: tuple[float, ...] = (1.0, 1.0),
) -> mesh.Mesh:
    """Rings around centres, all turned about the origin."""
    parts = []
    for number, centre in enumerate(centres):
        points, quads = ring(centre, outer_radii[number], cells, 0.3 * number)
        parts.append((points @ turning(angle).T, quads))
    return plane_mesh(comm, *parts, cell=cell)


def tagged(domain: mesh.Mesh, is_second: Any) -> Any:
    """Cell tags: 2 where a function of midpoints ``(n, 3)`` is true, otherwise 1."""
    index_map = domain.topology.index_map(2)
    every = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
    second = is_second(mesh.compute_midpoints(domain, 2, every))
    return mesh.meshtags(domain, 2, every, np.where(second, 2, 1).astype(np.int32))


def rings(
    comm: MPI.Comm,
    *,
    smooth: bool = True,
    cells: int = 16,
    cell: str = "quadrilateral",
    angle: float = 0.0,
    rigid: bool = False,
    scheme: Any = nts.EnergyMomentum,
    dt: float = 0.01,
    **laws: Any,
) -> Any:
    """Stepper of two rings, the upper one 0.02 m above the lower one, offset. Collective."""
    domain = ring_mesh(comm, [(0.0, 0.0), (0.2, 2.0)], cells, cell, angle)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    tags = tagged(domain, lambda x: (x[:, :2] @ turning(-angle).T)[:, 1] > 1)
    lower = nts.Body(V, tags, 1, nts.NeoHookean(*RUBBER))
    upper = nts.RigidBody(V, tags, 2, RUBBER[2]) if rigid else None
    upper = upper or nts.Body(V, tags, 2, nts.NeoHookean(*RUBBER))
    nodes = nts.boundary_of(upper, smooth=smooth and laws.get("method") == "mortar")
    pair = nts.ContactPair(nodes, nts.boundary_of(lower, smooth=smooth), **(NODAL | laws))
    return scheme([lower, upper], [pair], dt=dt)


def marble(comm: MPI.Comm, *, smooth: bool = True, depth: float = 0.0) -> Any:
    """Stepper of a small ring that touches the inside of a large ring. Collective.

    Facets of the hollow are up to 0.015 m inside its circle, 0.15 facets of the small ring.
    """
    centres = [(0.0, 0.0), (0.0, -0.3 - depth)]
    domain = ring_mesh(comm, centres, 13, "quadrilateral", 0.0, outer_radii=(1.0, 0.2))
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    tags = tagged(domain, lambda x: np.linalg.norm(x, axis=1) < 0.55)
    bodies = [nts.Body(V, tags, tag, nts.NeoHookean(*RUBBER)) for tag in (1, 2)]
    hollow = nts.boundary_of(bodies[0], where=lambda x: np.hypot(x[0], x[1]) < 0.51, smooth=smooth)
    pair = nts.ContactPair(
        nts.boundary_of(bodies[1]),
        hollow,
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    return nts.EnergyMomentum(bodies, [pair], dt=0.01)


def balls(comm: MPI.Comm, *, smooth: bool = True, cell: str = "hexahedron", **laws: Any) -> Any:
    """Stepper of two hollow balls, the upper one 0.02 m above the lower one, offset. Collective."""

    def scene(model: Any) -> None:
        for name, centre in (("lower", (0.0, 0.0, 0.0)), ("upper", (0.2, 0.1, 2.0))):
            parts.add_hollow_ball(
                *(model, name),
                centre=centre,
                inner_radius=0.6,
                outer_radius=1.0,
                cells_per_edge=4,
                layers=1,
                cell=cell,
            )

    domain, cells, facets, tag = nts.read_mesh(scene, comm)
    V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    bodies = [nts.Body(V, cells, tag[name], nts.NeoHookean(*RUBBER)) for name in ("lower", "upper")]
    both = smooth and laws.get("method") == "mortar"
    nodes = nts.Surface(V, facets, tag["upper_outer"], smooth=both)
    segments = nts.Surface(V, facets, tag["lower_outer"], smooth=smooth)
    pair = nts.ContactPair(nodes, segments, **(NODAL | laws))
    return nts.EnergyMomentum(bodies, [pair], dt=0.01)


def throw(stepper: Any) -> None:
    """Let the upper body fall, move sideways and spin, and the lower one spin reversely."""
    d = stepper.u.function_space.mesh.geometry.dim
    lower, upper = stepper.bodies

    def velocity(x: np.ndarray, v: tuple[float, ...], spin: float) -> np.ndarray:
        rows = np.zeros((d, x.shape[1]))
        rows[:2] = spin * np.array([-x[1], x[0]])
        return rows + np.array(v[:d])[:, None]

    fall = (0.3, -1.0, 0.0) if d == 2 else (0.3, 0.2, -1.0)
    stepper.set_velocity(upper, lambda x: velocity(x, fall, 0.5))
    stepper.set_velocity(lower, lambda x: velocity(x, (0.0, 0.0, 0.0), -0.7))
