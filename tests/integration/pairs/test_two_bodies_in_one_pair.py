"""A cube over a floor is struck from the side by another body of the same pair."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models.box_meshes import boxes, distribute

pytestmark = pytest.mark.serial

EDGE, SPEED, SPRING = 0.6, 1.0, 2.0e3  # of the cube [m], of what strikes [m/s], [N/m]
STEPS = [
    (nts.CentralDifference, nts.Penalty(SPRING), 1e-3),
    (nts.EnergyMomentum, nts.Penalty(SPRING), 0.02),
    (nts.EnergyMomentum, nts.LagrangeMultiplier(), 0.02),
]
steps_ = pytest.mark.parametrize(
    ("scheme", "enforcement", "dt"), STEPS, ids=["explicit", "springs", "multipliers"]
)


def struck(comm, scheme, enforcement, dt, *, is_rigid, touches_itself=False):
    """Stepper and bodies: a cube over a floor of one cell, and a larger cube that flies at it."""
    data = boxes([(1, 1, 1)] * 3, [(EDGE,) * 3, (4.0, 4.0, 1.0), (1.0, 1.0, 1.0)])
    # Corners of the cube meet a face of the striker, and no edge of it.
    places = [(-EDGE / 2, -EDGE / 2, 0.2), (-2.0, -2.0, -1.0), (-1.6, -0.47, 0.02)]
    for body, place in enumerate(places):
        some = np.unique(data.cells[data.body == body])
        data.X[some] += place - data.X[some].min(axis=0)
    mesh, cells, _, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    tags = [tag[f"body {i}"] for i in range(3)]
    if is_rigid:
        bodies = [nts.RigidBody(V, cells, t, 10.0) for t in tags]
    else:
        bodies = [nts.Body(V, cells, t, nts.NeoHookean(2e4, 0.3, 10.0)) for t in tags]
    cube, floor, striker = bodies
    if touches_itself:
        nodes = segments = nts.boundary_of(*bodies)
    else:
        nodes, segments = nts.boundary_of(cube), nts.boundary_of(floor, striker)
    stepper = scheme(
        bodies, [nts.ContactPair(nodes, segments, enforcement, method="node-to-segment")], dt=dt
    )
    stepper.set_velocity(striker, (SPEED, 0, 0))
    return stepper, cube, striker


def overlap(stepper, cube, striker):
    """Largest penetration of the striker into the cube along x in a run of a second [m]."""
    deepest = -np.inf
    while stepper.t < 1.0:
        stepper.advance()
        along = stepper.x[:, 0]
        deepest = max(deepest, along[striker.nodes].max() - along[cube.nodes].min())
    return deepest


def velocity(stepper, body):
    """Mean velocity of the nodes of a body along x [m/s]."""
    return stepper.v.x.array.reshape(-1, 3)[body.nodes, 0].mean()


@steps_
def test_a_cube_over_the_floor_is_struck_by_another_body_of_the_pair(comm, scheme, enforcement, dt):
    stepper, cube, striker = struck(comm, scheme, enforcement, dt, is_rigid=True)
    light, heavy = 10 * EDGE**3, 10.0
    reduced = light * heavy / (light + heavy)
    # Four springs stop both; multipliers hold the nodes after half a step of approach.
    stops = SPEED * np.sqrt(reduced / (4 * SPRING))
    assert overlap(stepper, cube, striker) < 1.2 * max(stops, SPEED * dt / 2)
    # A central blow without loss of energy.
    after = 2 * heavy * SPEED / (light + heavy)
    assert abs(velocity(stepper, cube) - after) < 0.01 * after


@pytest.mark.parametrize("scheme", [nts.CentralDifference, nts.EnergyMomentum])
def test_self_contact_detects_lateral_approach(comm, scheme):
    dt = 1e-3 if scheme is nts.CentralDifference else 0.02
    given = scheme, nts.Penalty(SPRING), dt
    stepper, cube, striker = struck(comm, *given, is_rigid=False, touches_itself=True)
    assert overlap(stepper, cube, striker) < 0.1 * EDGE
