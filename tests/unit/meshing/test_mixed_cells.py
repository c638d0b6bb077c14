"""Prisms and mixed cells, cut into hexahedra; volumes and areas in closed form."""

import logging
import re
from typing import Any

import numpy as np
import pytest
from dolfinx.mesh import CellType

from dolfinx_nts.meshing.gmsh import read_mesh
from dolfinx_nts.meshing.parts import add_box
from helpers.models.gmsh_models import BOX, ROUNDING, count, measure

KINDS = {"hexahedra": 5, "tetrahedra": 4}  # gmsh element types


def add_prisms(model: Any) -> int:
    """Add a block of prisms, 1 x 1 x 1/2, with tetrahedra on top, up to z = 1."""
    corner = model.occ.addRectangle(3, 0, 0, 1, 1)
    prisms = model.occ.extrude([(2, corner)], 0, 0, 0.5, numElements=[2], recombine=True)
    tetrahedra = model.occ.extrude([prisms[0]], 0, 0, 0.5)
    model.occ.synchronize()
    model.mesh.setSize(model.getEntities(0), 0.4)
    volumes = [prisms[1][1], tetrahedra[1][1]]
    model.addPhysicalGroup(3, volumes, name="block")
    model.addPhysicalGroup(2, [corner], name="block.bottom")
    model.addPhysicalGroup(2, [tetrahedra[0][1]], name="block.top")
    model.mesh.generate(3)
    return len(model.mesh.getElementsByType(6)[0])


def test_prisms_and_tetrahedra_of_one_body_still_fit(comm, caplog):
    with caplog.at_level(logging.WARNING, logger="dolfinx_nts"):
        data = read_mesh(add_prisms, comm)
    assert data.mesh.topology.cell_type == CellType.hexahedron
    assert measure(data) == pytest.approx(1, rel=ROUNDING)
    # Non-matching facets would be on the boundary, too.
    assert measure(data, kind="ds") == pytest.approx(6, rel=ROUNDING)
    assert measure(data, "block.bottom", "ds") == pytest.approx(1, rel=ROUNDING)
    assert measure(data, "block.top", "ds") == pytest.approx(1, rel=ROUNDING)
    if comm.rank == 0:
        assert re.search(r"\d+ Tetrahedron 4, \d+ Prism 6 are cut into \d+ hexahedra", caplog.text)


def test_each_kind_becomes_its_number_of_hexahedra(comm):
    given = {}

    def build(model: Any) -> None:
        given["prisms"] = add_prisms(model)
        add_box(model, "hexahedra", **BOX)
        add_box(model, "tetrahedra", **BOX | {"corner": (0, 0, 2)}, cell="tetrahedron")
        for name, kind in KINDS.items():
            given[name] = len(model.mesh.getElementsByType(kind)[0])

    data = read_mesh(build, comm)
    given = comm.bcast(given)
    assert count(data, data.cells, "hexahedra") == 8 * given["hexahedra"]
    others = count(data, data.cells, "tetrahedra") + count(data, data.cells, "block")
    assert others == 4 * given["tetrahedra"] + 6 * given["prisms"]
    for name in ("hexahedra", "tetrahedra", "block"):
        assert measure(data, name) == pytest.approx(1, rel=ROUNDING)


@pytest.mark.at_most_two_ranks
def test_a_live_model_stays_as_it_is(comm, model):
    def state() -> Any:
        import gmsh

        kinds = model.mesh.getElementTypes()
        return (
            model.getCurrent(),
            gmsh.model.list(),
            {int(kind): len(model.mesh.getElementsByType(kind)[0]) for kind in kinds},
            gmsh.option.getNumber("Mesh.SubdivisionAlgorithm"),
            gmsh.option.getNumber("Mesh.SaveAll"),
            gmsh.option.getNumber("General.Terminal"),
        )

    before = None
    if model:
        add_box(model, "a", **BOX)
        add_box(model, "b", **BOX | {"corner": (0, 0, 2)}, cell="tetrahedron")
        before = state()
    data = read_mesh(model, comm)
    assert sorted(data.tag) == sorted(
        f"{name}{side}"
        for name in "ab"
        for side in ("", *(f"_{s}" for s in ("left", "right", "front", "back", "bottom", "top")))
    )
    if model:
        assert state() == before


@pytest.mark.at_most_two_ranks
def test_cells_of_one_kind_are_left_alone(comm, caplog):
    with caplog.at_level(logging.WARNING, logger="dolfinx_nts"):
        for cell in ("hexahedron", "tetrahedron"):
            data = read_mesh(lambda model, cell=cell: add_box(model, "a", **BOX, cell=cell), comm)
            assert data.mesh.topology.cell_type == CellType[cell]
    assert not caplog.text


@pytest.mark.at_most_two_ranks
def test_elements_in_no_group_are_refused_as_ever(comm):
    def build(model: Any) -> None:
        add_box(model, "a", **BOX)
        add_box(model, "b", **BOX | {"corner": (0, 0, 2)}, cell="tetrahedron")
        model.removePhysicalGroups([(3, model.getPhysicalGroups(3)[-1][1])])

    with pytest.raises(ValueError, match=r"expected one physical group, given volume \d+"):
        read_mesh(build, comm)


@pytest.mark.at_most_two_ranks
def test_flat_prisms_are_refused(comm):
    def build(model: Any) -> None:
        volume = model.addDiscreteEntity(3)
        x = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
        model.mesh.addNodes(3, volume, range(1, 7), x.ravel())
        model.mesh.addElementsByType(volume, 6, [], range(1, 7))
        model.addPhysicalGroup(3, [volume])

    with pytest.raises(ValueError, match="6 inverted or degenerate cells"):
        read_mesh(build, comm)
