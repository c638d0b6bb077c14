"""Redistribution of surface mass to the nodes below: invariants of the consistent mass."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.integrators.rates import ConsistentMass
from dolfinx_nts.model.extrapolation import extrapolate
from dolfinx_nts.solvers.massless.redistributed_mass import RedistributedMass
from helpers.models import box_meshes

# Relative; sums of a few hundred terms of both signs.
ROUND_OFF = 1e-13


def skewed(X):
    """Shear and bend a unit box."""
    x, y, z = X.T
    return np.column_stack([x + 0.3 * z**2 + 0.1 * y * z, y - 0.2 * x * z, z + 0.2 * x * y])


@pytest.fixture(
    params=[
        *("hexahedron", "tetrahedron", "skewed hexahedron"),
        *("hexahedron of degree 2", "tetrahedron of degree 2", "skewed hexahedron of degree 2"),
    ]
)
def body(comm, request):
    """Return a body whose bottom and one side have no mass, and these nodes.

    At degree 2 there is one layer of cells above the bottom, and behind the side.
    """
    degree = 2 if "2" in request.param else 1
    cell = next(word for word in request.param.split() if word.endswith("hedron"))
    cells_along = {1: (3, 4, 5), 2: (1, 2, 1)}[degree]
    data = box_meshes.boxes([cells_along], [(1.2, 1.0, 1.3)], cell)
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    X = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]
    massless = np.isclose(X[:, 2], 0) | np.isclose(X[:, 0], 0)
    if "skewed" in request.param:
        mesh.geometry.x[:] = skewed(mesh.geometry.x)
    body = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(1.0, 0.3, 7.0))
    return body, np.flatnonzero(massless).astype(np.int32)


def test_all_moments_up_to_inertia_are_kept_and_surface_nodes_have_no_mass(comm, body, agree):
    body, massless = body
    V, rate = body.V, fem.Function(body.V)
    n = V.dofmap.index_map.size_local
    mass = RedistributedMass([body], extrapolate([body], massless))
    X = V.tabulate_dof_coordinates()[:n]
    fields = np.column_stack([np.ones(n), X])
    products = np.zeros((2, 4, 4))
    for i, field in enumerate(fields.T):
        rate.x.array[: 3 * n] = np.repeat(field, 3)
        rate.x.scatter_forward()
        response = mass.times(np.repeat(field[:, None], 3, axis=1))
        assert agree(np.all(response[massless] == 0))
        products[0, i] = fields.T @ response[:, 0]
        products[1, i] = fields.T @ ConsistentMass([body], rate).momentum()[:, 0]
    moments, exact = comm.allreduce(products)
    assert agree(np.abs(moments - exact).max() <= ROUND_OFF * np.abs(exact).max())


def test_it_is_symmetric_and_positive_on_all_other_nodes(comm, body, agree):
    body, massless = body
    n = body.V.dofmap.index_map.size_local
    mass = RedistributedMass([body], extrapolate([body], massless))
    rng = np.random.default_rng(comm.rank)
    a, b = rng.normal(size=(2, n, 3))
    a_b, b_a, a_a = comm.allreduce(
        np.array([np.vdot(a, mass.times(b)), np.vdot(b, mass.times(a)), np.vdot(a, mass.times(a))])
    )
    assert agree(abs(a_b - b_a) <= ROUND_OFF * a_a)
    row, column, value = mass.entries(body.V.dofmap.index_map)
    if comm.size == 1:
        matrix = np.zeros((n, n))
        matrix[row, column] = value
        others = np.setdiff1d(np.arange(n), massless)
        eigenvalues = np.linalg.eigvalsh(matrix[np.ix_(others, others)])
        assert eigenvalues[0] > 1e-3 * eigenvalues[-1]


def test_forces_keep_resultant_and_moment(comm, body, agree):
    body, massless = body
    n = body.V.dofmap.index_map.size_local
    mass = RedistributedMass([body], extrapolate([body], massless))
    X = body.V.tabulate_dof_coordinates()[:n]
    f = np.random.default_rng(comm.rank).normal(size=(n, 3))
    carried = mass.carried(f)
    assert agree(np.all(carried[massless] == 0))
    sums = [
        comm.allreduce(np.concatenate([f.sum(axis=0), np.cross(X, f).sum(axis=0)]))
        for f in (f, carried)
    ]
    assert agree(np.abs(sums[1] - sums[0]).max() <= 1e-12 * np.sqrt(len(massless) + 1))


@pytest.mark.at_most_two_ranks
def test_a_body_with_one_layer_of_nodes_below_is_refused(comm):
    data = box_meshes.boxes([(3, 3, 1)], [(1.0, 1.0, 0.2)])
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    body = nts.Body(V, cells, tag["body 0"], nts.NeoHookean(1.0, 0.3, 7.0))
    n = V.dofmap.index_map.size_local
    bottom = np.flatnonzero(V.tabulate_dof_coordinates()[:n, 2] < 0.1).astype(np.int32)
    with pytest.raises(ValueError, match=r"two layers of nodes below .* at 16 nodes: 0, 1"):
        extrapolate([body], bottom)
