"""Corners beside each other: mean gaps to planes beyond an edge are negative, the bodies apart."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts

# Corners of two triangles [m]; the first ones of both are 0.065 m apart.
LOW = ((0.0, 0.0), (-4.84, -4.88), (5.06, -4.46))
HIGH = ((0.03437466, 0.05593267), (3.42434973, 5.91570819), (-2.74689027, 5.06966037))


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("friction", [None, 0.3])
@pytest.mark.parametrize("dt", [0.2, 0.1, 0.05])
def test_springs_between_corners_that_are_apart_give_no_energy(comm, dt, friction):
    def fill(model):
        for name, corners, size in (("low", LOW, 1.35), ("high", HIGH, 1.9)):
            points = [model.occ.addPoint(*corner, 0, size) for corner in corners]
            lines = [model.occ.addLine(points[i - 1], points[i]) for i in range(3)]
            face = model.occ.addPlaneSurface([model.occ.addCurveLoop(lines)])
            model.occ.synchronize()
            model.addPhysicalGroup(2, [face], name=name)
        model.mesh.generate(2)

    mesh, cells, _, tag = nts.read_mesh(fill, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    material = nts.NeoHookean(E=200.0, nu=0.3, rho=1e-3)
    low, high = (nts.Body(V, cells, tag[name], material) for name in ("low", "high"))
    sides = nts.boundary_of(low), nts.boundary_of(high)
    stepper = nts.EnergyMomentum([low, high], [nts.ContactPair(*sides, friction=friction)], dt=dt)
    spin, velocity = 0.018401, np.array([[-0.173075], [-0.312145]])
    stepper.set_velocity(high, lambda x: velocity + spin * np.stack([-x[1], x[0]]))
    diagnostics, given = nts.Diagnostics(stepper), 0.0
    first = diagnostics.balance().total_energy
    for _ in range(5):
        report = stepper.advance()
        given += report.contact_work.friction
    assert given <= 0
    assert abs(diagnostics.balance().total_energy - given - first) < 1e-9 * first
