"""Reading meshes and building bodies, on any number of ranks."""

import re
import runpy
import sys
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import MeshTags, entities_to_geometry

from dolfinx_nts.meshing import examples
from dolfinx_nts.meshing.gmsh import MeshData, read_mesh
from dolfinx_nts.meshing.parts import add_box, add_hollow_ball, add_rectangle
from helpers.models.gmsh_models import BOX, ROUNDING, count, measure

pytestmark = pytest.mark.at_most_two_ranks

MESHES = Path(__file__).parents[3] / "meshes"
BALL_PLATE = examples.ball_plate()
CENTRE = np.array([0.0, -0.5, 1.05])  # of the ball in BALL_PLATE
BALL = {
    "centre": (5, 0, 0),
    "inner_radius": 0.8,
    "outer_radius": 1,
    "cells_per_edge": 3,
    "layers": 2,
}
CELLS = pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])


def unit_box(model: Any, cell: str = "hexahedron") -> None:
    """Add a unit cube of 2 x 2 x 2 hexahedra, its inner node is number 14."""
    add_box(model, "box", **BOX, cell=cell)


def refuse(comm: MPI.Comm, source: Any, error: type[Exception], match: str, rank: int = 0) -> None:
    """Check that all ranks raise the same error."""
    raised: Exception | None = None
    try:
        read_mesh(source, comm, rank=rank)
    except Exception as caught:
        raised = caught
    found = comm.allgather((type(raised), str(raised)))
    assert len(set(found)) == 1, found
    assert issubclass(found[0][0], error), found
    assert re.search(match, found[0][1]), found


def nodes(data: MeshData, tags: MeshTags, name: str) -> np.ndarray:
    """Coordinates of the nodes of a region, sorted, without repetition."""
    data.mesh.topology.create_connectivity(tags.dim, 0)
    data.mesh.topology.create_connectivity(0, tags.dim)
    entities = tags.find(data.tag[name])
    # DOLFINx 0.9 divides by their number.
    where = entities_to_geometry(data.mesh, tags.dim, entities) if len(entities) else []
    x = data.mesh.geometry.x[np.ravel(where).astype(np.int64)]
    x = np.concatenate(data.mesh.comm.allgather(x))
    return np.unique(x.round(12) + 0.0, axis=0)


def cubed_sphere(n: int) -> np.ndarray:
    """Directions (6, n + 1, n + 1, 3), face by face from the formula."""
    t = np.tan(np.pi / 4 * np.linspace(-1, 1, n + 1))
    a, b = np.meshgrid(t, t, indexing="ij")
    face = np.stack([a, b, np.ones_like(a)], axis=-1)
    face /= np.linalg.norm(face, axis=-1, keepdims=True)
    return np.stack([np.roll(sign * face, k, axis=-1) for sign in (1, -1) for k in range(3)])


# --- the mesh of the ball on the plate ---------------------------------


def test_ball_and_plate_have_the_planned_numbers_of_cells_facets_and_nodes(comm):
    data = read_mesh(BALL_PLATE, comm)
    assert count(data, data.cells, "ball") == 432
    assert count(data, data.cells, "plate") == 100
    assert data.mesh.topology.index_map(3).size_global == 532
    assert count(data, data.facets, "ball_outer") == 216
    assert count(data, data.facets, "plate_top") == 100
    assert len(nodes(data, data.facets, "ball_outer")) == 218
    assert len(nodes(data, data.cells, "ball")) == 3 * 218
    assert len(nodes(data, data.cells, "plate")) == 242


def test_ball_nodes_lie_where_the_formula_of_the_cubed_sphere_puts_them(comm):
    data = read_mesh(BALL_PLATE, comm)
    directions = cubed_sphere(6).reshape(-1, 3)
    for region, radii in ((data.facets, [1.0]), (data.cells, [0.8, 0.9, 1.0])):
        name = "ball_outer" if region is data.facets else "ball"
        x = np.concatenate([CENTRE + radius * directions for radius in radii])
        expected = np.unique(x.round(12) + 0.0, axis=0)
        found = nodes(data, region, name)
        assert found.shape == expected.shape
        assert np.abs(found - expected).max() < 1e-11


