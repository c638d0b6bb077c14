"""Meshes of the verification tests: rings, tori and solid balls.

Bodies are made of blocks of hexahedra, which are joined where their nodes
coincide, or by gmsh's own mesher. Material and supports of bars, and how a
body turns.
"""

from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI

import gmsh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

import dolfinx_nts as nts

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Corners of the gmsh hexahedron in a grid, and its sides.
_CORNERS = np.array([(*ij, k) for k in (0, 1) for ij in ((0, 0), (1, 0), (1, 1), (0, 1))])
_SIDES = np.array(
    [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (2, 3, 7, 6), (0, 4, 7, 3), (1, 2, 6, 5)]
)
_HEXAHEDRON, _QUADRANGLE = 5, 3
# Nodes of two blocks are the same if they agree to this, relative to the size
# of the body.
_SAME = 1e-8


def read(comm: MPI.Comm, build: Callable[[Any], None]) -> nts.MeshData:
    """Mesh of a gmsh model that ``build`` fills on the first rank. Collective."""
    if comm.rank == 0:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("shapes")
        build(gmsh.model)
    data = nts.read_mesh(gmsh.model, comm)
    if comm.rank == 0:
        gmsh.finalize()
    return data


def add_blocks(
    model: Any, name: str, blocks: Sequence[Array], side: Callable[[Array], npt.NDArray[Any]]
) -> None:
    """Add a body of blocks of hexahedra to a gmsh model. Local.

    Args:
        model: Live gmsh model.
        name: Name of the volume.
        blocks: Nodes of grids, each (nx + 1, ny + 1, nz + 1, 3).
        side: Names of the sides of outer facets from their midpoints
            (f, 3), empty for none; a surface is called ``name_side``.
    """
    points, cells, first = [], [], 0
    for block in blocks:
        nx, ny, nz = np.subtract(block.shape[:3], 1)
        ids = first + np.arange(block[..., 0].size).reshape(block.shape[:3])
        i, j, k = np.indices((nx, ny, nz))[..., None] + _CORNERS.T[:, None, None, None]
        points.append(block.reshape(-1, 3))
        cells.append(ids[i, j, k].reshape(-1, 8))
        first += ids.size
    x, hexahedra = np.concatenate(points), np.concatenate(cells)
    grid = np.round((x - x.min(axis=0)) / (_SAME * np.ptp(x))).astype(np.int64)
    _, kept, same = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    x, hexahedra = x[kept], same.ravel()[hexahedra]

    facets = hexahedra[:, _SIDES].reshape(-1, 4)
    _, kept, count = np.unique(np.sort(facets), axis=0, return_index=True, return_counts=True)
    outer = facets[kept[count == 1]]
    sides = np.asarray(side(x[outer].mean(axis=1)))
    offset = int(model.mesh.getMaxNodeTag()) + 1
    surfaces = {value: outer[sides == value] for value in np.unique(sides) if value}
    entities = [model.addDiscreteEntity(2) for _ in surfaces]
    volume = model.addDiscreteEntity(3, boundary=entities)
    model.mesh.addNodes(3, volume, offset + np.arange(len(x)), x.ravel())
    model.mesh.addElementsByType(volume, _HEXAHEDRON, [], (offset + hexahedra).ravel())
    model.addPhysicalGroup(3, [volume], name=name)
    for entity, (value, quadrangles) in zip(entities, surfaces.items(), strict=True):
        model.mesh.addElementsByType(entity, _QUADRANGLE, [], (offset + quadrangles).ravel())
        model.addPhysicalGroup(2, [entity], name=f"{name}_{value}")


def add_ring(
    model: Any,
    name: str,
    *,
    centre: Sequence[float],
    radii: tuple[float, float],
    width: float,
    cells: tuple[int, int, int],
) -> None:
    """Add a ring with axis z and surfaces ``outer`` and ``inner``. Local.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        centre: Centre.
        radii: Inner and outer radius.
        width: Length along the axis.
        cells: Number of cells around, through the wall and along.
    """
    phi = np.linspace(0, 2 * np.pi, cells[0] + 1)[:, None, None]
    r = np.linspace(*radii, cells[1] + 1)[:, None]
    z = np.linspace(-width / 2, width / 2, cells[2] + 1)
    x = np.stack(np.broadcast_arrays(r * np.cos(phi), r * np.sin(phi), z), axis=-1)

    def side(midpoints: Array) -> npt.NDArray[Any]:
        local = midpoints - centre
        at = np.hypot(local[:, 0], local[:, 1])
        flat = np.abs(local[:, 2]) > (1 - 1e-6) * width / 2
        return np.where(flat, "", np.where(at > np.mean(radii), "outer", "inner"))

    add_blocks(model, name, [x + centre], side)


