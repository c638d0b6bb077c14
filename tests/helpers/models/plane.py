"""Scenes in the plane: two blocks of quadrilaterals or triangles that meet obliquely."""

from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

import dolfinx_nts as nts
from dolfinx_nts import compat
from helpers.models.coordinates import coordinates

RUBBER = {"E": 1.0e5, "nu": 0.3, "rho": 1.0e3}  # Pa, -, kg/m^3


class Blocks(NamedTuple):
    """Two blocks: the lower one 2 x 0.5 m, the upper one 1 x 1 m, 0.02 m above it."""

    V: fem.FunctionSpace
    lower: nts.Body
    upper: nts.Body
    nodes: nts.Surface
    segments: nts.Surface
    turn: np.ndarray


def turning(angle: float) -> np.ndarray:
    """Matrix that turns vectors in the plane, shape ``(2, 2)``."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def block(corner: tuple[float, float], size: tuple[float, float], cells: tuple[int, int]):
    """Points ``(n, 2)`` and quadrilaterals in Basix order ``(c, 4)`` of a block."""
    axes = [np.linspace(a, a + h, n + 1) for a, h, n in zip(corner, size, cells, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    number = np.arange(len(points)).reshape(cells[0] + 1, cells[1] + 1)
    quads = [number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]]
    return points, np.stack([corner.ravel() for corner in quads], axis=1)


def blocks(
    cell: str = "quadrilateral",
    angle: float = 0.0,
    width: int = 8,
    depth: float = 0.0,
    degree: int = 1,
    *,
    rigid: bool = False,
    guide: nts.Guide | None = None,
    material: nts.Hyperelastic | None = None,
    place: tuple[float, float] = (0.0, 0.0),
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Blocks:
    """Make two blocks, turned by an angle; with a depth one layer of hexahedra [m].

    The upper one may be rigid, with a guide. ``place`` shifts the origin of both.
    """
    turn = turning(angle)
    (x_low, low), (x_up, up) = (
        block((-1.0, -0.5), (2.0, 0.5), (width, 2)),
        block((-0.45, 0.02), (1.0, 1.0), (3, 3)),
    )
    points = np.concatenate([x_low, x_up])
    quads = np.concatenate([low, up + len(x_low)])
    if cell == "triangle":
        quads = np.concatenate([quads[:, [0, 1, 3]], quads[:, [0, 3, 2]]])
    gdim = 2
    if depth:
        cell, gdim, n = "hexahedron", 3, len(points)
        points = np.concatenate([np.column_stack([points, np.full(n, z)]) for z in (0.0, depth)])
        quads = np.concatenate([quads, quads + n], axis=1)
        turn = np.eye(3)
        turn[:2, :2] = turning(angle)
    origin = np.zeros(gdim)
    origin[:2] = place
    if comm.rank > 0:
        quads = quads[:0]
    local = points if comm.rank == 0 else points[:0]
    domain = mesh.create_mesh(
        comm=comm,
        cells=quads,
        x=local @ turn.T + origin,
        e=ufl.Mesh(coordinates(cell, gdim)),
        partitioner=compat.cell_partitioner(mesh.GhostMode.none),
    )
    V = fem.functionspace(domain, ("Lagrange", degree, (gdim,)))
    cells = domain.topology.index_map(gdim)
    every = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    back = turn.T if gdim == 3 else turning(-angle)
    middle = (mesh.compute_midpoints(domain, gdim, every)[:, :gdim] - origin) @ back.T
    tags = mesh.meshtags(domain, gdim, every, np.where(middle[:, 1] < 0, 1, 2).astype(np.int32))
    rubber = nts.SaintVenantKirchhoff(**RUBBER) if material is None else material
    bodies = [nts.Body(V, tags, tag, rubber) for tag in (1, 2)]
    if rigid:
        bodies[1] = nts.RigidBody(V, tags, 2, RUBBER["rho"], guide)
    surfaces = [
        nts.Surface.where(V, lambda x, y=y: np.isclose((back @ (x[:gdim].T - origin).T)[1], y))
        for y in (0.02, 0.0)
    ]
    return Blocks(V, *bodies, *surfaces, turn)


def throw(scene: Blocks, stepper: Any) -> None:
    """Let the upper block fall obliquely and spin."""

    def velocity(x: np.ndarray) -> np.ndarray:
        d = len(scene.turn)
        at = scene.turn.T @ x[:d]
        rows = [0.8 - 0.6 * at[1], -1.2 + 0.6 * at[0], np.zeros(x.shape[1])]
        return scene.turn @ np.array(rows[:d])

    stepper.set_velocity(scene.upper, velocity)