def test_ball_has_the_volume_of_its_straight_edged_cells(comm):
    """The cone over a bilinear patch is the mean of its two triangulations."""
    d = cubed_sphere(6)[0]
    p = [d[:-1, :-1], d[1:, :-1], d[1:, 1:], d[:-1, 1:]]
    triples = [(0, 1, 2), (0, 2, 3), (0, 1, 3), (1, 2, 3)]
    cones = sum(np.linalg.det(np.stack([p[i] for i in t], axis=-1)).sum() for t in triples) / 12
    data = read_mesh(BALL_PLATE, comm)
    assert measure(data, "ball") == pytest.approx(6 * cones * (1 - 0.8**3), rel=ROUNDING)


def test_plate_has_the_planned_volume_and_areas(comm):
    data = read_mesh(BALL_PLATE, comm)
    assert measure(data, "plate") == pytest.approx(4 * 4 * 0.4, rel=ROUNDING)
    for side in ("top", "bottom"):
        assert measure(data, f"plate_{side}", "ds") == pytest.approx(16, rel=ROUNDING)
    for side in ("left", "right", "front", "back"):
        assert measure(data, f"plate_{side}", "ds") == pytest.approx(1.6, rel=ROUNDING)
    assert np.ptp(nodes(data, data.facets, "plate_top"), axis=0).tolist() == [4, 4, 0]


@pytest.mark.serial
def test_script_writes_the_same_bytes_twice_and_the_committed_mesh(tmp_path):
    write = runpy.run_path(str(MESHES / "ball_plate.py"))["write"]
    written = []
    for name in ("first.msh", "second.msh"):
        write(tmp_path / name)
        written.append((tmp_path / name).read_bytes())
    assert written[0] == written[1]
    # Another libm may round the last digit of a coordinate differently.
    ours, theirs = written[0].split(), BALL_PLATE.read_bytes().split()
    assert len(ours) == len(theirs)
    for a, b in zip(ours, theirs, strict=True):
        assert a == b or float(a) == pytest.approx(float(b), abs=1e-14)


# --- names and tags ----------------------------------------------------


def test_all_ranks_know_the_names(comm):
    data = read_mesh(str(BALL_PLATE), comm)
    known = comm.allgather(sorted(data.tag))
    sides = ["back", "bottom", "front", "left", "right", "top"]
    plate = [f"plate_{side}" for side in sides]
    assert known == [["ball", "ball_inner", "ball_outer", "plate", *plate]] * comm.size


def test_unknown_name_is_refused_with_the_names_that_exist(comm):
    tag = read_mesh(BALL_PLATE, comm).tag
    with pytest.raises(ValueError, match=r"\['ball', 'ball_inner', .*given 'bell'"):
        tag["bell"]
    assert "ball" in tag
    assert "bell" not in tag
    assert tag.get("bell") is None


def test_tags_are_read_only(comm):
    tag = read_mesh(BALL_PLATE, comm).tag
    with pytest.raises(TypeError, match="does not support item assignment"):
        tag["ball"] = 7


def test_group_without_a_name_is_called_by_its_tag(comm, model):
    if model:
        unit_box(model)
        model.addPhysicalGroup(3, model.getEntitiesForPhysicalGroup(3, 1), tag=41)
        model.removePhysicalGroups([(3, 1)])
        model.removePhysicalName("box_top")
    data = read_mesh(model, comm)
    assert "volume 41" in data.tag
    assert measure(data, "volume 41") == pytest.approx(1, rel=ROUNDING)
    assert measure(data, "surface 7", "ds") == pytest.approx(1, rel=ROUNDING)


def test_volume_and_surface_may_share_a_name_only_with_the_same_tag(comm, model):
    if model:
        unit_box(model)
        model.removePhysicalName("box_top")
        model.setPhysicalName(2, 7, "box")
    refuse(comm, model, ValueError, "one tag for 'box', given 1 and 7")
    if model:
        top = model.getEntitiesForPhysicalGroup(2, 7)
        model.removePhysicalGroups([(2, 7)])
        model.addPhysicalGroup(2, top, tag=1, name="box")
    data = read_mesh(model, comm)
    assert data.tag["box"] == 1
    assert measure(data, "box") == pytest.approx(1, rel=ROUNDING)
    assert measure(data, "box", "ds") == pytest.approx(1, rel=ROUNDING)


