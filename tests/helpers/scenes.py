"""Scenes of the tests of the mechanics: the ball on the plate, and blocks that collide or slide."""

from collections.abc import Callable, Sequence
from copy import copy
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.mesh import (
    MeshTags,
)

import dolfinx_nts as nts
from dolfinx_nts import compat, parts
from helpers.models.box_meshes import Input, boxes, distribute
from helpers.scene import Motion, Scene, input_ids
from reference.bulk import rotation

BALL_PLATE = Path(__file__).parents[2] / "dolfinx_nts" / "meshing" / "ball_plate.msh"

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Young's modulus [Pa], Poisson's ratio, density [kg/m^3], step [s].
BALL_PLATE_RUBBER = (1.0e5, 0.4, 1.0e3)
BLOCK_RUBBER = (1.0e3, 0.3, 10.0)
BALL_PLATE_STEP = 0.01
BLOCK_STEP = 0.02

# Moves the ball so that no node projects onto the edge of a segment.
NO_TIES = (np.sqrt(2) / 30, np.sqrt(3) / 40, 0.0)


def of_material(body: nts.Body, material: nts.Hyperelastic) -> nts.Body:
    """Return the same cells of another material. Local."""
    other = copy(body)
    vars(other)["material"] = material
    vars(other).pop("splits_volume", None)
    return other


def ball_plate(
    comm: MPI.Comm,
    scheme: Any = nts.EnergyMomentum,
    enforcement: nts.LagrangeMultiplier | None = None,
    *,
    shift: Sequence[float] = (0.0, 0.0, 0.0),
    motion: Motion | None = None,
    dt: float = BALL_PLATE_STEP,
    friction: nts.Coulomb | None = None,
    method: str = "node-to-segment",
    rubber: nts.Hyperelastic | None = None,
) -> Scene:
    """Return a hollow ball that flies against a plate, both free. Collective.

    Args:
        comm: Communicator of the mesh.
        scheme: Class of the stepper.
        enforcement: How contact is enforced.
        shift: Moves the ball before the start.
        motion: Moves everything, velocities too.
        dt: Step.
        friction: Law of friction.
        method: Method of the contact pair.
        rubber: Material of both.
    """
    motion = motion or Motion.none()
    mesh, cells, facets, tag = nts.read_mesh(BALL_PLATE, comm)
    ball_nodes = np.unique(compat.geometry_nodes(mesh)[cells.find(tag["ball"])])
    mesh.geometry.x[ball_nodes] += shift
    mesh.geometry.x[:] = motion(mesh.geometry.x)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = rubber or nts.SaintVenantKirchhoff(*BALL_PLATE_RUBBER, one_point=())
    bodies = {name: nts.Body(V, cells, tag[name], rubber) for name in ("ball", "plate")}
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["ball_outer"]),
        nts.Surface(V, facets, tag["plate_top"]),
        enforcement or nts.LagrangeMultiplier(),
        friction,
        method,
    )
    stepper = scheme(list(bodies.values()), [pair], dt=dt)
    stepper.set_velocity(bodies["ball"], motion.Q @ [0.0, 1.0, -1.0])
    return Scene(stepper, bodies, BALL_PLATE_RUBBER)


def blocks(
    comm: MPI.Comm,
    scheme: Any = nts.EnergyMomentum,
    enforcement: nts.LagrangeMultiplier | None = None,
    *,
    cell: str = "hexahedron",
    num_bodies: int = 2,
    layers: int = 1,
    motion: Motion | None = None,
    dt: float = BLOCK_STEP,
    degree: int = 1,
    friction: nts.Coulomb | None = None,
    permute: np.random.Generator | None = None,
    owner: Callable[[Array], Ints] | None = None,
) -> Scene:
    """Return blocks above each other that collide and turn. Collective.

    Twisted surfaces in arbitrary position; every pair is the bottom of a
    block against the top of the one below.

    Args:
        comm: Communicator of the mesh.
        scheme: Class of the stepper.
        enforcement: How contact is enforced.
        cell: Cell type.
        num_bodies: 2 or 3 blocks.
        layers: Cells through the thickness of each.
        motion: Moves everything, velocities too.
        dt: Step.
        degree: Of the displacements.
        friction: Law of friction.
        permute: Renumbers nodes and cells at random.
        owner: As in `distribute`, of midpoints before ``motion``.
    """
    data, v = block_input(cell, num_bodies, layers)
    if permute is not None:
        data = data.permuted(permute)
        v = v[data.numbers]
    return free_flight(
        comm,
        scheme,
        enforcement,
        data,
        v,
        motion=motion,
        dt=dt,
        degree=degree,
        friction=friction,
        owner=owner,
    )


def block_input(cell: str, num_bodies: int, layers: int = 1) -> tuple[Input, Array]:
    """Return mesh and nodal velocities of `blocks`."""
    shapes = [(3, 3, layers), (2, 2, layers), (1, 1, layers)][:num_bodies]
    sizes = [(1.2, 1.2, 0.5), (0.8, 0.8, 0.4), (0.3, 0.4, 0.3)][:num_bodies]
    data = boxes(shapes, sizes, cell)
    X, v = data.X, np.zeros_like(data.X)
    at = [np.unique(data.cells[data.body == number]) for number in range(num_bodies)]
    X[at[0], 2] += 0.03 * (X[at[0], 0] - 0.6) * (X[at[0], 1] - 0.6)
    for number in range(1, num_bodies):
        a, b, c = (X[at[number]] - [sizes[number][0] / 2, sizes[number][1] / 2, 0]).T
        tilt = rotation([1, 0.3, 0], 0.1 * (-1) ** (number + 1))
        local = np.column_stack((a, b, c + 0.04 * a * b))
        turned = np.array([rotation([0, 0, 1], 0.5 * number + 0.2 * x[2]) @ x for x in local])
        X[at[number]] = turned @ tilt.T + [0.63, 0.57, 0.07 + 0.48 * number]
        v[at[number]] = np.cross([0.3, -0.2, 1.5], X[at[number]] - [0.6, 0.6, 0.7])
        v[at[number]] -= [0.2, 0.1, 1.5 * number]
    return data, v


