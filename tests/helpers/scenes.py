"""Scenes of the tests of the mechanics, and their energies and momenta.

Meshes of boxes are built from arrays, so that a test can renumber nodes
and cells and choose the owners of the cells. Energies are written here
from the equations, not taken from the package.
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, graph
from dolfinx.mesh import (
    GhostMode,
    Mesh,
    MeshTags,
    create_mesh,
    meshtags,
)

import dolfinx_nts as nts
from dolfinx_nts import compat, parts
from dolfinx_nts.fem.jit import compile_quickly
from dolfinx_nts.integrators.implicit_forms import StepForms
from helpers.coordinates import coordinates
from reference.bulk import box, rotation

BALL_PLATE = Path(__file__).parents[2] / "meshes" / "ball_plate.msh"

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Young's modulus [Pa], Poisson's ratio, density [kg/m^3], step [s].
BALL_PLATE_RUBBER = (1.0e5, 0.4, 1.0e3)
BLOCK_RUBBER = (1.0e3, 0.3, 10.0)
BALL_PLATE_STEP = 0.01
BLOCK_STEP = 0.02

# Moves the ball so that no node projects onto the edge of a segment.
NO_TIES = (np.sqrt(2) / 30, np.sqrt(3) / 40, 0.0)


@dataclass(frozen=True)
class Motion:
    """Rigid motion of a whole scene, x -> Q x + c."""

    Q: Array
    c: Array

    @classmethod
    def random(cls, rng: np.random.Generator) -> "Motion":
        """Draw any rotation, and a shift of about one."""
        return cls(rotation(rng.normal(size=3), rng.uniform(1, 3)), rng.normal(size=3))

    @classmethod
    def none(cls) -> "Motion":
        """Leave everything in place."""
        return cls(np.eye(3), np.zeros(3))

    def __call__(self, x: Array) -> Array:
        """Move points, shape (n, 3)."""
        return x @ self.Q.T + self.c


@dataclass(frozen=True)
class Scene:
    """A stepper, its bodies by name, and their material numbers."""

    stepper: Any
    bodies: dict[str, nts.Body]
    numbers: tuple[float, float, float]

    @property
    def comm(self) -> MPI.Comm:
        """Communicator of the mesh."""
        return self.stepper.u.function_space.mesh.comm

    def positions(self) -> Array:
        """Positions of all nodes, by number in the input. Collective."""
        return gathered(self.stepper.u.function_space, self.stepper.x)

    def run(self, num_steps: int) -> "History":
        """Advance and keep energies and momenta. Collective."""
        totals = Totals(self)
        history = History([totals.row()], [])
        for _ in range(num_steps):
            history.reports.append(self.stepper.advance())
            history.rows.append(totals.row())
        return history


def of_material(body: nts.Body, material: nts.Hyperelastic) -> nts.Body:
    """Return the same cells of another material. Local."""
    other = copy(body)
    vars(other)["material"] = material
    return other


def gathered(V: fem.FunctionSpace, values: Array) -> Array:
    """Nodal values (l, 3) of V by input number, on all ranks. Collective."""
    ids = input_ids(V)
    owned = V.dofmap.index_map.size_local
    parts = V.mesh.comm.allgather((ids[:owned], values[:owned]))
    result = np.full((V.dofmap.index_map.size_global, 3), np.nan)
    for number, value in parts:
        result[number] = value
    return result


def input_ids(V: fem.FunctionSpace) -> Ints:
    """Return the input number of every local node of V."""
    index_map = V.dofmap.index_map
    ids = np.full(index_map.size_local + index_map.num_ghosts, -1, dtype=np.int64)
    for dofs, nodes in zip(V.dofmap.list, compat.geometry_nodes(V.mesh), strict=True):
        ids[dofs] = V.mesh.geometry.input_global_indices[nodes]
    return ids


class Totals:
    """Mass, energies and momenta of a scene, each over all bodies.

    St. Venant-Kirchhoff: psi = lambda/2 tr(E)^2 + mu E:E, by the rule of
    the bulk, as its sum over the points is what is conserved.
    """

    def __init__(self, scene: Scene) -> None:
        """Compile the forms."""
        self._scene = scene
        self._v, u = scene.stepper.v, scene.stepper.u
        V = u.function_space
        mesh = V.mesh
        E, nu, rho = (fem.Constant(mesh, number) for number in scene.numbers)
        lmbda, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
        F = ufl.Identity(3) + ufl.grad(u)
        strain = (F.T * F - ufl.Identity(3)) / 2
        psi = lmbda / 2 * ufl.tr(strain) ** 2 + mu * ufl.inner(strain, strain)
        x = ufl.SpatialCoordinate(mesh) + u
        p, L = rho * self._v, rho * ufl.cross(x, self._v)
        parts = [rho, ufl.inner(p, self._v) / 2, psi, *(p[i] for i in range(3))]
        parts += [L[i] for i in range(3)]
        twice = 2 * V.ufl_element().degree
        degrees = dict.fromkeys(range(len(parts)), twice)
        degrees[2] = 2 if mesh.topology.cell_name() == "tetrahedron" else twice
        self._forms = [
            compile_quickly(part * ufl.dx(metadata={"quadrature_degree": degrees[i]}))
            for i, part in enumerate(parts)
        ]

    def row(self) -> Array:
        """Mass, K, V, linear (3) and angular (3) momentum. Collective."""
        values = np.array([fem.assemble_scalar(form) for form in self._forms])
        return self._scene.comm.allreduce(values)


@dataclass
class History:
    """Rows of `Totals` at the start and after every step, and reports."""

    rows: list[Array]
    reports: list[nts.StepReport]

    @property
    def kinetic(self) -> Array:
        """Kinetic energy (n,)."""
        return np.array(self.rows)[:, 1]

    @property
    def strain(self) -> Array:
        """Strain energy (n,)."""
        return np.array(self.rows)[:, 2]

    @property
    def energy(self) -> Array:
        """Total energy (n,)."""
        return self.kinetic + self.strain

    @property
    def energy_error(self) -> float:
        """Largest change of the total energy, relative to the start."""
        return float(np.abs(self.energy / self.energy[0] - 1).max())

    @property
    def linear_drift(self) -> float:
        """Largest change of the linear momentum, relative to the start."""
        p = np.array(self.rows)[:, 3:6]
        return float(np.linalg.norm(p - p[0], axis=1).max() / np.linalg.norm(p[0]))

    @property
    def angular_drift(self) -> float:
        """Largest change of the angular momentum, relative to the start."""
        L = np.array(self.rows)[:, 6:]
        return float(np.linalg.norm(L - L[0], axis=1).max() / np.linalg.norm(L[0]))

    @property
    def iterations(self) -> list[int]:
        """Newton iterations of each step."""
        return [report.newton_iterations for report in self.reports]

    @property
    def num_active(self) -> list[int]:
        """Active pairs of each step."""
        return [report.num_active for report in self.reports]


def step_forms(stepper: Any) -> StepForms:
    """Forms of a step of an implicit stepper."""
    return StepForms(stepper.bodies, stepper._rates, stepper.scheme)


def following(state: Any, local: Array) -> Array:
    """Forces of pairs by springs and friction that follow a motion ``local``, both (m, d)."""
    rows = state.pairs.gradients, state.slopes, state.columns
    values: Array = np.einsum("mjb,mij,mia,mb->ma", *rows, local, optimize=True)
    return values


def local_momentum(scene: Scene, name: str) -> Callable[[], tuple[float, Array]]:
    """Return a function that gives mass and linear momentum of one body."""
    mesh, v = scene.stepper.u.function_space.mesh, scene.stepper.v
    rho = fem.Constant(mesh, scene.numbers[2])
    dx = ufl.Measure(
        "dx",
        domain=mesh,
        subdomain_data=[(0, scene.bodies[name].cells)],
        metadata={"quadrature_degree": 2},
    )(0)
    forms = [fem.form(part * dx) for part in (rho, rho * v[0], rho * v[1], rho * v[2])]

    def evaluate() -> tuple[float, Array]:
        values = scene.comm.allreduce(np.array([fem.assemble_scalar(form) for form in forms]))
        return float(values[0]), values[1:]

    return evaluate


# --- the ball on the plate ---------------------------------------------


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
        enforcement,
        friction,
        method,
    )
    stepper = scheme(list(bodies.values()), [pair], dt=dt)
    stepper.set_velocity(bodies["ball"], motion.Q @ [0.0, 1.0, -1.0])
    return Scene(stepper, bodies, BALL_PLATE_RUBBER)


# --- meshes from arrays ------------------------------------------------


@dataclass(frozen=True)
class Input:
    """A mesh before it is distributed.

    Attributes:
        cell: "hexahedron" or "tetrahedron".
        X: Nodes (n, 3).
        cells: Vertices in tensor order (c, 8), or (c, 4).
        body: Number of the body of each cell (c,).
        surfaces: Nodes of each surface by name.
        numbers: Number of each node before it was permuted (n,).
    """

    cell: str
    X: Array
    cells: Ints
    body: Ints
    surfaces: dict[str, Ints]
    numbers: Ints

    def permuted(self, rng: np.random.Generator) -> "Input":
        """Renumber nodes and cells, and the vertices within each cell."""
        node, cell = rng.permutation(len(self.X)), rng.permutation(len(self.cells))
        new = np.argsort(node)
        orders = _vertex_orders(self.cell)
        cells = np.array([c[orders[rng.integers(len(orders))]] for c in self.cells[cell]])
        return replace(
            self,
            X=self.X[node],
            cells=new[cells],
            body=self.body[cell],
            surfaces={name: new[nodes] for name, nodes in self.surfaces.items()},
            numbers=self.numbers[node],
        )


def _vertex_orders(cell: str) -> list[list[int]]:
    """Vertex orders that describe the same cell, mirrored ones included."""
    if cell == "tetrahedron":
        return [list(order) for order in permutations(range(4))]
    cube = np.arange(8).reshape(2, 2, 2)
    return [
        cube[flips].transpose(axes).ravel().tolist()
        for axes in permutations(range(3))
        for flips in np.ndindex(2, 2, 2)
        for flips in [tuple(slice(None, None, 1 - 2 * f) for f in flips)]
    ]


def boxes(
    shapes: Sequence[tuple[int, int, int]],
    sizes: Sequence[tuple[float, float, float]],
    cell: str = "hexahedron",
) -> Input:
    """Return boxes, each with a corner at the origin.

    Surfaces ``bottom i`` and ``top i``. Tetrahedra: six from each
    hexahedron, one for each way along its edges from the lowest corner
    to the highest.
    """
    X, cells, body, surfaces, first = [], [], [], {}, 0
    for number, (shape, size) in enumerate(zip(shapes, sizes, strict=True)):
        nodes, hexahedra = box(shape, size)
        surfaces[f"bottom {number}"] = first + np.flatnonzero(nodes[:, 2] == 0)
        surfaces[f"top {number}"] = first + np.flatnonzero(nodes[:, 2] == nodes[:, 2].max())
        if cell == "tetrahedron":
            ways = [[0, 1 << a, (1 << a) + (1 << b), 7] for a, b, _ in permutations(range(3))]
            hexahedra = hexahedra[:, ways].reshape(-1, 4)
        X.append(nodes)
        cells.append(first + hexahedra)
        body.append(np.full(len(hexahedra), number))
        first += len(nodes)
    return Input(
        cell, np.vstack(X), np.vstack(cells), np.concatenate(body), surfaces, np.arange(first)
    )


def distribute(
    comm: MPI.Comm,
    data: Input,
    *,
    owner: Callable[[Array], Ints] | None = None,
    ghosts: GhostMode = GhostMode.none,
) -> tuple[Mesh, MeshTags, MeshTags, dict[str, int]]:
    """Distribute a mesh; tags as from `read_mesh`. Collective.

    Args:
        comm: Communicator.
        data: The mesh, the same on all ranks.
        owner: Rank of each cell from the cell midpoints (c, 3).
        ghosts: Ghost mode, where ``owner`` is not given.
    """
    root = comm.rank == 0
    rows = slice(None) if root else slice(0)
    partitioner = compat.cell_partitioner(ghosts)
    if owner is not None:
        ranks = np.asarray(owner(data.X[data.cells].mean(axis=1)), dtype=np.int32)[rows, None]

        def partitioner(*_: Any) -> Any:
            return compat.cpp_object(graph.adjacencylist(ranks))

    mesh = create_mesh(
        comm=comm,
        cells=data.cells[rows],
        x=data.X[rows],
        e=coordinates(data.cell),
        partitioner=partitioner,
    )
    topology, nodes = mesh.topology, compat.geometry_nodes(mesh)
    for dims in ((2, 0), (2, 3), (3, 2)):
        topology.create_connectivity(*dims)
    body = data.body[topology.original_cell_index].astype(np.int32)
    cells = meshtags(mesh, 3, np.arange(len(body), dtype=np.int32), body)

    ids = np.empty(
        topology.index_map(0).size_local + topology.index_map(0).num_ghosts, dtype=np.int64
    )
    to_vertex = topology.connectivity(3, 0).array.reshape(nodes.shape)
    ids[to_vertex] = mesh.geometry.input_global_indices[nodes]
    k = {"hexahedron": 4, "tetrahedron": 3}[data.cell]
    facet_ids = ids[topology.connectivity(2, 0).array.reshape(-1, k)]
    tag = {f"body {number}": number for number in np.unique(data.body).tolist()}
    values = np.zeros(len(facet_ids), dtype=np.int32)
    for value, (name, nodes) in enumerate(data.surfaces.items(), start=1):
        tag[name] = value
        values[np.isin(facet_ids, nodes).all(axis=1)] = value
    tagged = np.flatnonzero(values).astype(np.int32)
    return mesh, cells, meshtags(mesh, 2, tagged, values[tagged]), tag


# --- colliding blocks --------------------------------------------------


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
    """Return two bodies of which most cells are far from the contact. Collective."""
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

    All nodes of its bottom touch, n + 1 along an edge, and then more and more slip.

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
    way = fem.Constant(mesh, (0.0, 0.0, 0.0))
    held = [fem.locate_dofs_topological(V, 2, facets.find(tag[s])) for s in ("bottom 0", "top 1")]
    bcs = [fem.dirichletbc(np.zeros(3), held[0], V), fem.dirichletbc(way, held[1], V)]

    def update(t: float) -> None:
        slide = 0.15 * max(t - 1, 0.0) / n
        way.value[:] = [slide, slide / 3, -0.01 * min(t, 1.0)]

    pair = nts.ContactPair(*surfaces, enforcement, friction)
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
            enforcement,
            friction,
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


def in_numbers(data: Array, numbers: Ints) -> Array:
    """Rows of a permuted mesh in the numbers that it had before."""
    result = np.empty_like(data)
    result[numbers] = data
    return result


def part(
    comm: MPI.Comm, kind: str, cell: str = "hexahedron", **shape: Any
) -> tuple[fem.FunctionSpace, MeshTags, MeshTags, dict[str, int]]:
    """Space, cells, facets and tags of one body of `parts`, named by its kind. Collective."""

    def build(model: Any) -> None:
        getattr(parts, f"add_{kind}")(model, kind, cell=cell, **shape)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    return fem.functionspace(mesh, ("Lagrange", 1, (3,))), cells, facets, tag