# --- sources -----------------------------------------------------------


def test_any_rank_may_read(comm):
    data = read_mesh(BALL_PLATE if comm.rank == comm.size - 1 else None, comm, rank=comm.size - 1)
    assert measure(data, "plate") == pytest.approx(6.4, rel=ROUNDING)


def test_live_model_needs_no_physical_surface(comm, model):
    if model:
        unit_box(model)
        model.removePhysicalGroups(model.getPhysicalGroups(2))
    data = read_mesh(model, comm)
    assert list(data.tag) == ["box"]
    assert comm.allreduce(len(data.facets.values)) == 0


def test_surfaces_inside_a_body_may_be_tagged(comm, model):
    if model:
        unit_box(model)
        surface = model.addDiscreteEntity(2)
        model.mesh.addElementsByType(surface, 3, [], [13, 14, 11, 10, 14, 15, 12, 11])
        model.addPhysicalGroup(2, [surface], name="inside")
    data = read_mesh(model, comm)
    assert count(data, data.facets, "inside") == 2


def test_function_fills_an_empty_model_on_the_reading_rank(comm):
    called = []

    def build(model: Any) -> None:
        called.append(model.getEntities())
        unit_box(model)

    data = read_mesh(build, comm, rank=comm.size - 1)
    assert called == ([[]] if comm.rank == comm.size - 1 else [])
    assert measure(data, "box") == pytest.approx(1, rel=ROUNDING)


def test_error_of_the_function_is_raised_on_all_ranks(comm):
    def build(model: Any) -> None:
        unit_box(model)
        raise OSError("no such part")

    refuse(comm, build, OSError, "no such part")
    import gmsh

    assert not comm.allreduce(gmsh.isInitialized(), MPI.LOR)


def test_gmsh_is_left_as_it_was(comm, model, capfd):
    def state() -> Any:
        import gmsh

        terminal = gmsh.option.getNumber("General.Terminal")
        return gmsh.model.getCurrent(), gmsh.model.list(), terminal

    if model:
        import gmsh

        gmsh.option.setNumber("General.Terminal", 1)
        model.add("later")
        model.setCurrent("test")
        before = state()
    read_mesh(BALL_PLATE, comm)
    refuse(comm, __file__, ValueError, "expected a gmsh mesh")
    read_mesh(BALL_PLATE, comm)
    assert comm.allreduce(model is None or state() == before, MPI.LAND)
    output = capfd.readouterr()
    assert not any(comm.allgather(output.out + output.err))


def test_gmsh_is_finalised_only_by_who_initialised_it(comm):
    import gmsh

    read_mesh(BALL_PLATE, comm)
    refuse(comm, "absent.msh", OSError, r"absent\.msh")
    assert not comm.allreduce(gmsh.isInitialized(), MPI.LOR)


@pytest.mark.parametrize("version", [2.2, 4.1])
@pytest.mark.parametrize("binary", [0, 1])
def test_order_numbering_and_format_of_the_file_do_not_matter(
    comm, model, tmp_path, version, binary
):
    path = tmp_path / "shuffled.msh"
    if model:
        import gmsh

        add_hollow_ball(model, "ball", **BALL)
        old, _, _ = model.mesh.getNodes()
        new = np.random.default_rng(7).permutation(old.astype(int)) * 3 + 5
        model.mesh.renumberNodes(old, new)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.write(str(path))
    shuffled = read_mesh(path, comm), read_mesh(model, comm)
    if model:
        assert set(model.mesh.getNodes()[0]) == set(new)
        model.mesh.renumberNodes()
    data = read_mesh(model, comm)
    for one in shuffled:
        assert dict(one.tag) == dict(data.tag)
        for name, kind in (("ball", "dx"), ("ball_outer", "ds"), ("ball_inner", "ds")):
            expected = measure(data, name, kind)
            assert measure(one, name, kind) == pytest.approx(expected, rel=ROUNDING)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("source", ["model", "file", "function"])
