"""Springs of surface-to-surface contact: cubes of tetrahedra that fall on a corner or an edge."""

import gmsh
import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts

pytestmark = pytest.mark.serial

# Cells of the base along an edge, speed [m/s], Poisson's ratio [-], rotation vector [rad].
TURNING = [
    (2, 5.75, 0.0, (-1.3032, 0.9054, 0.4464)),
    (3, 5.04, 0.3, (0.4205, 1.136, 0.1097)),
    (3, 5.28, 0.3, (0.0696, 1.3183, 0.3856)),
    (3, 5.08, 0.0, (-0.9365, 0.3939, -0.5241)),
]
ALTERNATING = [
    (2, 3.19, 0.3, (0.9406, -1.951, -1.3022)),
    (2, 4.89, 0.3, (-0.8686, 0.951, -3.2327)),
    (2, 4.34, 0.3, (0.8746, -0.6976, -0.4571)),
    (2, 4.71, 0.3, (-0.951, 1.035, 0.5841)),
    (3, 4.46, 0.3, (2.7822, -0.4209, 0.6752)),
]


def falling_cube(comm, cells, speed, nu, rotation):
    """Stepper of a cube that falls on a block with steps of 4 ms."""

    def build(model):
        base = model.occ.addBox(-0.1, -0.1, -0.1, 0.2, 0.2, 0.1)
        cube = model.occ.addBox(-0.06, -0.06, -0.06, 0.12, 0.12, 0.12)
        angle = np.linalg.norm(rotation)
        model.occ.rotate([(3, cube)], 0, 0, 0, *np.array(rotation) / angle, angle)
        model.occ.translate([(3, cube)], 0.01, 0.01, 0.107)
        model.occ.synchronize()
        model.addPhysicalGroup(3, [base], name="base")
        model.addPhysicalGroup(3, [cube], name="cube")
        for option in ("Mesh.MeshSizeMin", "Mesh.MeshSizeMax"):
            gmsh.option.setNumber(option, 0.2 / cells)
        model.mesh.generate(3)

    mesh, tags, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.NeoHookean(E=1e6, nu=nu, rho=1e3)
    bodies = [nts.Body(V, tags, tag[name], rubber) for name in ("base", "cube")]
    pairs = nts.all_pairs(bodies, enforcement=nts.Penalty(6e4), method="mortar")
    stepper = nts.EnergyMomentum(bodies, pairs, dt=4e-3)
    stepper.set_velocity(bodies[1], (0.0, 0.0, -speed))
    return stepper


@pytest.mark.parametrize("scene", TURNING + ALTERNATING)
def test_no_step_of_an_impact_on_a_corner_has_to_be_halved(comm, scene):
    """Bodies that turn slide off their segments in a step; sets of loaded springs alternate."""
    stepper = falling_cube(comm, *scene)
    start = nts.Diagnostics(stepper).balance()
    reports = list(stepper.run(until=0.08, control=nts.StepControl(smallest=stepper.dt)))
    end = nts.Diagnostics(stepper).balance()
    assert len(reports) == 20
    assert sum(report.newton_iterations for report in reports) <= 110
    # Loaded nodes that lose all contact points return the energy of their springs.
    assert abs(end.total_energy - start.total_energy) <= 1e-9 * start.total_energy
    assert end.kinetic_energy < 0.999 * start.kinetic_energy  # contact acted
