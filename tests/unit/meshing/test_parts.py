"""Parametric bodies: volumes, areas, surfaces, and cells that conform."""

from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import entities_to_geometry

from dolfinx_nts import parts
from dolfinx_nts.meshing.gmsh import MeshData, read_mesh
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

ROUNDING = 1e3 * np.finfo(float).eps  # of a sum over some hundred cells
CELLS = pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
PI = np.pi

BOX = {"corner": (0, 0, 0), "size": (1, 1, 1), "cells": (2, 2, 2)}
HOLLOW = {"inner_radius": 0.8, "outer_radius": 1.0}
WALL = HOLLOW | {"centre": (5, 0, 1), "cells_per_edge": 4, "layers": 2}
BALL = {"centre": (5, 0, 1), "radius": 1.0, "cells_per_edge": 4, "layers": 2}
RING = HOLLOW | {"centre": (1, 2, 3), "width": 0.5, "cells": (16, 2, 3), "axis": (1, -2, -3)}
TUBE = {"radius": 3.0, "inner_radius": 0.5, "outer_radius": 1.0, "centre": (1, 0, 2)}
TORUS = TUBE | {"cells": (24, 12, 2), "axis": (0, 3, 4)}


class Part(NamedTuple):
    """A body, its hexahedra and vertices, volume and areas of the round one."""

    add: Any
    given: dict[str, Any]
    counts: tuple[int, int]
    volume: float
    areas: dict[str, float]


SHELL = 4 / 3 * PI * (1 - 0.8**3)
PARTS = {
    "hollow ball": Part(
        parts.add_hollow_ball,
        WALL,
        (6 * 16 * 2, 3 * 98),
        SHELL,
        {"inner": 4 * PI * 0.64, "outer": 4 * PI},
    ),
    "solid ball": Part(
        parts.add_solid_ball, BALL, (64 + 6 * 16 * 2, 125 + 2 * 98), 4 / 3 * PI, {"outer": 4 * PI}
    ),
    "bowl": Part(
        parts.add_bowl,
        WALL,
        (3 * 16 * 2, 3 * 57),
        SHELL / 2,
        {"inner": 2 * PI * 0.64, "outer": 2 * PI, "rim": 0.36 * PI},
    ),
    "ring": Part(
        parts.add_ring,
        RING,
        (16 * 2 * 3, 16 * 3 * 4),
        0.36 * PI * 0.5,
        {"inner": 0.8 * PI, "outer": PI, "bottom": 0.36 * PI, "top": 0.36 * PI},
    ),
    "torus": Part(
        parts.add_torus,
        TORUS,
        (24 * 12 * 2, 24 * 12 * 3),
        2 * PI**2 * 3 * 0.75,
        {"inner": 4 * PI**2 * 1.5, "outer": 4 * PI**2 * 3},
    ),
}
each = pytest.mark.parametrize("part", PARTS.values(), ids=PARTS)


def refined(given: dict[str, Any]) -> dict[str, Any]:
    """Twice as many cells in every direction."""
    numbers = ("cells_per_edge", "layers")
    double = {key: 2 * given[key] for key in numbers if key in given}
    return given | double | ({"cells": np.multiply(2, given["cells"])} if "cells" in given else {})


def measure(data: MeshData, name: str | None, kind: str) -> float:
    """Volume ("dx") or surface area ("ds") of a region, or of everything."""
    region = data.cells if kind == "dx" else data.facets
    form = ufl.Measure(kind, domain=data.mesh, subdomain_data=region)
    where = form if name is None else form(data.tag[name])
    local = fem.assemble_scalar(fem.form(fem.Constant(data.mesh, 1.0) * where))
    return float(data.mesh.comm.allreduce(local))


@pytest.mark.serial
@CELLS
@each
def test_volume_and_areas_converge_with_second_order(comm, part, cell):
    errors = []
    for given in (part.given, refined(part.given)):
        data = read_mesh(lambda model, g=given: part.add(model, "p", **g, cell=cell), comm)
        found = [measure(data, "p", "dx") / part.volume]
        found += [measure(data, f"p_{name}", "ds") / area for name, area in part.areas.items()]
        errors.append(1 - np.array(found))
    assert np.abs(errors[0]).max() < 0.12
    order = np.log2(errors[0] / errors[1])
    assert np.abs(order - 2).max() < 0.25, order