def test_points_and_curves_of_no_cell_are_left_out(comm, model, tmp_path, order, source):
    def build(own):
        first = own.occ.addPoint(3, 0, 0)  # numbered lower than all following ones
        line = own.occ.addLine(first, own.occ.addPoint(3, 0, 1))
        box = own.occ.addBox(0, 0, 0, 1, 1, 1)
        own.occ.synchronize()
        own.addPhysicalGroup(0, [first], name="mark")
        own.addPhysicalGroup(1, [line], name="axis")
        own.addPhysicalGroup(3, [box], name="box")
        own.mesh.generate(3)
        own.mesh.setOrder(order)

    path, before = comm.bcast(tmp_path / "marked.msh"), None
    if model:
        import gmsh

        build(model)
        gmsh.write(str(path))
        before = model.mesh.getNodes()[0].tolist()
        groups = model.getPhysicalGroups()
    given = {"model": model, "file": path, "function": build}[source]
    data = read_mesh(given, comm)
    assert list(data.tag) == ["box"]
    assert measure(data, "box") == pytest.approx(1, rel=ROUNDING)
    V = fem.functionspace(data.mesh, ("Lagrange", order))
    used = comm.allreduce(V.dofmap.index_map.size_local)
    assert used == data.mesh.geometry.index_map().size_global
    if model:
        assert sorted(model.mesh.getNodes()[0]) == before
        assert used < len(before)
        assert model.getPhysicalGroups() == groups
        assert [model.getPhysicalName(*group) for group in groups] == ["mark", "axis", "box"]


# --- refused arguments, on all ranks -------------------------------------


def test_rank_outside_the_communicator_is_refused(comm):
    refuse(comm, BALL_PLATE, ValueError, f"below {comm.size}, given {comm.size}", comm.size)


def test_missing_file_is_refused(comm, tmp_path):
    refuse(comm, tmp_path / "absent.msh", FileNotFoundError, r"absent\.msh")


@pytest.mark.parametrize("text", ["Point(1) = {0, 0, 0};", "", "$MeshFormat\n4.1 0 8\n$Nodes\n1"])
def test_file_that_is_no_mesh_is_refused(comm, tmp_path, text):
    path = tmp_path / "wrong.msh"
    path.write_text(text)
    refuse(comm, path, ValueError, r"expected .*given .*wrong\.msh|expected physical volumes")


def test_source_that_is_neither_path_nor_model_is_refused(comm):
    refuse(comm, 7, TypeError, "expected a path, a gmsh model or a function, given 7")


def test_live_model_of_a_gmsh_not_initialised_is_refused(comm):
    import gmsh

    refuse(comm, gmsh.model, ValueError, "before gmsh.initialize")


def test_missing_gmsh_is_refused_where_something_is_meshed(comm, monkeypatch):
    if comm.rank == 0:
        monkeypatch.setitem(sys.modules, "gmsh", None)
    refuse(comm, unit_box, ImportError, r"expected the Python module gmsh .*read a \.msh file")


def test_volumes_without_physical_groups_are_bodies(comm, model):
    if model:
        unit_box(model)
        add_box(model, "other", **BOX | {"corner": (5, 0, 0)})
        model.removePhysicalGroups(model.getPhysicalGroups(3))
    data = read_mesh(model, comm)
    volumes = [name for name in data.tag if name.startswith("volume ")]
    assert [count(data, data.cells, name) for name in volumes] == [8, 8]


@pytest.mark.serial
def test_surfaces_without_physical_groups_are_bodies_of_the_plane():
    def build(model):
        model.occ.addRectangle(0, 0, 0, 1, 1)
        model.occ.addDisk(5, 0, 0, 1, 1)
        model.occ.synchronize()
        model.mesh.generate(2)

    mesh, cells, _, tag = read_mesh(build, MPI.COMM_SELF)
    assert list(tag) == ["surface 1", "surface 2"] and mesh.topology.dim == 2
    assert set(cells.values.tolist()) == set(tag.values())