def add_torus(
    model: Any,
    name: str,
    *,
    centre: Sequence[float],
    turn: Array,
    radius: float,
    tube: tuple[float, float],
    cells: tuple[int, int, int],
) -> None:
    """Add a hollow torus with surfaces ``outer`` and ``inner``. Local.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        centre: Centre.
        turn: Rotation (3, 3) of a torus with axis z.
        radius: Radius of the circle in the middle of the tube.
        tube: Inner and outer radius of the tube.
        cells: Number of cells along the circle, around the tube and
            through its wall.
    """
    phi = np.linspace(0, 2 * np.pi, cells[0] + 1)[:, None, None]
    theta = np.linspace(0, 2 * np.pi, cells[1] + 1)[:, None]
    r = np.linspace(*tube, cells[2] + 1)
    away = radius + r * np.cos(theta)
    x = np.stack(
        np.broadcast_arrays(away * np.cos(phi), away * np.sin(phi), r * np.sin(theta)), axis=-1
    )

    def side(midpoints: Array) -> npt.NDArray[Any]:
        local = (midpoints - centre) @ turn
        at = np.hypot(np.hypot(local[:, 0], local[:, 1]) - radius, local[:, 2])
        return np.where(at > np.mean(tube), "outer", "inner")

    add_blocks(model, name, [x @ turn.T + centre], side)


def add_solid_ball(
    model: Any, name: str, *, centre: Sequence[float], radius: float, cells: int, layers: int
) -> None:
    """Add a solid ball with the surface ``outer``: a bulged cube in six shells. Local.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        centre: Centre.
        radius: Radius.
        cells: Number of cells along an edge of the cube.
        layers: Number of layers in the shells.
    """
    core, bulge = 0.5, 0.6  # half edge of the cube, and how round it is
    p = np.tan(np.pi / 4 * np.linspace(-1, 1, cells + 1))
    grid = np.stack(np.meshgrid(p, p, p, indexing="ij"), axis=-1)
    largest = np.abs(grid).max(axis=-1, keepdims=True)
    length = np.linalg.norm(grid, axis=-1, keepdims=True)
    part = bulge * largest**2
    inside = core * grid * (1 - part + part * largest / np.where(length > 0, length, 1.0))
    blocks = [radius * inside]
    s = np.linspace(0, 1, layers + 1)[:, None]
    for axis in range(3):
        for layer in (0, -1):
            inner = inside.take(layer, axis=axis)[:, :, None]
            outer = inner / np.linalg.norm(inner, axis=-1, keepdims=True)
            shell = radius * (inner + s * (outer - inner))
            # Right-handed: the first two axes turn outwards.
            if (axis == 1) != (layer == 0):
                shell = shell.transpose(1, 0, 2, 3)
            blocks.append(shell)
    blocks = [np.add(block, centre) for block in blocks]
    add_blocks(model, name, blocks, lambda midpoints: np.full(len(midpoints), "outer"))


