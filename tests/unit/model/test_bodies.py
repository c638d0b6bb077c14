"""Bodies: cells of a tag, forms over bodies, inverted cells."""

import re

from mpi4py import MPI

import basix
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, GhostMode, create_box, create_rectangle, meshtags

import dolfinx_nts as nts
from dolfinx_nts.fem.components import deformation_gradient
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.model.bodies import bulk_form, check_bodies
from dolfinx_nts.model.checks.inverted_cells import VolumeRatio
from helpers import scenes
from helpers.models import box_meshes
from helpers.scene import input_ids

pytestmark = pytest.mark.at_most_two_ranks

RUBBER = nts.SaintVenantKirchhoff(E=1.0e3, nu=0.3, rho=10.0)
# Round-off of sums over some hundred quadrature points.
ROUNDING = 1e3 * np.finfo(float).eps

cells_ = pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
ghosts_ = pytest.mark.parametrize("ghosts", [GhostMode.none, GhostMode.shared_facet])


def two_boxes(comm, cell="hexahedron", ghosts=GhostMode.none):
    """Space and tags of boxes of volumes 0.72 and 0.256."""
    data = box_meshes.boxes([(3, 3, 2), (2, 2, 2)], [(1.2, 1.2, 0.5), (0.8, 0.8, 0.4)], cell)
    mesh, cells, facets, tag = box_meshes.distribute(comm, data, ghosts=ghosts)
    return fem.functionspace(mesh, ("Lagrange", 1, (3,))), cells, facets, tag


def integral(form):
    return form_comm(form).allreduce(fem.assemble_scalar(fem.form(form)))


def form_comm(form):
    return form.ufl_domain().ufl_cargo().comm


@cells_
@ghosts_
def test_cells_of_the_bodies_are_owned_and_counted_once(comm, cell, ghosts):
    V, cells, _, tag = two_boxes(comm, cell, ghosts)
    bodies = [nts.Body(V, cells, tag[f"body {i}"], RUBBER) for i in range(2)]
    per_box = 6 if cell == "tetrahedron" else 1
    counts = [comm.allreduce(len(body.cells)) for body in bodies]
    assert counts == [18 * per_box, 8 * per_box]
    owned = V.mesh.topology.index_map(3).size_local
    assert comm.allreduce(sum(np.count_nonzero(body.cells >= owned) for body in bodies)) == 0


@cells_
@ghosts_
def test_every_local_node_belongs_to_its_body_on_every_rank(comm, cell, ghosts):
    # Velocities are set through them, owned and ghost.
    V, cells, _, tag = two_boxes(comm, cell, ghosts)
    bodies = [nts.Body(V, cells, tag[f"body {i}"], RUBBER) for i in range(2)]
    ids, first = input_ids(V), 4 * 4 * 3
    wrong = sum(
        np.count_nonzero(np.setxor1d(body.nodes, np.flatnonzero((ids >= first) == bool(i))))
        for i, body in enumerate(bodies)
    )
    assert comm.allreduce(wrong) == 0


@cells_
@ghosts_
def test_density_integrates_to_the_mass_of_all_bodies(comm, cell, ghosts):
    V, cells, _, tag = two_boxes(comm, cell, ghosts)
    steel = nts.SaintVenantKirchhoff(E=1.0e5, nu=0.2, rho=70.0)
    bodies = [
        nts.Body(V, cells, tag[f"body {i}"], material) for i, material in enumerate((RUBBER, steel))
    ]
    mass = integral(bulk_form(bodies, lambda material, numbers, rho: rho))
    np.testing.assert_allclose(mass, 10 * 0.72 + 70 * 0.256, rtol=ROUNDING)
    shear = integral(bulk_form(bodies, lambda material, numbers, rho: numbers["mu"]))
    expected = 1.0e3 / 2.6 * 0.72 + 1.0e5 / 2.4 * 0.256
    np.testing.assert_allclose(shear, expected, rtol=ROUNDING)


def test_bodies_of_one_material_share_an_integral_and_numbers_compile_nothing(comm):
    V, cells, _, tag = two_boxes(comm)
    v = fem.Function(V)

    def form(*materials):
        bodies = [nts.Body(V, cells, tag[f"body {i}"], m) for i, m in enumerate(materials)]
        return bulk_form(bodies, lambda m, numbers, rho: rho * ufl.inner(v, v) * numbers["mu"])

    stiffer = nts.SaintVenantKirchhoff(E=7.0e3, nu=0.1, rho=3.0)
    assert len(form(RUBBER, RUBBER).integrals()) == 1
    assert len(form(RUBBER, stiffer).integrals()) == 2
    assert form(RUBBER, RUBBER).signature() == form(stiffer, stiffer).signature()


@cells_
def test_no_cell_is_inverted_under_a_large_rotation(comm, cell):
    V, *_ = two_boxes(comm, cell)
    u = fem.Function(V)
    Q = scenes.rotation([1, 2, 3], 2.5)
    u.interpolate(lambda X: (Q - np.eye(3)) @ X)
    assert VolumeRatio(u).inverted() == ""