def tower(
    comm: MPI.Comm,
    scheme: Any = nts.EnergyMomentum,
    *,
    owner: Callable[[Array], Ints] | None = None,
) -> Scene:
    """Return two bodies with most cells far from the contact. Collective."""
    data = boxes([(2, 2, 4), (1, 1, 1)], [(1.0, 1.0, 1.2), (0.5, 0.4, 0.3)])
    upper = np.unique(data.cells[data.body == 1])
    data.X[upper] = data.X[upper] @ rotation([1, 2, 3], 0.4).T + [0.27, 0.36, 1.3]
    v = np.zeros_like(data.X)
    v[upper] = [0.3, 0.1, -1.5]
    return free_flight(comm, scheme, None, data, v, owner=owner)


def sliding_blocks(
    comm: MPI.Comm,
    enforcement: Any,
    friction: nts.Coulomb | None,
    *,
    n: int,
    scheme: Any = nts.QuasiStatic,
    nu: float = 0.3,
) -> Scene:
    """Return a block that is pressed on another one in step 1, and then slides. Collective.

    All nodes of its bottom touch, n + 1 along an edge; then slip spreads over them.

    Args:
        comm: Communicator of the mesh.
        enforcement: How contact is enforced.
        friction: Law of friction.
        n: Cells along an edge of the block.
        scheme: Class of the stepper.
        nu: Poisson's ratio.
    """
    m = round(1.4 * n) + 1
    data = boxes([(m, m, 2), (n, n, 2)], [(1.4, 1.4, 0.3), (1.0, 1.0, 0.3)])
    data.X[np.unique(data.cells[data.body == 1])] += [0.1, 0.2, 0.3]
    mesh, cells, facets, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    numbers = (1e5, nu, 1e3)
    rubber = nts.SaintVenantKirchhoff(*numbers, one_point=())
    bodies = {name: nts.Body(V, cells, tag[name], rubber) for name in ("body 0", "body 1")}
    surfaces = [nts.Surface(V, facets, tag[name]) for name in ("bottom 1", "top 0")]
    offset = fem.Constant(mesh, (0.0, 0.0, 0.0))
    held = [fem.locate_dofs_topological(V, 2, facets.find(tag[s])) for s in ("bottom 0", "top 1")]
    bcs = [fem.dirichletbc(np.zeros(3), held[0], V), fem.dirichletbc(offset, held[1], V)]

    def update(t: float) -> None:
        slide = 0.15 * max(t - 1, 0.0) / n
        offset.value[:] = [slide, slide / 3, -0.01 * min(t, 1.0)]

    pair = nts.ContactPair(*surfaces, enforcement, friction, method="node-to-segment")
    stepper = scheme(list(bodies.values()), [pair], dt=1.0, bcs=bcs, update=update)
    return Scene(stepper, bodies, numbers)


def free_flight(
    comm: MPI.Comm,
    scheme: Any,
    enforcement: nts.LagrangeMultiplier | None,
    data: Input,
    v: Array,
    *,
    motion: Motion | None = None,
    dt: float = BLOCK_STEP,
    degree: int = 1,
    friction: nts.Coulomb | None = None,
    owner: Callable[[Array], Ints] | None = None,
) -> Scene:
    """Return free bodies with given velocities of the vertices. Collective.

    Every pair is the bottom of a body against the top of the one below.
    """
    motion = motion or Motion.none()
    num_bodies = int(data.body.max()) + 1
    mesh, cells, facets, tag = distribute(comm, data, owner=owner)
    mesh.geometry.x[:] = motion(mesh.geometry.x)
    V, linear = (fem.functionspace(mesh, ("Lagrange", p, (3,))) for p in (degree, 1))
    rubber = nts.SaintVenantKirchhoff(*BLOCK_RUBBER, one_point=())
    bodies = {
        f"body {number}": nts.Body(V, cells, tag[f"body {number}"], rubber)
        for number in range(num_bodies)
    }
    pairs = [
        nts.ContactPair(
            nts.Surface(V, facets, tag[f"bottom {number}"]),
            nts.Surface(V, facets, tag[f"top {number - 1}"]),
            enforcement or nts.LagrangeMultiplier(),
            friction,
            method="node-to-segment",
        )
        for number in range(1, num_bodies)
    ]
    stepper = scheme(list(bodies.values()), pairs, dt=dt)
    at_vertices, velocity = fem.Function(linear), fem.Function(V)
    at_vertices.x.array[:] = (v @ motion.Q.T)[input_ids(linear)].ravel()
    velocity.interpolate(at_vertices)
    velocity.x.scatter_forward()
    for body in bodies.values():
        stepper.set_velocity(body, velocity)
    return Scene(stepper, bodies, BLOCK_RUBBER)


def part(
    comm: MPI.Comm, kind: str, cell: str = "hexahedron", **shape: Any
) -> tuple[fem.FunctionSpace, MeshTags, MeshTags, dict[str, int]]:
    """Space, cells, facets and tags of one body of `parts`, named by its kind. Collective."""

    def build(model: Any) -> None:
        getattr(parts, f"add_{kind}")(model, kind, cell=cell, **shape)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    return fem.functionspace(mesh, ("Lagrange", 1, (3,))), cells, facets, tag
