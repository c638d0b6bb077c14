"""Numbers and reference positions of nodes are computed once per space, and never out of date."""

import gc

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import create_unit_cube

import dolfinx_nts as nts
from dolfinx_nts.fem import node_numbering
from dolfinx_nts.fem.node_numbering import input_ids, reference_positions

pytestmark = pytest.mark.serial


def _space(degree=1):
    mesh = create_unit_cube(MPI.COMM_WORLD, 2, 2, 2)
    return fem.functionspace(mesh, ("Lagrange", degree, (3,)))


@pytest.mark.parametrize("degree", [1, 2])
def test_positions_equal_those_of_dolfinx_and_cannot_be_changed(degree):
    V = _space(degree)
    np.testing.assert_array_equal(reference_positions(V), V.tabulate_dof_coordinates())
    for known in reference_positions(V), input_ids(V):
        with pytest.raises(ValueError, match="read-only"):
            known[...] = 0


def test_positions_follow_the_geometry_of_the_mesh():
    V = _space()
    before = reference_positions(V).copy()
    V.mesh.geometry.x[:] *= 2
    np.testing.assert_array_equal(reference_positions(V), 2 * before)


def test_positions_and_numbers_go_with_their_space():
    V = _space()
    reference_positions(V), input_ids(V)
    key = id(V)
    del V
    gc.collect()
    assert key not in node_numbering._IDS
    assert key not in node_numbering._POSITIONS


def test_work_of_whole_spaces_does_not_grow_with_the_number_of_bodies(monkeypatch):
    """Positions are tabulated equally often in the set-up of 2 and of 12 bodies."""

    def num_tabulations(num_bodies):
        def build(model):
            for i in range(num_bodies):
                nts.parts.add_box(
                    model, f"box {i}", corner=(2 * i, 0, 0), size=(1, 1, 1), cells=(1, 1, 1)
                )

        mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        material = nts.NeoHookean(E=1e5, nu=0.3, rho=1e3)
        calls = []
        tabulate = fem.FunctionSpace.tabulate_dof_coordinates
        with monkeypatch.context() as patch:
            patch.setattr(
                fem.FunctionSpace,
                "tabulate_dof_coordinates",
                lambda space: calls.append(1) or tabulate(space),
            )
            bodies = [nts.Body(V, cells, tag[f"box {i}"], material) for i in range(num_bodies)]
            nts.EnergyMomentum(
                bodies,
                nts.all_pairs(
                    bodies, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
                ),
                dt=1e-3,
            )
        return len(calls)

    assert num_tabulations(2) == num_tabulations(12) <= 3