@cells_
def test_inverted_cell_is_named_by_its_input_number_and_place(comm, cell, agree):
    V, *_ = two_boxes(comm, cell)
    u = fem.Function(V)
    # The first node, a corner of the first cell only, is pushed through it.
    corner = np.flatnonzero(input_ids(V) == 0)
    u.x.array.reshape(-1, 3)[corner] = [2.0, 2.0, 1.0]
    text = VolumeRatio(u).inverted()
    assert agree(re.fullmatch(r"cell \d+ near \[.*\] is inverted, det F = -\d.*", text))
    number = int(text.split()[1])
    # Node 0 lies in hexahedron 0, or in the tetrahedra cut from it.
    assert agree(number < (6 if cell == "tetrahedron" else 1))


@pytest.mark.parametrize(
    ("cell", "degree", "axisymmetric"),
    [
        ("hexahedron", 2, False),
        ("tetrahedron", 1, False),
        ("triangle", 2, False),
        ("quadrilateral", 1, True),
    ],
)
def test_least_volume_ratio_agrees_with_the_deformation_gradient(cell, degree, axisymmetric):
    kind, dim = getattr(CellType, cell), 3 if cell.endswith("hedron") else 2
    create = create_box if dim == 3 else create_rectangle
    mesh = create(MPI.COMM_SELF, [(0.2, 0, 0)[:dim], (1.4, 1, 0.7)[:dim]], (3, 2, 2)[:dim], kind)
    if axisymmetric:
        nts.axisymmetric(mesh)
    V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    u, number = fem.Function(V), 5
    u.x.array[:] = 1e-3 * np.random.default_rng(1).normal(size=len(u.x.array))
    node = V.dofmap.cell_dofs(number)[0]
    u.x.array[dim * node : dim * (node + 1)] = 2.0
    degree = Element.of(V).stress_degree
    points, _ = basix.make_quadrature(basix.CellType[cell], degree)
    ratio = fem.Expression(ufl.det(deformation_gradient(u)), points)
    cells = np.arange(mesh.topology.index_map(dim).size_local, dtype=np.int32)
    values = ratio.eval(mesh, cells).min(axis=1)
    text = VolumeRatio(u).inverted()
    worst = np.argmin(values)
    assert text.startswith(f"cell {mesh.topology.original_cell_index[worst]} near")
    assert text.endswith(f"det F = {values[worst]:.3g}")


def test_bodies_must_fill_the_mesh_once(comm, refused):
    V, cells, _, tag = two_boxes(comm)
    first, second = (nts.Body(V, cells, tag[f"body {i}"], RUBBER) for i in range(2))
    assert check_bodies([first, second]) == V
    with refused(ValueError, "given 8 cells in none and 0 in several"):
        check_bodies([first])
    with refused(ValueError, "given 0 cells in none and 18 in several"):
        check_bodies([first, first, second])
    with refused(ValueError, "at least one body, given none"):
        check_bodies([])
    with refused(TypeError, "expected a Body, given str"):
        check_bodies([first, "second"])
    W = fem.functionspace(V.mesh, ("Lagrange", 1, (3,)))
    with refused(ValueError, "one function space, given several"):
        check_bodies([first, nts.Body(W, cells, tag["body 1"], RUBBER)])


def test_body_refuses_wrong_arguments(comm, refused):
    V, cells, facets, tag = two_boxes(comm)
    mesh = V.mesh
    with refused(ValueError, r"one of the tags \[0, 1\] of cells, given 7"):
        nts.Body(V, cells, 7, RUBBER)
    with refused(ValueError, "cells of dimension 3, given tags of dimension 2"):
        nts.Body(V, facets, tag["top 0"], RUBBER)
    with refused(TypeError, r"integer tag, given 'ball': .* tag\['ball'\]"):
        nts.Body(V, cells, "ball", RUBBER)
    with refused(TypeError, "integer tag, given 1.0"):
        nts.Body(V, cells, 1.0, RUBBER)
    with refused(TypeError, "MeshTags as cells, given ndarray"):
        nts.Body(V, cells.values, 1, RUBBER)
    with refused(TypeError, r"such as NeoHookean\(E, nu, rho\), given float"):
        nts.Body(V, cells, 1, 1.0e5)
    other = two_boxes(comm)
    with refused(ValueError, "of the mesh of the function space, given those of another mesh"):
        nts.Body(V, other[1], tag["body 0"], RUBBER)
    cubic = fem.functionspace(mesh, ("Lagrange", 3, (3,)))
    with refused(ValueError, r"\('Lagrange', 1, \(3,\)\)\), or of degree 2, given .*3"):
        nts.Body(cubic, cells, 1, RUBBER)
    quadratic = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    with refused(ValueError, "without one_point, which is for degree 1, in a space of degree 2"):
        nts.Body(quadratic, cells, 1, nts.SaintVenantKirchhoff(1e5, 0.4, 1e3, one_point=["lmbda"]))
    scalar = fem.functionspace(mesh, ("Lagrange", 1))
    with refused(ValueError, r"degree 1 and values of shape \(\)"):
        nts.Body(scalar, cells, 1, RUBBER)
    broken = fem.functionspace(mesh, ("DG", 1, (3,)))
    with refused(ValueError, "expected the space functionspace"):
        nts.Body(broken, cells, 1, RUBBER)
    here = np.arange(mesh.topology.index_map(3).size_local if comm.rank == 0 else 0)
    only = meshtags(mesh, 3, here.astype(np.int32), np.full(len(here), 5, dtype=np.int32))
    body = nts.Body(V, only, 5, RUBBER)  # a tag of rank 0 alone is no error
    assert comm.allreduce(len(body.cells)) == comm.bcast(len(here))
