"""Accepted function spaces, and messages for others."""

import basix.ufl
import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import (
    CellType,
    create_mesh,
    create_unit_cube,
    create_unit_interval,
    create_unit_square,
    meshtags,
)

from dolfinx_nts.fem.elements import check_space, check_tag

pytestmark = pytest.mark.at_most_two_ranks


def cube(comm, cell):
    return create_unit_cube(comm, 2, 2, 2, CellType[cell])


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_vector_spaces_of_degree_1_and_2_are_taken(comm, cell, degree):
    check_space(fem.functionspace(cube(comm, cell), ("Lagrange", degree, (3,))))


@pytest.mark.parametrize(
    "element",
    [
        ("Lagrange", 3, (3,)),
        ("Lagrange", 1),
        ("Lagrange", 1, (2,)),
        ("Discontinuous Lagrange", 1, (3,)),
        ("Nedelec 1st kind H(curl)", 1),
    ],
    ids=lambda element: "-".join(map(str, element)),
)
def test_other_elements_are_refused(comm, element, refused):
    V = fem.functionspace(cube(comm, "tetrahedron"), element)
    with refused(ValueError, r"expected the space functionspace\(.* degree \d and values of shape"):
        check_space(V)


@pytest.mark.parametrize("kind", ["interval", "prism"])
def test_meshes_of_other_cells_are_refused(comm, kind, refused):
    mesh = {
        "interval": lambda: create_unit_interval(comm, 8),
        "prism": lambda: cube(comm, "prism"),
    }[kind]()
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    with refused(ValueError, f"mesh of tetrahedra or hexahedra .*, given {kind} cells"):
        check_space(V)


@pytest.mark.parametrize(("degree", "components"), [(1, 3), (3, 2)])
def test_spaces_in_the_plane_have_two_components_and_degree_one_or_two(
    comm, degree, components, refused
):
    square = create_unit_square(comm, 3, 3)
    for good in (1, 2):
        check_space(fem.functionspace(square, ("Lagrange", good, (2,))))
    V = fem.functionspace(square, ("Lagrange", degree, (components,)))
    with refused(ValueError, r"expected the space functionspace\(mesh, \('Lagrange', 1, \(2,\)\)"):
        check_space(V)


def test_curved_cells_go_with_displacements_of_their_degree(comm, refused):
    element = basix.ufl.element("Lagrange", "tetrahedron", 2, shape=(3,))
    X = element.basix_element.points
    cells = np.arange(10, dtype=np.int64)[None] if comm.rank == 0 else np.empty((0, 10), np.int64)
    mesh = create_mesh(comm=comm, cells=cells, x=X if comm.rank == 0 else X[:0], e=element)
    check_space(fem.functionspace(mesh, ("Lagrange", 2, (3,))))
    with refused(ValueError, "cells of degree 1, .*given a mesh of degree 2: displacements of"):
        check_space(fem.functionspace(mesh, ("Lagrange", 1, (3,))))


def test_tag_that_one_rank_has_is_taken_on_all_and_another_named(comm, refused):
    mesh = cube(comm, "tetrahedron")
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    mine = np.zeros(1 if comm.rank == comm.size - 1 else 0, dtype=np.int32)
    tags = meshtags(mesh, 3, mine, np.full_like(mine, 5))
    check_tag(V, tags, 5, 3, "cells")
    check_tag(V, tags, np.int64(5), 3, "cells")
    with refused(ValueError, r"expected one of the tags \[5\] of cells, given 6"):
        check_tag(V, tags, 6, 3, "cells")
    with refused(ValueError, "expected facets of dimension 2, given tags of dimension 3"):
        check_tag(V, tags, 5, 2, "facets")
    for wrong in (None, True, 5.0, "ball"):
        with refused(TypeError, f"expected an integer tag, given {wrong!r}"):
            check_tag(V, tags, wrong, 3, "cells")
    with refused(TypeError, "expected MeshTags as cells, given ndarray"):
        check_tag(V, tags.values, 5, 3, "cells")
