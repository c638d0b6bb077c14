"""Scenes with rigid bodies."""

from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import meshtags

import dolfinx_nts as nts
from helpers.models.box_meshes import boxes, distribute
from helpers.scene import Motion, Scene
from reference.bulk import rotation

__all__ = ["CENTRE", "bonded", "brick", "eulers", "hinged", "impact", "pressed", "spin"]

# Density of the rigid block [kg/m^3], of its rotation [rad/s], and its velocity [m/s].
RHO, OMEGA, SPEED = 20.0, np.array([0.5, -0.8, 2.0]), np.array([0.3, 0.1, -1.5])
NUMBERS = (1.0e3, 0.3, 10.0)  # Young's modulus [Pa], Poisson's ratio, density of the other
# Edges of the brick that tumbles [m], its density and the hinged one's, and centre of the
# pressed tool.
SIZES, LIGHT, CENTRE = np.array([1.0, 2.0, 0.5]), 2.0, np.array([0.52, 0.48, 0.651])
TILT = rotation([1, 0.5, 0.2], 0.15)


def spin(omega: Any, centre: Any, velocity: Any = (0.0, 0.0, 0.0)) -> Any:
    """Velocity of a rigid rotation about a centre, a function of positions ``(3, n)``."""
    return lambda X: np.cross(omega, X.T - centre).T + np.asarray(velocity)[:, None]


