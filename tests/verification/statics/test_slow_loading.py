"""Slow loads in dynamics: bodies of a few cells between plates, default springs.

The plates approach in many transit times of waves, so that the force is the static one of a bar of
the neo-Hookean material without lateral strain, up to waves of about rho c v.
"""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import meshing

pytestmark = pytest.mark.serial

E, DENSITY, STRAIN = 1e6, 1e3, 0.05


def mean_error(num_cells, transits, steps=80):
    """Relative error of the force on a unit square over the last quarter of the run."""

    def build(model):
        size, cells = (1.0, 1.0), (num_cells, num_cells)
        meshing.add_rectangle(model, "block", corner=(0.0, 0.0), size=size, cells=cells)

    mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_SELF)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    block = nts.Body(V, cells, tag["block"], nts.NeoHookean(E, 0.0, DENSITY))
    until = transits / np.sqrt(E / DENSITY)
    top = nts.RigidPlane((0.0, 1.0), (0.0, -1.0), name="top")
    top = top.moving(nts.Motion(translation=lambda t: (0.0, -STRAIN * t / until)))
    floor = nts.RigidPlane((0.0, 0.0), (0.0, 1.0), name="floor")
    pairs = nts.all_pairs([block], obstacles=[top, floor])
    stepper = nts.EnergyMomentum([block], pairs, dt=until / steps)
    diagnostics, errors = nts.Diagnostics(stepper), []
    for step in stepper.run(until=until):
        # The force of a step is the mean of those at its ends.
        stretch = 1 - STRAIN * (step.t - step.dt / 2) / until
        exact = E / 2 * (1 / stretch - stretch)
        errors.append(diagnostics.obstacles()["top"].force[1] / exact - 1)
    return np.mean(errors[-steps // 4 :])


def test_blocks_of_few_cells_between_plates_that_approach_slowly(table_row):
    cases = [(3, 60), (3, 600), (8, 60)]
    errors = [mean_error(*case) for case in cases]
    assert all(-0.04 < error < 0.005 for error in errors)
    assert errors[1] > -0.015
    table_row(
        "block pressed by plates in dynamics, all defaults: 3 cells high in 60 and 600 transit "
        "times of waves, 8 cells in 60",
        "neo-Hookean bar: force",
        ", ".join(f"{100 * error:+.1f} %" for error in errors),
    )
