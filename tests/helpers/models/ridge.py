"""A cube that falls with an edge across the edge of a box that is an obstacle."""

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from helpers.laws import NODAL
from helpers.models.box_meshes import boxes, distribute
from helpers.scene import Motion, Scene
from reference.bulk import rotation

__all__ = ["box_corners", "over_ridge", "ridge"]

NUMBERS = (2.0e4, 0.3, 10.0)  # Young's modulus [Pa], Poisson's ratio, density [kg/m^3]
PLACE = (0.07, 0.05, np.sqrt(2) + 0.02)  # of the centre of the cube [m]
# The sides of a box by its corners in the order of binary numbers.
SIDES = [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 4, 5], [2, 3, 6, 7], [0, 2, 4, 6], [1, 3, 5, 7]]


def box_corners() -> np.ndarray:
    """Corners of a box 2 m x 1 m x 1 m on its edge along x, shape ``(8, 3)`` [m]."""
    X = np.array([[x, y, z] for x in (-1, 1) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return X @ rotation([1, 0, 0], np.pi / 4).T


def ridge(motion: Motion, *, is_soup: bool = False) -> nts.RigidSurface:
    """The box as an obstacle; of a soup each facet has vertices of its own."""
    X, sides = motion(box_corners()), np.array(SIDES)
    outside = X.mean(axis=0) + 2 * (X[sides].mean(axis=1) - X.mean(axis=0))
    if is_soup:
        X, sides = X[sides].reshape(-1, 3), np.arange(24).reshape(6, 4)
    return nts.RigidSurface(X, sides, outside)


def over_ridge(
    comm: MPI.Comm,
    *,
    is_rigid: bool = False,
    edges: bool | None = True,
    enforcement: nts.LagrangeMultiplier | nts.Penalty | None = None,
    friction: nts.Coulomb | None = None,
    scheme=nts.EnergyMomentum,
    place=PLACE,
    velocity=(0.1, -0.05, -1.0),
    motion: Motion | None = None,
    moving: nts.Motion | None = None,
    is_soup: bool = False,
    n: int = 2,
    dt: float = 0.004,
) -> Scene:
    """A cube of 1 m whose lowest edge, along y, falls on the edge of `ridge`. Collective.

    Args:
        comm: Communicator of the mesh.
        is_rigid: Whether the cube is rigid.
        edges: Whether edges touch; None for the default, once they have crossed.
        enforcement: How contact is enforced.
        friction: Law of friction.
        scheme: Class of the stepper.
        place: Centre of the cube [m].
        velocity: Its velocity [m/s].
        motion: Moves everything, the velocity too.
        moving: How the obstacle moves.
        is_soup: As of `ridge`.
        n: Cells along an edge.
        dt: Step [s].
    """
    motion = motion or Motion.none()
    data = boxes([(n, n, n)], [(1.0, 1.0, 1.0)])
    X = (data.X - data.X.mean(axis=0)) @ rotation([1, 0, 0], np.pi / 4).T
    data.X[:] = motion(X @ rotation([0, 0, 1], np.pi / 2).T + place)
    mesh, cells, _, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    if is_rigid:
        cube = nts.RigidBody(V, cells, tag["body 0"], NUMBERS[2])
    else:
        cube = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(*NUMBERS))
    obstacle = ridge(motion, is_soup=is_soup)
    if moving is not None:
        obstacle = obstacle.moving(moving)
    laws = {"enforcement": enforcement or nts.LagrangeMultiplier(), "friction": friction}
    laws["exchange"] = edges is not False
    pairs = nts.all_pairs([cube], obstacles=[obstacle], edges=bool(edges), **(NODAL | laws))
    stepper = scheme([cube], pairs, dt=dt)
    stepper.set_velocity(cube, motion.Q @ np.asarray(velocity))
    return Scene(stepper, {"cube": cube}, NUMBERS)