def test_quadrilaterals_and_triangles_of_second_order_are_refused_with_a_remedy(comm, model):
    if model:
        occ = model.occ
        left, right = occ.addRectangle(0, 0, 0, 1, 1), occ.addRectangle(1, 0, 0, 1, 1)
        occ.fragment([(2, left)], [(2, right)])
        occ.synchronize()
        model.addPhysicalGroup(2, [left, right], name="both")
        model.mesh.setRecombine(2, left)
        model.mesh.setTransfiniteSurface(left)
        model.mesh.generate(2)
        model.mesh.setOrder(2)
    refuse(comm, model, ValueError, r"Mesh.SubdivisionAlgorithm = 1 with Mesh.RecombineAll = 1")


@pytest.mark.parametrize("order, incomplete", [(2, 1), (3, 0)])
def test_cells_of_third_or_incomplete_second_order_are_refused(comm, model, order, incomplete):
    if model:
        gmsh = sys.modules["gmsh"]
        unit_box(model)
        gmsh.option.setNumber("Mesh.SecondOrderIncomplete", incomplete)
        model.mesh.setOrder(order)
    refuse(comm, model, ValueError, r"given Hexahedron (20|64); of second order .*setOrder\(1\)")


def test_pyramids_are_refused(comm, model):
    if model:
        unit_box(model)
        volume = model.addDiscreteEntity(3)
        x = [0, 0, 2, 1, 0, 2, 1, 1, 2, 0, 1, 2, 0, 0, 3]
        model.mesh.addNodes(3, volume, range(101, 106), x)
        model.mesh.addElementsByType(volume, 7, [], range(101, 106))
        model.addPhysicalGroup(3, [volume])
    refuse(
        *(comm, model, ValueError),
        "hexahedra, tetrahedra or prisms, given Hexahedron 8, Pyramid 5; .*all volumes with "
        r"tetrahedra .*Tied\(\)",
    )


@pytest.mark.parametrize("name", ["part.inp", "part.vtk", "part.MED", "part.step"])
def test_files_of_other_programs_are_refused_with_the_remedy(comm, folder, name):
    if comm.rank == 0:
        (folder / name).write_text("*HEADING")
    comm.barrier()
    kind = name.split(".")[1].upper()
    remedy = "mesh a geometry first" if kind == "STEP" else f"the {kind} file by meshio.*gmsh22"
    refuse(comm, folder / name, ValueError, f"expected a gmsh mesh .*{name}: .*{remedy}")


def test_volume_without_cells_is_refused(comm, model):
    if model:
        unit_box(model)
        model.addPhysicalGroup(3, [model.addDiscreteEntity(3)])
    refuse(comm, model, ValueError, r"volume \d+ .*expected Hexahedron 8, given no elements")


def test_untagged_volume_is_refused(comm, model):
    if model:
        unit_box(model)
        unit_box(model)
        model.removePhysicalGroups([(3, 8)])
    refuse(comm, model, ValueError, r"expected one physical group, given volume \d+ .*\[\]")


@pytest.mark.serial
@pytest.mark.parametrize("first", ["part", "shape"])
def test_parts_and_shapes_of_the_cad_kernel_go_together_in_the_plane(first):
    """Half a disc is made of two shapes, which had the numbers of the rectangle."""

    def build(model):
        def part():
            add_rectangle(model, "part", corner=(0, -1), size=(1, 1), cells=(2, 2))

        def shape():
            disc = model.occ.addDisk(0, 1.2, 0, 1, 1)
            right = model.occ.addRectangle(0, 0, 0, 3, 3)
            ((_, half),), _ = model.occ.intersect([(2, disc)], [(2, right)])
            model.occ.synchronize()
            model.addPhysicalGroup(2, [half], name="shape")
            model.mesh.setSize(model.getEntities(0), 0.3)
            model.mesh.setRecombine(2, half)
            model.mesh.generate(2)

        for add in (part, shape) if first == "part" else (shape, part):
            add()

    mesh, cells, facets, tag = read_mesh(build, MPI.COMM_SELF)
    num_cells = {name: len(cells.find(tag[name])) for name in ("part", "shape")}
    assert sum(num_cells.values()) == mesh.topology.index_map(2).size_local
    assert num_cells["part"] >= 4
    assert all(
        len(facets.find(tag[f"part_{side}"])) >= 2 for side in ("left", "right", "bottom", "top")
    )