def add_quarter_ball(
    model: Any,
    name: str,
    *,
    radius: float,
    fine: float,
    zone: float,
    growth: float,
    coarse: float,
    height: float,
    half: bool = False,
    below: bool = False,
) -> None:
    """Add a quarter of a ball in x, y > 0 that touches z = 0 at the origin. Local.

    Tetrahedra, refined towards the origin. Surfaces ``outer``, ``top`` if
    the ball is cut off, and ``x`` and ``y`` on the planes of symmetry
    x = 0 and y = 0.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        radius: Radius.
        fine: Size of the cells at the origin.
        zone: Distance from the origin up to which they have this size.
        growth: Growth of the size per distance beyond.
        coarse: Largest size.
        height: Where the ball is cut off; twice the radius for a whole one.
        half: Whether to add the other quarter in x < 0, too.
        below: Whether to mirror the ball to z < 0.
    """
    occ = model.occ
    ball = occ.addSphere(0, 0, radius, radius)
    # Poles and seam of gmsh's sphere shall not be on the quarter.
    occ.rotate([(3, ball)], 0, 0, radius, 1, -1, 0, np.pi / 2)
    occ.rotate([(3, ball)], 0, 0, radius, 0, 0, 1, np.pi)
    left = -2 * radius if half else 0.0
    box = occ.addBox(left, 0, -radius, 2 * radius - left, 2 * radius, height + radius)
    (volume,), _ = occ.intersect([(3, ball)], [(3, box)])
    if below:
        occ.mirror([volume], 0, 0, 1, 0)
    occ.synchronize()
    model.addPhysicalGroup(3, [volume[1]], name=name)
    sides: dict[str, list[int]] = {}
    for _, surface in model.getBoundary([volume], oriented=False):
        x, y, z = occ.getCenterOfMass(2, surface)
        flat = {"x": abs(x), "y": abs(y), "top": abs(abs(z) - height)}
        side = min(flat, key=lambda name: flat[name])
        if flat[side] > 1e-9 * radius or (half and side == "x"):
            side = "outer"
        sides.setdefault(side, []).append(surface)
    for side, tags in sides.items():
        model.addPhysicalGroup(2, tags, name=f"{name}_{side}")
    size = f"Min({coarse}, {fine} + {growth} * Max(0, Sqrt(x*x + y*y + z*z) - {zone}))"
    field = model.mesh.field.add("MathEval")
    model.mesh.field.setString(field, "F", size)
    model.mesh.field.setAsBackgroundMesh(field)
    for option in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
        gmsh.option.setNumber(f"Mesh.{option}", 0)
    # Bodies that are there keep their meshes; then gmsh wants to be asked
    # for each dimension.
    gmsh.option.setNumber("Mesh.MeshOnlyEmpty", 1)
    for dimension in (1, 2, 3):
        model.mesh.generate(dimension)


def linear_in_stretch(E: float, nu: float, rho: float) -> nts.Hyperelastic:
    """Material whose stress is linear in stretches along the axes.

    psi = lambda/2 tr(e)^2 + mu e:e with e_ii = sqrt(C_ii) - 1 and shear
    as in linear elasticity; P = (lambda + 2 mu) (F_11 - 1) in uniaxial
    strain, P = E (F_11 - 1) in uniaxial stress.
    """

    def psi(C: Any, lmbda: Any, mu: Any) -> Any:
        e = [ufl.sqrt(C[i, i]) - 1 for i in range(3)]
        # Products of both halves of C, so that the derivative is symmetric.
        shear = C[0, 1] * C[1, 0] + C[1, 2] * C[2, 1] + C[0, 2] * C[2, 0]
        return lmbda / 2 * sum(e) ** 2 + mu * sum(x**2 for x in e) + mu / 2 * shear

    lmbda, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    return nts.Hyperelastic(psi, rho=rho, lmbda=lmbda, mu=mu)


def rollers(V: fem.FunctionSpace, facets: Any, tags: list[int], axis: int) -> fem.DirichletBC:
    """Hold a component of the displacement on surfaces. Collective."""
    held = np.sort(np.concatenate([facets.find(tag) for tag in tags]))
    dofs = fem.locate_dofs_topological(V.sub(axis), 2, held)
    return fem.dirichletbc(np.float64(0.0), dofs, V.sub(axis))


def spin(stepper: nts.EnergyMomentum, body: nts.Body) -> Array:
    """Angular momentum of a body about its centre of mass. Collective."""
    mesh = stepper.u.function_space.mesh
    centre = fem.Constant(mesh, nts.Diagnostics(stepper).centre_of_mass(body))
    rho = fem.Constant(mesh, body.material.rho)
    x = ufl.SpatialCoordinate(mesh) + stepper.u
    density = rho * ufl.cross(x - centre, stepper.v)
    regions = [(0, np.sort(body.cells))]
    metadata = {"quadrature_degree": 2}
    dx = ufl.Measure("dx", domain=mesh, subdomain_data=regions, metadata=metadata)(0)
    parts = [fem.assemble_scalar(fem.form(density[i] * dx)) for i in range(3)]
    return np.array(mesh.comm.allreduce(np.array(parts)))
