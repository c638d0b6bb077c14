"""Cubes that meet with crossed edges, and cubes that tumble in a box."""

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from helpers.laws import NODAL
from helpers.models.box_meshes import boxes, distribute
from helpers.scene import Motion, Scene
from reference.bulk import rotation

__all__ = ["crossed", "deepest", "tumbling"]

NUMBERS = (2.0e4, 0.3, 10.0)  # Young's modulus [Pa], Poisson's ratio, density [kg/m^3]
# Where the upper cube is [m], and its velocity [m/s].
PLACE, VELOCITY = np.array([0.07, 0.05, np.sqrt(2) + 0.02]), np.array([0.1, -0.05, -1.0])
WIDTH = 3.5  # of the box in which cubes tumble [m]


def crossed(
    comm: MPI.Comm,
    *,
    is_rigid: bool = False,
    edges: bool | None = True,
    enforcement: nts.LagrangeMultiplier | nts.Penalty | None = None,
    friction: nts.Coulomb | None = None,
    scheme=nts.EnergyMomentum,
    cell: str = "hexahedron",
    motion: Motion | None = None,
    n: int = 3,
    dt: float = 0.004,
    degree: int = 1,
    place=PLACE,
    velocity=VELOCITY,
    turn: float = np.pi / 2,
    method: str = "node-to-segment",
) -> Scene:
    """Two cubes on their edges, one above the other, whose edges cross. Collective.

    Args:
        comm: Communicator of the mesh.
        is_rigid: Whether the cubes are rigid.
        edges: Whether their edges touch; None for the default, once they have crossed.
        enforcement: How contact is enforced.
        friction: Law of friction.
        scheme: Class of the stepper.
        cell: Kind of cells.
        motion: Moves everything, velocities too.
        n: Cells along an edge.
        dt: Step [s].
        degree: That of the displacements.
        place: Where the upper cube is [m].
        velocity: Its velocity [m/s].
        turn: Angle between the edges [rad].
        method: That of contact between the faces.
    """
    motion = motion or Motion.none()
    data = boxes([(n, n, n)] * 2, [(1.0, 1.0, 1.0)] * 2, cell)
    for body, (angle, there) in enumerate([(0.0, np.zeros(3)), (turn, place)]):
        some = np.unique(data.cells[data.body == body])
        X = (data.X[some] - data.X[some].mean(axis=0)) @ rotation([1, 0, 0], np.pi / 4).T
        data.X[some] = X @ rotation([0, 0, 1], angle).T + there
    mesh, cells, _, tag = distribute(comm, data)
    mesh.geometry.x[:] = motion(mesh.geometry.x)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    tags = [tag["body 0"], tag["body 1"]]
    if is_rigid:
        bodies = [nts.RigidBody(V, cells, t, NUMBERS[2]) for t in tags]
    else:
        bodies = [nts.Body(V, cells, t, nts.NeoHookean(*NUMBERS)) for t in tags]
    pairs = nts.all_pairs(
        bodies,
        enforcement=enforcement or nts.LagrangeMultiplier(),
        friction=friction,
        edges=bool(edges),
        exchange=edges is not False,
        method=method,
    )
    stepper = scheme(bodies, pairs, dt=dt)
    stepper.set_velocity(bodies[1], motion.Q @ np.asarray(velocity))
    return Scene(stepper, dict(zip(("lower", "upper"), bodies, strict=True)), NUMBERS)


def tumbling(
    comm: MPI.Comm,
    edges: bool | None,
    num: int = 5,
    seed: int = 1,
    *,
    enforcement: nts.LagrangeMultiplier | nts.Penalty | None = None,
    friction: nts.Coulomb | None = None,
    scheme=nts.EnergyMomentum,
    dt: float = 0.008,
):
    """Rigid cubes of one cell that fall into a box, turned and spinning at random. Collective.

    Args:
        comm: Communicator of the mesh.
        edges: Whether their edges touch; None for the default, once they have crossed.
        num: How many cubes.
        seed: Of the random numbers.
        enforcement: How contact is enforced.
        friction: Law of friction.
        scheme: Class of the stepper.
        dt: Step [s].

    Returns:
        The stepper.
    """
    rng = np.random.default_rng(seed)
    data = boxes([(1, 1, 1)] * num, [(1.0, 1.0, 1.0)] * num)
    for body in range(num):
        some = np.unique(data.cells[data.body == body])
        X = data.X[some] - data.X[some].mean(axis=0)
        X = X @ rotation(rng.normal(size=3), rng.uniform(0, np.pi)).T
        cell = np.array([body % 2, (body // 2) % 2, body // 4])
        place = [0.9, 0.9, 1.0] + 1.75 * cell + rng.uniform(-0.02, 0.02, 3)
        data.X[some] = X + place
    mesh, cells, _, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bodies = [nts.RigidBody(V, cells, tag[f"body {i}"], 2.0) for i in range(num)]
    walls = [
        nts.RigidPlane((0, 0, 0), (0, 0, 1)),
        nts.RigidPlane((0, 0, 0), (1, 0, 0)),
        nts.RigidPlane((0, 0, 0), (0, 1, 0)),
        nts.RigidPlane((WIDTH, 0, 0), (-1, 0, 0)),
        nts.RigidPlane((0, WIDTH, 0), (0, -1, 0)),
    ]
    laws = {"enforcement": enforcement or nts.LagrangeMultiplier(), "friction": friction}
    laws["exchange"] = edges is not False
    pairs = nts.all_pairs(bodies, obstacles=walls, edges=bool(edges), **(NODAL | laws))
    # Nodes of both sides: vertices of cubes meet faces of all others.
    between = [p for p in pairs if isinstance(p.segments, nts.Surface)]
    nodal = [p for p in between if p.method != "edge-to-edge"]
    pairs += [nts.ContactPair(p.segments, p.nodes, **(NODAL | laws)) for p in nodal]
    gravity = nts.Gravity(bodies, (0, 0, -5.0))
    stepper = scheme(bodies, pairs, dt=dt, loads=[gravity])
    X = V.tabulate_dof_coordinates()
    for body in bodies:
        omega, velocity = rng.normal(size=3), 0.7 * rng.normal(size=3)
        centre = X[body.nodes].mean(axis=0)

        def field(Y, omega=omega, velocity=velocity, centre=centre):
            return np.cross(omega, Y.T - centre).T + velocity[:, None]

        stepper.set_velocity(body, field)
    return stepper


def deepest(diagnostics: nts.Diagnostics) -> float:
    """Depth of the deepest overlap of two bodies [m]. Collective."""
    found = [
        max(each.depth, each.reverse_depth)
        for each in diagnostics.overlaps()
        if not each.names[1].startswith("RigidPlane")
    ]
    return max(found, default=0.0)