@pytest.mark.serial
def test_parts_and_shapes_of_the_cad_kernel_go_together_in_space():
    def build(model):
        box = {"corner": (0, 0, -1), "size": (1, 1, 1), "cells": (2, 2, 2)}
        add_box(model, "part", **box, cell="tetrahedron")
        ball = model.occ.addSphere(0.5, 0.5, 0.6, 0.5)
        model.occ.synchronize()
        model.addPhysicalGroup(3, [ball], name="shape")
        model.mesh.setSize(model.getEntities(0), 0.4)
        model.mesh.generate(3)

    mesh, cells, facets, tag = read_mesh(build, MPI.COMM_SELF)
    assert len(cells.find(tag["part"])) == 48
    assert len(cells.find(tag["shape"])) == mesh.topology.index_map(3).size_local - 48 > 0
    assert len(facets.find(tag["part_top"])) == 8


@pytest.mark.serial
@pytest.mark.parametrize(
    ("synchronize", "dims", "meshed", "match"),
    [
        (False, (), 0, r"given a model without either: .*synchronize\(\)"),
        (True, (), 0, r"given 1 volume without cells: call gmsh\.model\.mesh\.generate\(3\)"),
        (True, (2,), 2, r"given 1 volume without cells"),
        (True, (3,), 2, r"given no elements: call gmsh\.model\.mesh\.generate\(3\)"),
    ],
)
def test_model_without_bodies_is_refused_with_advice(synchronize, dims, meshed, match):
    def build(model):
        model.occ.addBox(0, 0, 0, 1, 1, 1)
        if synchronize:
            model.occ.synchronize()
        for dim in dims:
            model.addPhysicalGroup(dim, [1], name=f"dim {dim}")
        model.mesh.generate(meshed)

    with pytest.raises(ValueError, match=match):
        read_mesh(build, MPI.COMM_SELF)


@pytest.mark.serial
def test_shell_is_refused():
    def build(model):
        model.occ.addSphere(0, 0, 0, 1)
        model.occ.remove([(3, 1)])
        model.occ.synchronize()
        model.addPhysicalGroup(2, [1], name="shell")
        model.mesh.generate(2)

    with pytest.raises(ValueError, match=r"given surfaces from z = -1 up to z = 1: .*no shells"):
        read_mesh(build, MPI.COMM_SELF)


@pytest.mark.parametrize("dim", [2, 3])
def test_region_in_two_groups_is_refused(comm, model, dim):
    if model:
        unit_box(model)
        model.addPhysicalGroup(dim, [model.getEntities(dim)[0][1]], tag=30)
    refuse(comm, model, ValueError, r"one physical group, given (volume|surface) \d+ .*, 30\]")


def test_triangles_on_hexahedra_are_refused(comm, model):
    if model:
        unit_box(model)
        surface = model.addDiscreteEntity(2)
        model.mesh.addElementsByType(surface, 2, [], [1, 2, 3])
        model.addPhysicalGroup(2, [surface])
    refuse(comm, model, ValueError, r"surface \d+ .*expected Quadrilateral 4, given Triangle 3")


def test_surface_away_from_the_cells_is_refused(comm, model):
    if model:
        unit_box(model)
        surface = model.addDiscreteEntity(2)
        model.mesh.addElementsByType(surface, 3, [], [1, 3, 27, 25])
        model.addPhysicalGroup(2, [surface], tag=50)
    refuse(comm, model, ValueError, "surface 50: expected 1 facets of cells, given 0")


def test_facets_in_two_surfaces_are_refused(comm, model):
    if model:
        unit_box(model)
        surface = model.addDiscreteEntity(2)
        _, _, (top,) = model.mesh.getElements(2, model.getEntitiesForPhysicalGroup(2, 7)[0])
        model.mesh.addElementsByType(surface, 3, [], top)
        model.addPhysicalGroup(2, [surface], tag=50)
    refuse(comm, model, ValueError, "surface (7|50): expected 4 facets of cells, given ")