@pytest.mark.parametrize("cell", [once("hexahedron"), "tetrahedron"])
@each
def test_blocks_are_joined_and_named_surfaces_are_the_whole_surface(comm, part, cell):
    data = read_mesh(lambda model: part.add(model, "p", **part.given, cell=cell), comm)
    topology = data.mesh.topology
    found = [topology.index_map(d).size_global for d in (3, 0)]
    assert found == [part.counts[0] * (6 if cell == "tetrahedron" else 1), part.counts[1]]
    named = sum(measure(data, name, "ds") for name in data.tag if "_" in name)
    assert measure(data, None, "ds") == pytest.approx(named, rel=ROUNDING)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("part", "axis"), [("ring", (1, -2, -3)), ("ring", (0, 0, -1)), ("torus", (0, 3, 4))]
)
def test_ring_and_torus_lie_around_their_axis(comm, part, axis):
    part = PARTS[part]
    data = read_mesh(lambda model: part.add(model, "p", **part.given | {"axis": axis}), comm)
    x = data.mesh.geometry.x - part.given["centre"]
    along = x @ axis / np.linalg.norm(axis)
    away = np.linalg.norm(x - np.outer(along, axis) / np.linalg.norm(axis), axis=1)
    if part is PARTS["torus"]:
        away = np.hypot(away - part.given["radius"], along)
        along = np.zeros(1)
    top = 0.25 if part is PARTS["ring"] else 0.0
    inner, outer = part.given["inner_radius"], part.given["outer_radius"]
    close = {"rtol": 0, "atol": 1e-12}
    least, most = comm.allreduce(away.min(), MPI.MIN), comm.allreduce(away.max(), MPI.MAX)
    np.testing.assert_allclose([least, most], [inner, outer], **close)
    np.testing.assert_allclose(comm.allreduce(np.abs(along).max(), MPI.MAX), top, **close)
    if part is PARTS["ring"]:
        # DOLFINx 0.9 divides by the number of facets.
        if len(facets := data.facets.find(data.tag["p_top"])):
            data.mesh.topology.create_connectivity(2, 0)
            nodes = entities_to_geometry(data.mesh, 2, facets)
            np.testing.assert_allclose(along[nodes], 0.25, **close)


@CELLS
def test_box_is_exact(comm, cell):
    box = {"corner": (1, 2, 3), "size": (1, 2, 0.5), "cells": (2, 3, 1)}
    data = read_mesh(lambda model: parts.add_box(model, "p", **box, cell=cell), comm)
    assert measure(data, "p", "dx") == pytest.approx(1, rel=ROUNDING)
    for sides, area in (("left right", 1), ("front back", 0.5), ("bottom top", 2)):
        for side in sides.split():
            assert measure(data, f"p_{side}", "ds") == pytest.approx(area, rel=ROUNDING)


@CELLS
@pytest.mark.serial
def test_cells_are_right_handed_and_surfaces_anticlockwise_from_outside(cell):
    def build(model: Any) -> None:
        parts.add_box(model, "box", **BOX, cell=cell)
        for name, part in PARTS.items():
            part.add(model, name, **part.given, cell=cell)
        (kind,) = model.mesh.getElementTypes(3)
        _, det, _ = model.mesh.getJacobians(kind, model.mesh.getElementProperties(kind)[4])
        assert det.min() > 0
        # Gauss: the volume from outward normals; four nodes of a facet are
        # nearly in a plane.
        for dim, volume in model.getEntities(3):
            flux = 0.0
            for _, surface in model.getBoundary([(dim, volume)], oriented=False):
                _, (facets,) = model.mesh.getElements(2, surface)[1:]
                x = np.array([model.mesh.getNode(node)[0] for node in facets])
                x = x.reshape(-1, 4 if cell == "hexahedron" else 3, 3)
                normal = np.cross(x[:, 2] - x[:, 0], x[:, -1] - x[:, 1]) / 2
                flux += np.einsum("ij,ij->", x.mean(axis=1), normal) / 3
            _, (elements,), _ = model.mesh.getElements(dim, volume)
            sizes = model.mesh.getElementQualities(elements, "volume")
            assert flux == pytest.approx(np.sum(sizes), rel=0.02)

    read_mesh(build, MPI.COMM_SELF)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("add", "good", "wrong", "match"),
    [
        (parts.add_box, BOX, {"size": (1, 0, 1)}, r"positive size and cells, given \(1, 0, 1\)"),
        (parts.add_box, BOX, {"cells": (1, 1, 0)}, r"size and cells, given .*\(1, 1, 0\)"),
        (parts.add_box, BOX, {"cell": "prism"}, "'hexahedron', 'tetrahedron'.*given 'prism'"),
        (
            parts.add_hollow_ball,
            WALL,
            {"inner_radius": 1.5},
            r"inner < outer radius, given 1\.5, 1",
        ),
        (parts.add_hollow_ball, WALL, {"inner_radius": 0}, "0 < inner"),
        (parts.add_hollow_ball, WALL, {"layers": 0}, r"at least 1 cells, given \(4, 0\)"),
        (parts.add_hollow_ball, WALL, {"cell": "wedge"}, "given 'wedge'"),
        (parts.add_solid_ball, BALL, {"radius": 0}, "radius > 0, given 0"),
        (
            parts.add_bowl,
            WALL,
            {"cells_per_edge": 3},
            "even number of cells per edge of a bowl, given 3",
        ),
        (parts.add_ring, RING, {"width": 0}, "width > 0, given 0"),
        (parts.add_ring, RING, {"cells": (2, 1, 1)}, r"at least 3 cells, given \(2,\)"),
        (parts.add_ring, RING, {"axis": (0, 0, 0)}, r"axis of length > 0, given \(0, 0, 0\)"),
        (parts.add_torus, TORUS, {"radius": 1}, "radius > outer radius, given 1, 1"),
    ],
)
def test_impossible_bodies_are_refused(add, good, wrong, match):
    with pytest.raises(ValueError, match=match):
        add(None, "body", **(good | wrong))


@pytest.mark.serial
@pytest.mark.parametrize(
    ("add", "good", "wrong"),
    [
        (parts.add_box, BOX, {"cells": (1, 2.5, 1)}),
        (parts.add_ring, RING, {"cells": (6.0, 1, 1)}),
    ],
)
def test_numbers_of_cells_are_integers(add, good, wrong):
    with pytest.raises(TypeError, match="expected integers as"):
        add(None, "body", **(good | wrong))
