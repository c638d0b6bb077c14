"""Scenes of bodies of revolution: half sections in the plane, with x as the radius."""

from typing import Any, NamedTuple

from mpi4py import MPI

import gmsh
import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import meshing
from helpers.laws import NODAL

RUBBER = {"E": 1.0e5, "nu": 0.4, "rho": 1.0e3}  # Pa, -, kg/m^3
R, HEIGHT, GAP = 0.5, 0.3, 0.01  # of the ball, of the plate, between both [m]


class BallOnPlate(NamedTuple):
    """A ball above a round plate of radius 0.8 m, whose top is at y = 0."""

    V: fem.FunctionSpace
    ball: nts.Body
    plate: nts.Body

    @property
    def bodies(self) -> list[nts.Body]:
        """Both bodies."""
        return [self.ball, self.plate]

    def pairs(self, **laws: Any) -> list[nts.ContactPair]:
        """Nodes of the lower half of the ball against the top of the plate."""
        nodes = nts.boundary_of(self.ball, where=lambda x: x[1] < R)
        segments = nts.boundary_of(self.plate, where=lambda x: x[1] > -1e-9)
        return [nts.ContactPair(nodes, segments, **(NODAL | laws))]


def half_disc(occ: Any, centre: float, radius: float) -> int:
    """Add the half section of a ball with its centre on the axis; returns its surface."""
    disc = occ.addDisk(0, centre, 0, radius, radius)
    right = occ.addRectangle(0, centre - 2 * radius, 0, radius, 4 * radius)
    ((_, half),), _ = occ.intersect([(2, disc)], [(2, right)])
    return int(half)


def ball_on_plate(
    cell: str = "quadrilateral",
    degree: int = 1,
    size: float = 0.1,
    material: nts.Hyperelastic | None = None,
) -> BallOnPlate:
    """Mesh both bodies with cells of a size [m]."""

    def build(model: Any) -> None:
        occ = model.occ
        ball = half_disc(occ, GAP + R, R)
        plate = occ.addRectangle(0, -HEIGHT, 0, 0.8, HEIGHT)
        occ.synchronize()
        model.addPhysicalGroup(2, [ball], name="ball")
        model.addPhysicalGroup(2, [plate], name="plate")
        model.mesh.setSize(model.getEntities(0), size)
        if cell == "quadrilateral":
            for surface in (ball, plate):
                model.mesh.setRecombine(2, surface)
            gmsh.option.setNumber("Mesh.Algorithm", 8)
            gmsh.option.setNumber("Mesh.RecombinationAlgorithm", 3)
        model.mesh.generate(2)

    data = meshing.read_mesh(build, MPI.COMM_WORLD)
    nts.axisymmetric(data.mesh)
    V = fem.functionspace(data.mesh, ("Lagrange", degree, (2,)))
    rubber = nts.NeoHookean(**RUBBER) if material is None else material
    bodies = [nts.Body(V, data.cells, data.tag[name], rubber) for name in ("ball", "plate")]
    assert data.mesh.topology.cell_name() == cell
    return BallOnPlate(V, *bodies)


def shell(thickness: float = 0.08, size: float = 0.05) -> nts.Body:
    """Hollow ball around the origin."""

    def build(model: Any) -> None:
        outer, inner = (half_disc(model.occ, 0.0, r) for r in (R, R - thickness))
        ((_, left),), _ = model.occ.cut([(2, outer)], [(2, inner)])
        model.occ.synchronize()
        model.addPhysicalGroup(2, [left], name="shell")
        model.mesh.setSize(model.getEntities(0), size)
        model.mesh.generate(2)

    data = meshing.read_mesh(build, MPI.COMM_WORLD)
    nts.axisymmetric(data.mesh)
    V = fem.functionspace(data.mesh, ("Lagrange", 1, (2,)))
    return nts.Body(V, data.cells, data.tag["shell"], nts.NeoHookean(**RUBBER))


def round_block(
    cells: tuple[int, int] = (4, 4),
    cell: str = "quadrilateral",
    degree: int = 1,
    corner: tuple[float, float] = (0.0, 0.0),
    size: tuple[float, float] = (1.0, 1.0),
    skew: float = 0.0,
) -> tuple[meshing.MeshData, fem.FunctionSpace]:
    """Mesh of a round block, or of a tube, with distorted cells where a skew is given [m]."""

    def build(model: Any) -> None:
        meshing.add_rectangle(model, "block", corner=corner, size=size, cells=cells, cell=cell)

    data = meshing.read_mesh(build, MPI.COMM_WORLD)
    x = data.mesh.geometry.x
    s, t = ((x[:, i] - corner[i]) / size[i] for i in (0, 1))
    bubble = 16 * s * (1 - s) * t * (1 - t)
    x[:, 0] += skew * bubble * np.sin(3 * x[:, 1])
    x[:, 1] += skew * bubble * np.cos(4 * x[:, 0])
    nts.axisymmetric(data.mesh)
    return data, fem.functionspace(data.mesh, ("Lagrange", degree, (2,)))
