"""Matrix of the tangent: its age, and reuse of a former matrix."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers import scenes


def test_a_former_matrix_comes_back_bit_for_bit(comm, agree):
    stepper = scenes.blocks(comm).stepper
    tangent, u = stepper._tangent, stepper.u.x.array
    former = []
    for assemble in (tangent.assemble_nearby, tangent.assemble_exact):
        u[:] += 0.01 * np.sin(np.arange(len(u)) + len(former))
        stepper.u.x.scatter_forward()
        assemble()
        former.append((tangent.point, tangent.rows.value.copy(), tangent.nodal_stiffness()))
    present = u.copy()
    assert not np.array_equal(former[0][1], former[1][1])
    for count, (point, value, stiffness) in enumerate(former, start=3):
        tangent.restore(point)
        assert agree(np.array_equal(tangent.rows.value, value))
        assert agree(np.array_equal(tangent.nodal_stiffness(), stiffness))
        assert tangent.num_assembled == count
        np.testing.assert_array_equal(u, present)


def test_stiffness_of_nodes_asks_for_a_matrix_only_if_there_is_none(comm):
    tangent = scenes.blocks(comm).stepper._tangent
    first = tangent.nodal_stiffness()
    assert tangent.nodal_stiffness() is first and tangent.num_assembled == 1
    tangent.forget()
    np.testing.assert_array_equal(tangent.nodal_stiffness(), first)
    assert tangent.num_assembled == 2 and first.min() > 0


@pytest.mark.parametrize("E", [1e-6, 1e5])
def test_given_displacements_do_not_count_as_stiffness_in_any_units(comm, E):
    """A bar between supports; one of them acts in one direction only."""

    def build(model):
        parts.add_box(model, "bar", corner=(0, 0, 0), size=(3, 1, 1), cells=(3, 1, 1))

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    X = V.tabulate_dof_coordinates()
    held = np.flatnonzero(X[:, 0] < 0.1).astype(np.int32)
    (sliding,) = np.nonzero(X[:, 0] > 2.9)
    bcs = [
        fem.dirichletbc(np.zeros(3), held, V),
        fem.dirichletbc(0.0, (3 * sliding).astype(np.int32), V.sub(0)),
    ]
    body = nts.Body(V, cells, tag["bar"], nts.SaintVenantKirchhoff(E, 0.3, E))
    free, supported = (
        nts.EnergyMomentum([body], dt=1.0, bcs=given)._tangent.nodal_stiffness()
        for given in ([], bcs)
    )
    n = len(free)
    x = X[:n, 0]
    within, at_end = (x > 0.1) & (x < 2.9), x > 2.9
    np.testing.assert_allclose(supported[within], free[within], rtol=1e-12)
    # The corner of a cube of edge 1 has the same stiffness in all directions.
    np.testing.assert_allclose(supported[at_end], free[at_end], rtol=1e-12)
    known = comm.allreduce([*supported[within | at_end]])
    np.testing.assert_allclose(supported[x < 0.1], np.mean(known), rtol=1e-12)


def test_a_soft_body_keeps_its_stiffness_next_to_a_stiff_one(comm):
    """Rubber that lies on steel, of which springs and many tests take their scale."""

    def build(model):
        parts.add_rectangle(model, "below", corner=(0, 0), size=(3, 1), cells=(3, 2))
        parts.add_rectangle(model, "above", corner=(1, 1), size=(1, 1), cells=(2, 2))

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    above = nts.Body(V, cells, tag["above"], nts.NeoHookean(E=1e6, nu=0.3, rho=1e3))
    soft, stiff = (
        nts.Body(V, cells, tag["below"], nts.NeoHookean(E=E, nu=0.3, rho=1e3)) for E in (1e6, 2e11)
    )
    held = fem.locate_dofs_geometrical(V, lambda x: x[1] > 1.99)
    bcs = [fem.dirichletbc(np.zeros(2), held, V)]
    alone, together = (
        nts.QuasiStatic([above, below], dt=1.0, bcs=bcs)._tangent.nodal_stiffness()
        for below in (soft, stiff)
    )
    nodes = above.nodes[above.nodes < len(alone)]
    is_free = V.tabulate_dof_coordinates()[nodes, 1] < 1.99
    np.testing.assert_allclose(together[nodes[is_free]], alone[nodes[is_free]], rtol=1e-12)
    # Clamped nodes have the mean stiffness of their own body.
    known = comm.allreduce([*together[nodes[is_free]]])
    np.testing.assert_allclose(together[nodes[~is_free]], np.mean(known), rtol=1e-12)
