"""Numbers and reference positions of nodes are computed once per space, and never out of date."""

import gc

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem, la
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


def test_positions_follow_the_geometry_between_two_contexts_without_changes():
    V = _space()
    with node_numbering.geometry_unchanged():
        with node_numbering.geometry_unchanged():
            before = reference_positions(V)
        assert reference_positions(V) is before
    V.mesh.geometry.x[:] *= 2
    with node_numbering.geometry_unchanged():
        np.testing.assert_array_equal(reference_positions(V), 2 * before)
        key = id(V)
        del V
        gc.collect()
        assert key not in node_numbering._UNCHANGED


def _boxes(num_bodies):
    """Space and bodies of some boxes side by side."""

    def build(model):
        for i in range(num_bodies):
            nts.parts.add_box(
                model, f"box {i}", corner=(2 * i, 0, 0), size=(1, 1, 1), cells=(1, 1, 1)
            )

    mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.NeoHookean(E=1e5, nu=0.3, rho=1e3)
    return [nts.Body(V, cells, tag[f"box {i}"], material) for i in range(num_bodies)]


def test_a_stepper_sees_a_geometry_that_changed_after_its_bodies_and_pairs():
    bodies = _boxes(2)
    pairs = nts.all_pairs(bodies)
    before = reference_positions(bodies[0].V).copy()
    bodies[0].V.mesh.geometry.x[:] += 1
    stepper = nts.CentralDifference(bodies, pairs, dt=1e-5)
    stepper.advance()
    V = bodies[0].V
    np.testing.assert_array_equal(stepper._X, V.tabulate_dof_coordinates())
    np.testing.assert_allclose(stepper._X, before + 1)


def test_vectors_and_comparisons_of_whole_spaces_do_not_grow_with_the_number_of_bodies(monkeypatch):
    """The set-up of explicit steps has as many of both for 12 bodies as for 4."""

    def num_of_both(num_bodies):
        vectors, comparisons = [], []

        def vector(*arguments):
            vectors.append(1)
            return given[0](*arguments)

        def array_equal(one, other):
            comparisons.append(len(one) == 8 * num_bodies)
            return given[1](one, other)

        given = la.vector, np.array_equal
        with monkeypatch.context() as patch:
            patch.setattr(la, "vector", vector)
            patch.setattr(np, "array_equal", array_equal)
            bodies = _boxes(num_bodies)
            pairs = nts.all_pairs(bodies)
            nts.CentralDifference(bodies, pairs, dt=1e-5)
        return len(vectors), sum(comparisons)

    assert num_of_both(4) == num_of_both(12)


def test_work_of_whole_spaces_does_not_grow_with_the_number_of_bodies(monkeypatch):
    """Positions are tabulated equally often in the set-up of 2 and of 12 bodies."""

    def num_tabulations(num_bodies):
        calls = []
        tabulate = fem.FunctionSpace.tabulate_dof_coordinates
        with monkeypatch.context() as patch:
            patch.setattr(
                fem.FunctionSpace,
                "tabulate_dof_coordinates",
                lambda space: calls.append(1) or tabulate(space),
            )
            bodies = _boxes(num_bodies)
            nts.EnergyMomentum(
                bodies,
                nts.all_pairs(
                    bodies, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
                ),
                dt=1e-3,
            )
        return len(calls)

    assert num_tabulations(2) == num_tabulations(12) <= 3
