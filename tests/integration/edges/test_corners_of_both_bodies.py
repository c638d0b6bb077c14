"""A cube falls on its corner, between the nodes of a plate: nodes of one body, or of both."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.laws import NODES
from helpers.models.box_meshes import boxes, distribute
from reference.bulk import rotation

pytestmark = pytest.mark.serial

SPEED = 1.0  # m/s


def deepest(comm, scheme, enforcement, dt, surfaces, **how):
    """Largest depth of the cube below the rigid plate in a quarter of a second [m]."""
    data = boxes([(2, 2, 2), (3, 3, 1)], [(1.0, 1.0, 1.0), (3.0, 3.0, 0.5)])
    cube, plate = (np.unique(data.cells[data.body == k]) for k in (0, 1))
    turned = data.X[cube] @ rotation([1.0, -1.0, 0.0], np.arctan(np.sqrt(2.0))).T
    data.X[cube] = turned - turned[turned[:, 2].argmin()] + [0.1, 0.05, 0.01]
    data.X[plate] -= [1.5, 1.5, 0.5]
    mesh, cells, _, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    cube = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(1e3, 0.3, 10.0))
    plate = nts.RigidBody(V, cells, tag["body 1"], 10.0, guide=nts.Guide())
    pair = nts.ContactPair(*surfaces(cube, plate), enforcement, **(NODES | how))
    stepper = scheme([cube, plate], [pair], dt=dt)
    stepper.set_velocity(cube, (0.0, 0.0, -SPEED))
    depth = 0.0
    for _ in stepper.run(until=0.25):
        depth = max(depth, -stepper.x[cube.nodes, 2].min())
    return depth


def of_one(cube, plate):
    return nts.boundary_of(plate), nts.boundary_of(cube)


def of_both(cube, plate):
    both = nts.boundary_of(cube, plate)
    return both, both


@pytest.mark.parametrize(
    ("scheme", "enforcement", "dt"),
    [
        (nts.EnergyMomentum, nts.LagrangeMultiplier("plastic"), 0.01),
        (nts.EnergyMomentum, nts.LagrangeMultiplier(), 0.01),
        (nts.EnergyMomentum, nts.Penalty(5e3), 0.01),
        (nts.CentralDifference, nts.Penalty(5e3), 1e-3),
    ],
    ids=["plastic", "elastic", "springs", "explicit"],
)
def test_a_surface_of_both_bodies_that_touches_itself_holds_the_corner(
    comm, scheme, enforcement, dt
):
    assert deepest(comm, scheme, enforcement, dt, of_one, exchange=False) > 0.2
    assert deepest(comm, scheme, enforcement, dt, of_both) < 0.02


@pytest.mark.parametrize("impact", ["plastic", "elastic"])
def test_exchanged_roles_hold_the_corner_on_a_rigid_plate(comm, impact):
    law = nts.LagrangeMultiplier(impact)
    assert deepest(comm, nts.EnergyMomentum, law, 0.01, of_one) < 0.02
