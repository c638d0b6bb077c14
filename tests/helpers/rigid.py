"""Scenes with rigid bodies."""

from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from helpers.scenes import Motion, Scene, boxes, distribute
from reference.bulk import rotation

__all__ = ["impact", "spin"]

# Density of the rigid block [kg/m^3], of its rotation [rad/s], and its velocity [m/s].
RHO, OMEGA, SPEED = 20.0, np.array([0.5, -0.8, 2.0]), np.array([0.3, 0.1, -1.5])
NUMBERS = (1.0e3, 0.3, 10.0)  # Young's modulus [Pa], Poisson's ratio, density of the other
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
        rigid_nodes: Whether its nodes are in contact, not those of the free block.
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
    pair = nts.ContactPair(*surfaces, enforcement, friction, method)
    stepper = scheme([block, rigid], [pair], dt=dt)
    stepper.set_velocity(rigid, spin(motion.Q @ OMEGA, centre, motion.Q @ SPEED))
    return Scene(stepper, {"block": block, "rigid": rigid}, NUMBERS)