def test_facets_between_volumes_whose_nodes_were_merged_are_left_out(comm):
    def build(model):
        for name, height in (("lower", 0), ("upper", 1)):
            size, cells = (1, 1, 1), (2, 2, 2)
            add_box(model, name, corner=(0, 0, height), size=size, cells=cells)
        model.mesh.removeDuplicateNodes()

    mesh, _, facets, tag = read_mesh(build, comm)
    own = facets.indices < mesh.topology.index_map(2).size_local
    names = ("lower_top", "upper_bottom", "upper_top")
    counts = [comm.allreduce(np.count_nonzero(facets.values[own] == tag[n])) for n in names]
    assert counts == [0, 0, 4]
    assert mesh.geometry.index_map().size_global == 45


# --- inverted and degenerate cells -------------------------------------


@pytest.mark.parametrize(
    ("cell", "x"), [("tetrahedron", 1 - 1e-13), ("hexahedron", 1 - 1e-13), ("hexahedron", 1.5)]
)
def test_cells_flattened_or_inverted_by_a_misplaced_node_are_refused(comm, model, cell, x):
    if model:
        unit_box(model, cell)
        model.mesh.setNode(14, [x, 0.5, 0.5], [])
    refuse(comm, model, ValueError, r"given \d+ inverted or degenerate cells")


def test_refused_cell_is_named_by_its_element_and_midpoint(comm, model):
    if model:
        volume = model.addDiscreteEntity(3)
        x = np.array([[i, j, k] for k in (0, 1) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))])
        x = np.concatenate([x, x + np.array([4, 0, 0])])
        model.mesh.addNodes(3, volume, np.arange(1, 17), x.ravel())
        crossed = [9, 10, 11, 12, 14, 13, 15, 16]
        model.mesh.addElementsByType(volume, 5, [60, 70], [*range(1, 9), *crossed])
        model.addPhysicalGroup(3, [volume])
    refuse(comm, model, ValueError, r"given 1 inverted.* element 70 at \[4\.5, 0\.5, 0\.5\]")


@CELLS
def test_mirrored_cells_are_accepted_and_keep_their_volume(comm, model, cell):
    if model:
        unit_box(model, cell)
        model.mesh.affineTransform([-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0])
    data = read_mesh(model, comm)
    assert measure(data, "box") == pytest.approx(1, rel=ROUNDING)
    assert measure(data, "box_top", "ds") == pytest.approx(1, rel=ROUNDING)


def test_thin_cells_are_not_taken_for_degenerate(comm, model):
    if model:
        add_box(model, "sheet", corner=(0, 0, 0), size=(1, 1, 1e-9), cells=(2, 2, 1))
    assert measure(read_mesh(model, comm), "sheet") == pytest.approx(1e-9, rel=ROUNDING)


@pytest.mark.serial
def test_script_of_gmsh_next_to_a_mesh_is_not_executed(comm, tmp_path):
    path, trace = tmp_path / "a.msh", tmp_path / "executed"
    path.write_bytes(BALL_PLATE.read_bytes())
    path.with_name("a.msh.opt").write_text(f'SystemCall "touch {trace}";\nMerge "nowhere.msh";\n')
    assert "ball" in read_mesh(path, comm).tag
    assert not trace.exists()


def test_a_name_that_gmsh_drops_is_reported(comm, caplog):
    """Gmsh ignores the second of two equal names."""

    def build(model, *names):
        for number in range(2):
            model.occ.addRectangle(2 * number, 0, 0, 1, 1)
        model.occ.synchronize()
        for number, name in enumerate(names, start=1):
            model.addPhysicalGroup(2, [number], name=name)
        model.mesh.generate(2)

    for names, others in ((("box", "lid"), ["lid"]), (("", ""), ["surface 2"])):
        assert set(others) < set(read_mesh(lambda model, n=names: build(model, *n), comm).tag)
    assert "no name" not in caplog.text
    assert "surface 2" in read_mesh(lambda model: build(model, "box", "box"), comm).tag
    assert comm.bcast("physical surface 2: no name" in caplog.text)
