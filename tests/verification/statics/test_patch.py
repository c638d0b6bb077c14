"""Contact patch test (Taylor and Papadopoulos) by nodes and segments.

Two blocks of the same section lie on each other and are compressed: the
stress is the same everywhere. Node-to-segment contact with one pass does not
transmit it where nodes do not match, and refinement does not help (Zavarise
and De Lorenzis 2009; Hesch and Betsch 2011). The error is measured here, so
that the README is right, and so that a change of it is seen.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from helpers.laws import NODAL_PAIR
from helpers.models.compressed_blocks import compress
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

COMPRESSION = 1e-4
# Strains are of the size of the compression, the theory is linear.
EXACT = 10 * COMPRESSION


@cache
def stress_error(
    lower: int, upper: int, pairs: Callable[..., Any] = NODAL_PAIR
) -> tuple[float, float, list[float]]:
    """Error of the stress of blocks with given numbers of cells along an edge. Collective.

    Args:
        lower: Cells along an edge of the lower block.
        upper: Of the upper one.
        pairs: Returns the pair of two surfaces, or several.

    Returns:
        Largest at a midpoint of a cell, and root mean square, relative; and the integral of
        the contact pressure on each side with nodes, relative to the force between the blocks.
    """
    comm = MPI.COMM_WORLD
    blocks = compress(lower, upper, pairs, compression=COMPRESSION)
    stepper, error = blocks.stepper, blocks.stress - 1
    largest = comm.allreduce(np.abs(error).max(initial=0.0), op=MPI.MAX)
    sums = comm.allreduce(np.array([np.sum(error**2), error.size]))
    pressed = [contact.pressure @ contact.nodes.area for contact in stepper.contacts]
    force = -sum(contact.history.lambda_N.sum() for contact in stepper.contacts)
    *forces, force = comm.allreduce(np.array([*pressed, force]))
    return float(largest), float(np.sqrt(sums[0] / sums[1])), [f / force for f in forces]


def test_matching_meshes_pass_the_patch_test():
    """Uniform pressure, where nodes of both surfaces coincide."""
    assert stress_error(4, 4)[0] <= EXACT


# Largest error of the stress: nodes on the finer surface, and on the coarser one.
FINER_AS_NODES, COARSER_AS_NODES = 0.118, 0.387
# Change of the largest error by refinement.
CHANGE = 0.05


@pytest.mark.serial
@pytest.mark.parametrize("finer_as_nodes", [True, False])
def test_error_of_the_patch_test_agrees_with_the_readme(finer_as_nodes, table_row):
    """4 cells along an edge against 6, 8 against 12: no convergence at the contact."""
    meshes = [(4, 6), (8, 12)] if finer_as_nodes else [(6, 4), (12, 8)]
    (coarse, coarse_mean, _), (fine, fine_mean, _) = (stress_error(*mesh) for mesh in meshes)
    table_row(
        f"{'finer' if finer_as_nodes else 'coarser'} side as nodes, 4:6 and 8:12 cells",
        "uniform stress, which one pass does not transmit (Zavarise and De Lorenzis 2009)",
        f"largest error {100 * coarse:.0f} and {100 * fine:.0f} %",
    )
    expected = FINER_AS_NODES if finer_as_nodes else COARSER_AS_NODES
    assert coarse == pytest.approx(expected, rel=CHANGE)
    assert fine == pytest.approx(expected, rel=CHANGE)
    # The layer of wrong cells gets thinner: order 1/2 in the mean.
    assert np.log2(coarse_mean / fine_mean) == pytest.approx(0.5, abs=0.1)


# With springs at the nodes of both; springs at the rim are softer.
BOTH = 0.0421


@pytest.mark.parametrize("meshes", [(4, 6), once((6, 4))])
def test_two_half_passes_prefer_no_side_in_the_patch_test(meshes, table_row):
    largest, _, pressed = stress_error(*meshes, nts.two_half_passes)
    table_row(
        f"two half passes, {meshes[0]}:{meshes[1]} cells",
        "uniform stress",
        f"largest error {100 * largest:.1f} %",
    )
    assert largest == pytest.approx(BOTH, rel=CHANGE)
    # Each pass alone has 0.68 and 0.32 of the force.
    assert pressed == pytest.approx([1.0, 1.0], abs=1e-9)


@pytest.mark.serial
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_error_of_the_patch_test_is_larger_at_degree_two(cell, table_row):
    stress = compress(4, 6, cell=cell, degree=2).stress
    largest = np.abs(stress - 1).max()
    table_row(
        f"displacements of degree 2, {cell}, middle of the cells, 4:6 cells",
        "uniform stress",
        f"largest error {100 * largest:.0f} %",
    )
    assert largest > 2 * FINER_AS_NODES


@pytest.mark.serial
def test_patch_test_is_passed_on_distorted_cells_with_one_point_or_all():
    """All nodes inside are moved by up to a fifth of an edge."""

    def error(**options):
        """Largest error of any component at the points of the Gauss rule."""
        stepper = compress(8, 8, jitter=0.2, **options).stepper
        material = stepper.bodies[0].material
        F = ufl.Identity(3) + ufl.grad(stepper.u)
        S = material.stress(F.T * F, **material.parameters)
        points = np.array(np.meshgrid(*[[0.5 - 12**-0.5, 0.5 + 12**-0.5]] * 3))
        mesh = stepper.u.function_space.mesh
        cells = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
        stress = fem.Expression(S, points.reshape(3, -1).T).eval(mesh, cells).reshape(-1, 3, 3)
        return np.abs(stress / -COMPRESSION - np.diag([0.0, 0.0, 1.0])).max()

    assert max(error(nu=0.3), error(nu=0.45), error(one_point=())) <= EXACT
