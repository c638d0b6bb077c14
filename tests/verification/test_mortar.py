"""Surface-to-surface contact: exact patch test, energy and momenta, both sides alike."""

from functools import cache, partial

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_nts as nts
from helpers import scenes
from helpers.compressed_blocks import compress

pytestmark = pytest.mark.serial

MORTAR = partial(nts.ContactPair, method="mortar")
# Spread of stress and pressure that is none, relative.
EXACT = 1e-9


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("cells", [(4, 6), (6, 4)])
def test_patch_test_is_passed_whichever_side_is_finer(cell, cells):
    blocks = compress(*cells, MORTAR, cell=cell)
    pressure = blocks.stepper.contacts[0].pressure
    assert np.ptp(blocks.stress) <= EXACT
    assert np.ptp(pressure) <= EXACT * pressure.mean()
    # The difference between the two stress measures is of the size of the strain.
    assert abs(blocks.stress.mean() - 1) <= 1e-4
    assert pressure.mean() == pytest.approx(blocks.mean_pressure, rel=1e-3)


def test_patch_test_is_nearly_passed_on_facets_that_are_no_parallelograms():
    blocks = compress(6, 4, MORTAR, swirl=0.5)
    assert np.abs(blocks.stress - blocks.stress.mean()).max() <= 2e-3


def test_blocks_that_are_compressed_in_large_steps_still_pass():
    """Points are chosen anew until they belong to the equilibrium."""
    blocks = compress(4, 6, MORTAR, compression=0.05)
    assert np.ptp(blocks.stress) <= 1e-7


@cache
def impact(method: str) -> tuple[scenes.Scene, scenes.History]:
    """Throw the hollow ball against the plate."""
    scene = scenes.ball_plate(MPI.COMM_WORLD, method=method)
    return scene, scene.run(40)


def test_impact_conserves_energy_and_momenta_to_round_off():
    _, history = impact("mortar")
    assert max(history.num_active) >= 9
    assert history.energy_error <= 1e-12
    assert max(history.linear_drift, history.angular_drift) <= 1e-12
    assert np.mean(history.iterations) <= 4.5
    assert max(history.iterations) <= 8


def test_impact_is_that_of_nodes_and_segments_but_for_the_mesh():
    (_, mortar), (_, nodes) = impact("mortar"), impact("node-to-segment")
    assert mortar.kinetic[-1] == pytest.approx(nodes.kinetic[-1], rel=5e-3)
    assert not np.allclose(mortar.kinetic, nodes.kinetic, rtol=1e-6)


def test_linear_solver_needs_no_whole_systems_and_few_more_iterations():
    (mortar, _), (nodes, _) = impact("mortar"), impact("node-to-segment")
    solvers = [scene.stepper.statistics.solver for scene in (mortar, nodes)]
    assert solvers[0].num_direct == 0
    assert solvers[0].num_iterations <= 1.3 * solvers[1].num_iterations
