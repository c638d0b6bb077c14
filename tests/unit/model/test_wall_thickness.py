"""Thickness of bodies behind their facets, against closed forms."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.model.thickness import wall_thickness
from dolfinx_nts.search.nodal_facets import NodalFacets

RUBBER = nts.NeoHookean(1e5, 0.3, 1e3)
SIZE = (0.8, 0.6, 0.1)


def middles(surface):
    X = surface.V.tabulate_dof_coordinates()
    return X[surface.segments].mean(axis=1)


@pytest.mark.parametrize("dim", [2, 3])
def test_box_is_as_thick_as_its_opposite_faces_are_apart(comm, dim, agree):
    size = SIZE[:1] + SIZE[2:] if dim == 2 else SIZE
    add = parts.add_rectangle if dim == 2 else parts.add_box

    def fill(model):
        add(model, "sheet", corner=(0,) * dim, size=size, cells=(4, 3, 2)[:dim])
        # Another body touches it, and does not count.
        other = (0,) * (dim - 1) + (-0.4,)
        add(model, "pad", corner=other, size=(*size[:-1], 0.4), cells=(2, 2, 2)[:dim])

    mesh, cells, _, tag = nts.read_mesh(fill, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
    sheet = nts.boundary_of(nts.Body(V, cells, tag["sheet"], RUBBER))
    expected = np.full(len(sheet.segments), np.nan)
    at = middles(sheet)
    for axis in range(dim):
        on_face = np.isclose(at[:, axis], 0) | np.isclose(at[:, axis], size[axis])
        expected[on_face] = size[axis]
    found = wall_thickness(sheet, 10.0)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    np.testing.assert_allclose(wall_thickness(sheet, 0.3), np.fmin(expected, 0.3), rtol=1e-5)
    assert agree(np.isfinite(found).all())
    # Only one rank has a facet of this surface.
    end = nts.boundary_of(
        nts.Body(V, cells, tag["sheet"], RUBBER),
        where=lambda x: (x[0] < 0.21) & (x[-1 if dim == 3 else 1] < 1e-9) & (x[dim - 2] < 0.21),
    )
    np.testing.assert_allclose(wall_thickness(end, 10.0), size[-1], rtol=1e-5)


@pytest.mark.serial
def test_wedge_is_thinner_towards_its_tip(comm):
    slope = 0.5

    def fill(model):
        corners = [model.occ.addPoint(*point, 0) for point in ((0, 0), (1, 0), (1, slope))]
        edges = [model.occ.addLine(corners[i], corners[(i + 1) % 3]) for i in range(3)]
        model.occ.addPlaneSurface([model.occ.addCurveLoop(edges)])
        model.occ.synchronize()
        model.addPhysicalGroup(2, [1], name="wedge")
        model.mesh.setSize(model.getEntities(0), 0.05)
        model.mesh.generate(2)

    mesh, cells, _, tag = nts.read_mesh(fill, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    body = nts.Body(V, cells, tag["wedge"], RUBBER)
    bottom = nts.boundary_of(body, where=lambda x: x[1] < 1e-9)
    np.testing.assert_allclose(
        wall_thickness(bottom, 2.0), slope * middles(bottom)[:, 0], rtol=1e-4
    )


def test_cached_geometry_is_renewed_on_all_ranks_after_one_has_moved_its_nodes(comm, agree):
    def fill(model):
        parts.add_box(model, "sheet", corner=(0, 0, 0), size=SIZE, cells=(4, 3, 2))

    mesh, cells, _, tag = nts.read_mesh(fill, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    sheet = nts.boundary_of(nts.Body(V, cells, tag["sheet"], RUBBER))
    before = wall_thickness(sheet, 10.0), NodalFacets.of(sheet)
    assert NodalFacets.of(sheet) is before[1]
    if comm.rank == comm.size - 1:
        mesh.geometry.x[:] += 1e-9
    after = wall_thickness(sheet, 10.0), NodalFacets.of(sheet)
    assert agree(np.allclose(before[0], after[0], rtol=1e-5))
    assert agree(after[1] is not before[1])
