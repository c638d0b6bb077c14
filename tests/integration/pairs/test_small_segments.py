"""Nodes of a coarse soft body on segments far smaller than its facets.

Springs are compressed by a part of the height of the cells behind the nodes. The mesh of a rigid
plate has no effect on the motion.
"""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import meshing


def fallen(comm, plate, scheme=nts.EnergyMomentum, num_facets=60):
    """Least height and last velocity of a soft square that falls on a plate at 4 % of c."""

    def build(model):
        size, cells = (1.0, 1.0), (4, 4)
        meshing.add_rectangle(model, "block", corner=(0.0, 1e-3), size=size, cells=cells)
        if plate == "body":
            size, cells = (1.5, 0.5), (num_facets, 1)
            meshing.add_rectangle(model, "plate", corner=(-0.25, -0.5), size=size, cells=cells)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    block = nts.Body(V, cells, tag["block"], nts.NeoHookean(1e6, 0.3, 1e3))
    bodies, obstacles = [block], []
    if plate == "body":
        bodies.append(nts.RigidBody(V, cells, tag["plate"], 7.8e3, guide=nts.Guide()))
    else:
        obstacles.append(nts.RigidPlane((0.0, 0.0), (0.0, 1.0)))
    given = {"dt": 1e-3} if scheme is nts.EnergyMomentum else {}
    stepper = scheme(bodies, nts.all_pairs(bodies, obstacles=obstacles), **given)
    stepper.set_velocity(block, (0.0, -2.0))
    diagnostics, heights = nts.Diagnostics(stepper), []
    for _ in stepper.run(until=0.06):
        heights.append(diagnostics.centre_of_mass(block)[1])
    return min(heights), diagnostics.body_velocity(block)[1]


@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.CentralDifference])
def test_rigid_plates_of_small_facets_act_as_a_plane(comm, scheme):
    given = {"rtol": 1e-9} if scheme is nts.EnergyMomentum else {"rtol": 1e-6}
    np.testing.assert_allclose(fallen(comm, "body", scheme), fallen(comm, "plane", scheme), **given)
