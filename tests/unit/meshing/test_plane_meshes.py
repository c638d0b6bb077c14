"""Meshes of dimension 2: surfaces are bodies, curves are parts of their boundaries."""

import logging
import re
from typing import Any

import numpy as np
import pytest
from dolfinx.mesh import CellType

from dolfinx_nts.meshing.gmsh import read_mesh
from dolfinx_nts.meshing.parts import add_rectangle
from helpers.models.gmsh_models import ROUNDING, measure

pytestmark = pytest.mark.at_most_two_ranks

TRIANGLE, QUADRILATERAL = 2, 3  # gmsh's types
# A square and an adjacent triangle, and their nodes.
NODES = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [2, 0, 0]]
MIXED = {QUADRILATERAL: [1, 2, 4, 3], TRIANGLE: [2, 5, 4]}
# A square of second order without a node in its middle.
SERENDIPITY = np.array(
    [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 0, 0], [2, 1, 0], [1, 2, 0], [0, 1, 0]]
)


def add_plate(model: Any) -> None:
    """Add a square with a square hole, and a square at its right that shares nodes with it."""
    occ = model.occ
    square, hole = (occ.addRectangle(x, x, 0, h, h) for x, h in ((0, 1), (0.25, 0.5)))
    plate, _ = occ.cut([(2, square)], [(2, hole)])
    occ.fragment(plate, [(2, occ.addRectangle(1, 0, 0, 1, 1))])
    occ.synchronize()
    for dim, entity in model.getEntities():
        x, y, _ = occ.getCenterOfMass(dim, entity) if dim else (0, 1, 0)
        if dim == 2:
            model.addPhysicalGroup(2, [entity], name="left" if x < 1 else "right")
        elif abs(y) < 1e-9:
            model.addPhysicalGroup(1, [entity], name="bottom" if x < 1 else "")
    model.mesh.setSize(model.getEntities(0), 0.3)
    model.mesh.generate(2)


def add_sheet(model: Any, x: Any, cells: Any) -> None:
    """Add one surface of given nodes and elements, by gmsh's type."""
    surface = model.addDiscreteEntity(2)
    model.mesh.addNodes(2, surface, range(1, len(x) + 1), np.ravel(x))
    for kind, vertices in cells.items():
        model.mesh.addElementsByType(surface, kind, [], vertices)
    model.addPhysicalGroup(2, [surface], name="sheet")


def test_surfaces_are_bodies_and_curves_their_boundaries(comm):
    data = read_mesh(add_plate, comm)
    assert data.mesh.geometry.dim == data.mesh.topology.dim == 2
    assert data.mesh.topology.cell_type == CellType.triangle
    assert {"left", "right", "bottom"} < set(data.tag) and len(data.tag) == 4
    assert measure(data, "left") == pytest.approx(0.75, rel=ROUNDING)
    assert measure(data, "right") == pytest.approx(1, rel=ROUNDING)
    assert measure(data, "bottom", "ds") == pytest.approx(1, rel=ROUNDING)
    assert measure(data, kind="ds") == pytest.approx(6 + 2, rel=ROUNDING)


def test_a_file_of_triangles_next_to_quadrilaterals_is_cut_into_these(
    comm, model, tmp_path, caplog
):
    file = comm.bcast(str(tmp_path / "mixed.msh"))
    if model:
        import gmsh

        add_sheet(model, NODES, MIXED)
        gmsh.write(file)
    with caplog.at_level(logging.WARNING, logger="dolfinx_nts"):
        data = read_mesh(file, comm)
    assert data.mesh.topology.cell_type == CellType.quadrilateral
    assert data.mesh.topology.index_map(2).size_global == 4 + 3
    assert measure(data, "sheet") == pytest.approx(1.5, rel=ROUNDING)
    assert measure(data, kind="ds") == pytest.approx(4 + 2**0.5, rel=ROUNDING)
    if comm.rank == 0:
        assert "1 Triangle 3, 1 Quadrilateral 4 are cut into 7 quadrilaterals" in caplog.text
        assert "round surfaces keep the kinks of their former facets" in caplog.text


@pytest.mark.parametrize(
    ("x", "cells", "message"),
    [
        (np.add(NODES, [0, 0, 0.1]), MIXED, r"surfaces in the plane z = 0, .* up to z = 0\.1"),
        (NODES[:4], {QUADRILATERAL: [1, 2, 3, 4]}, r"1 inverted or degenerate .* \[0\.5, 0\.5, 0"),
        (NODES[:2] + NODES[4:], {TRIANGLE: [1, 2, 3]}, "1 inverted or degenerate cells"),
        (
            SERENDIPITY,
            {16: range(1, 9)},
            r"given Quadrilateral 8; .*\(Mesh\.SecondOrderIncomplete = 0\)",
        ),
    ],
    ids=["out of the plane", "crossed", "flat", "incomplete"],
)
def test_meshes_out_of_the_plane_are_refused(comm, model, x, cells, message):
    if model:
        add_sheet(model, x, cells)
    try:
        read_mesh(model, comm)
    except ValueError as error:
        text = str(error)
    assert len(set(comm.allgather(text))) == 1
    assert re.search(message, text), text


def test_nodes_of_no_cell_of_the_plane_are_left_out(comm, model):
    if model:
        add_sheet(model, NODES, {TRIANGLE: [2, 5, 4]})
    data = read_mesh(model, comm)
    assert data.mesh.geometry.index_map().size_global == 3
    assert measure(data, "sheet") == pytest.approx(0.5, rel=ROUNDING)


def test_mirrored_cells_of_the_plane_keep_their_area(comm, model):
    if model:
        add_sheet(model, NODES[:4], {QUADRILATERAL: [1, 3, 4, 2]})
    assert measure(read_mesh(model, comm), "sheet") == pytest.approx(1, rel=ROUNDING)


@pytest.mark.parametrize(("cell", "number"), [("quadrilateral", 12), ("triangle", 24)])
def test_rectangles_are_exact(comm, cell, number):
    def build(model: Any) -> None:
        for name, x in (("one", 0), ("two", 5)):
            shape = {"corner": (x, -1), "size": (2, 0.75), "cells": (4, 3)}
            add_rectangle(model, name, **shape, cell=cell)

    data = read_mesh(build, comm)
    assert data.mesh.topology.index_map(2).size_global == 2 * number
    assert measure(data, "two") == pytest.approx(1.5, rel=ROUNDING)
    assert measure(data, kind="ds") == pytest.approx(2 * 5.5, rel=ROUNDING)
    for side, length in (("left", 0.75), ("right", 0.75), ("bottom", 2), ("top", 2)):
        assert measure(data, f"one_{side}", "ds") == pytest.approx(length, rel=ROUNDING)


@pytest.mark.serial
@pytest.mark.parametrize("wrong", [{"size": (1, 0)}, {"cells": (0, 1)}, {"cell": "hexahedron"}])
def test_impossible_rectangles_are_refused(model, wrong):
    good = {"corner": (0, 0), "size": (1, 1), "cells": (1, 1)}
    with pytest.raises(ValueError, match=r"expected (positive size|cell to be one of)"):
        add_rectangle(model, "a", **good | wrong)