def impact(
    comm: MPI.Comm,
    scheme: Any = nts.EnergyMomentum,
    enforcement: Any = None,
    *,
    motion: Motion | None = None,
    friction: nts.Coulomb | None = None,
    method: str = "node-to-segment",
    dt: float = 0.01,
    n: int = 4,
    rho: float = RHO,
    rigid_nodes: bool = False,
    both_rigid: bool = False,
) -> Scene:
    """Return a spinning rigid block that hits a free block. Collective.

    Args:
        comm: Communicator of the mesh.
        scheme: Class of the stepper.
        enforcement: How contact is enforced.
        motion: Moves everything, velocities too.
        friction: Law of friction.
        method: Method of the pair.
        dt: Step.
        n: Cells along an edge of the free block.
        rho: Density of the rigid block [kg/m^3].
        rigid_nodes: Whether its nodes are in contact, and not the free block's.
        both_rigid: Whether the free block is rigid, too.
    """
    motion = motion or Motion.none()
    data = boxes([(n, n, n // 2), (2, 2, 1)], [(1.0, 1.0, 0.5), (1.5, 1.4, 0.3)])
    upper = np.unique(data.cells[data.body == 1])
    data.X[upper] = (data.X[upper] - [0.75, 0.7, 0]) @ TILT.T + [0.5, 0.52, 0.63]
    centre = motion(data.X[upper].mean(axis=0)[None])[0]
    mesh, cells, facets, tag = distribute(comm, data)
    mesh.geometry.x[:] = motion(mesh.geometry.x)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.NeoHookean(*NUMBERS, one_point=())
    block = nts.Body(V, cells, tag["body 0"], rubber)
    if both_rigid:
        block = nts.RigidBody(V, cells, tag["body 0"], NUMBERS[2])
    rigid = nts.RigidBody(V, cells, tag["body 1"], rho)
    surfaces = [nts.Surface(V, facets, tag[name]) for name in ("top 0", "bottom 1")]
    if rigid_nodes:
        surfaces.reverse()
    pair = nts.ContactPair(*surfaces, enforcement or nts.LagrangeMultiplier(), friction, method)
    stepper = scheme([block, rigid], [pair], dt=dt)
    stepper.set_velocity(rigid, spin(motion.Q @ OMEGA, centre, motion.Q @ SPEED))
    return Scene(stepper, {"block": block, "rigid": rigid}, NUMBERS)


def brick(dt, omega, cell="hexahedron", scheme=nts.EnergyMomentum):
    """A rigid brick that turns about its centre in space, and a function of its rotation."""
    data = boxes([(2, 2, 1)], [tuple(SIZES)], cell)
    data.X[:] -= SIZES / 2
    mesh, cells, _, tag = distribute(MPI.COMM_SELF, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    body = nts.RigidBody(V, cells, tag["body 0"], LIGHT)
    stepper = scheme([body], dt=dt)
    stepper.set_velocity(body, spin(omega, (0.0, 0.0, 0.0)))
    X = V.tabulate_dof_coordinates()
    return stepper, lambda: np.linalg.lstsq(X, stepper.x, rcond=None)[0].T


def eulers(omega, time, num_steps=4000):
    """Rotation after some time by Euler's equations, with the classical Runge-Kutta method."""
    mass = LIGHT * SIZES.prod()
    inertia = mass / 12 * ((SIZES**2).sum() - SIZES**2)

    def rate(state):
        Q, w = state[:9].reshape(3, 3), state[9:]
        cross = np.cross(w, np.eye(3)).T  # in the body
        return np.concatenate([(Q @ cross).ravel(), np.cross(inertia * w, w) / inertia])

    h, state = time / num_steps, np.concatenate([np.eye(3).ravel(), omega])
    for _ in range(num_steps):
        a = rate(state)
        b = rate(state + h / 2 * a)
        c = rate(state + h / 2 * b)
        state = state + h / 6 * (a + 2 * b + 2 * c + rate(state + h * c))
    return state[:9].reshape(3, 3)


def bonded(comm):
    """A column whose upper half is rigid, with the tags of its facets."""
    data = boxes([(2, 2, 4)], [(0.5, 0.4, 1.0)])
    data.body[data.X[data.cells].mean(axis=1)[:, 2] > 0.5] = 1
    mesh, cells, facets, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(1e3, 0.3, 10.0, one_point=())
    soft, rigid = (
        nts.Body(V, cells, tag["body 0"], rubber),
        nts.RigidBody(V, cells, tag["body 1"], 20),
    )
    return soft, rigid, facets, tag


def pressed(
    comm,
    scheme,
    guide,
    force=None,
    *,
    friction=None,
    dt=0.1,
    moment=None,
    spring=False,
    enforcement=None,
):
    """A rigid tool above a block on a clamped foot."""
    data = boxes([(4, 4, 2), (2, 2, 1)], [(1.0, 1.0, 0.5), (0.6, 0.6, 0.3)])
    upper = np.unique(data.cells[data.body == 1])
    data.X[upper] += CENTRE - [0.3, 0.3, 0.15]
    mesh, cells, facets, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(1e3, 0.3, 10.0))
    tool = nts.RigidBody(V, cells, tag["body 1"], RHO, guide)
    surfaces = (nts.Surface(V, facets, tag[name]) for name in ("top 0", "bottom 1"))
    pair = nts.ContactPair(
        *surfaces, enforcement or nts.LagrangeMultiplier(), friction, method="node-to-segment"
    )
    foot = fem.locate_dofs_topological(V, 2, facets.find(tag["bottom 0"]))
    clamp = fem.dirichletbc(np.zeros(3), foot, V)
    loads = [] if force is None else [nts.Force(tool, force)]
    if moment is not None:
        loads.append(nts.Moment(tool, moment))
    if spring:
        loads.append(spring_of(V, tool))
    stepper = scheme([block, tool], [pair], dt=dt, bcs=[clamp], loads=loads)
    return stepper, tool


def spring_of(V, tool):
    """A spring from a tool to a base that moves down, spread over its cells."""
    tags = meshtags(V.mesh, 3, np.sort(tool.cells), np.ones(len(tool.cells), dtype=np.int32))
    dx, volume = ufl.Measure("dx", V.mesh, subdomain_data=tags)(1), 0.6 * 0.6 * 0.3
    stiffness = 300.0 / volume  # N/m^4
    return nts.FormLoad(
        V, lambda u, eta, t: -stiffness * ufl.inner(u - ufl.as_vector([0, 0, -0.1 * t]), eta) * dx
    )


def hinged(motion=None, moment=None, g=None, dt=0.01, scheme=nts.EnergyMomentum):
    """A brick that turns about an axis through the middle of its upper edge."""
    data = boxes([(2, 2, 2)], [(0.4, 0.2, 1.0)])
    data.X[:] -= [0.2, 0.1, 1.0]
    mesh, cells, _, tag = distribute(MPI.COMM_SELF, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    guide = nts.Guide(turns=(0, 2, 0), motion=motion, point=(0, 0, 0))
    body = nts.RigidBody(V, cells, tag["body 0"], RHO, guide)
    loads = [] if moment is None else [nts.Moment(body, moment)]
    loads += [] if g is None else [nts.Gravity([body], (0, 0, -g))]
    return scheme([body], dt=dt, loads=loads), body
