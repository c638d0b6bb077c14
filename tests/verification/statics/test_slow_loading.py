"""Slow loads in dynamics: bodies of a few cells between plates, default springs.

Loads take many transit times of waves, so that forces are the static ones of a bar of the
neo-Hookean material without lateral strain, up to waves of about rho c v.
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


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_blocks_of_degree_2_that_a_slow_load_presses_on_each_other_do_not_vibrate(cell):
    # Steps are far longer than the periods of the cells, whose velocities alternate. Predictions
    # with these velocities would find contact points several cells away.
    pressure, until, below, above = 0.3 * E, 1.0, 6, 8

    def build(model):
        for name, y, n in (("below", 0.0, below), ("above", 0.5, above)):
            corner, size, cells = (-0.5, y), (1.0, 0.5), (n, n // 2)
            meshing.add_rectangle(model, name, corner=corner, size=size, cells=cells, cell=cell)

    mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_SELF)
    V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    material = nts.NeoHookean(E, 0.0, DENSITY)
    lower, upper = (nts.Body(V, cells, tag[name], material) for name in ("below", "above"))
    W, _ = V.sub(0).collapse()
    middle = fem.locate_dofs_geometrical((V.sub(0), W), lambda x: np.isclose(x[0], 0))[0]
    bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 0))
    bcs = [
        fem.dirichletbc(np.zeros(2), bottom, V),
        fem.dirichletbc(np.float64(0), middle, V.sub(0)),
    ]
    top = nts.boundary_of(upper, where=lambda x: x[1] > 1 - 1e-9)
    load = nts.Traction(top, lambda t: (0.0, -pressure * np.sin(np.pi * t / until / 2) ** 2))
    bodies = [lower, upper]
    stepper = nts.EnergyMomentum(bodies, nts.all_pairs(bodies), dt=0.01, bcs=bcs, loads=[load])
    diagnostics = nts.Diagnostics(stepper)
    for _ in stepper.run(until=until):
        pass
    # Physical waves have about 2e-4 of the strain energy, vibrations by wrong predictions 2e-2.
    assert diagnostics.kinetic_energy() < 1e-3 * diagnostics.strain_energy()
    (pair,) = diagnostics.pairs().values()
    assert abs(pair.force[1]) == pytest.approx(pressure, rel=2e-3)
    assert max((overlap.depth for overlap in diagnostics.overlaps()), default=0.0) < 0.05 / above
