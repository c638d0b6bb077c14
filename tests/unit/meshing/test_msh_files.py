"""Files of gmsh, read without gmsh; compared with the readers of gmsh and DOLFINx."""

import re
import struct
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx.mesh import MeshTags, compute_midpoints

from dolfinx_nts import compat
from dolfinx_nts.meshing.elements import KINDS, Block, Elements
from dolfinx_nts.meshing.gmsh import MeshData, read_mesh
from dolfinx_nts.meshing.mixed_cells import only_one_kind
from dolfinx_nts.meshing.msh_file import read_msh
from dolfinx_nts.meshing.parts import add_box, add_rectangle, add_solid_ball
from helpers.models.gmsh_models import BOX, ROUNDING, measure

FORMATS = [(4.1, 0), (4.1, 1), (2.2, 0), (2.2, 1)]
BALL = {"centre": (0, 0, 3), "radius": 1.0, "cells_per_edge": 1, "layers": 1}


def in_space(model: Any, cell: str) -> None:
    add_box(model, "box", **BOX, cell=cell)
    add_solid_ball(model, 'ball of "rubber"', **BALL, cell=cell)


def in_plane(model: Any, cell: str) -> None:
    add_rectangle(model, "plate", corner=(0, 0), size=(2, 1), cells=(3, 2), cell=cell)
    disc = model.occ.addDisk(5, 0, 0, 1, 1)
    model.occ.synchronize()
    model.addPhysicalGroup(2, [disc], tag=77)
    model.addPhysicalGroup(1, [b for _, b in model.getBoundary([(2, disc)])], name="rim")
    model.mesh.setSize(model.getEntities(0), 0.5)
    if cell == "quadrilateral":
        model.mesh.setRecombine(2, disc)
        model.mesh.setAlgorithm(2, disc, 11)
    model.mesh.generate(2)


BUILD = {
    "hexahedron": in_space,
    "tetrahedron": in_space,
    "triangle": in_plane,
    "quadrilateral": in_plane,
}


def write(model: Any, path: Path, version: float, binary: int) -> None:
    """Write the current model on the rank that has it."""
    if model:
        import gmsh

        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.write(str(path))


def tagged(mesh: Any, tags: MeshTags) -> np.ndarray:
    """Midpoints and tags of all tagged entities, sorted, each from one rank."""
    owned = tags.indices < mesh.topology.index_map(tags.dim).size_local
    mesh.topology.create_connectivity(tags.dim, mesh.topology.dim)
    rows = np.column_stack(
        [compute_midpoints(mesh, tags.dim, tags.indices[owned]), tags.values[owned]]
    )
    rows = np.concatenate(mesh.comm.allgather(rows)).round(9) + 0.0
    return rows[np.lexsort(rows.T)]


def corners(data: MeshData) -> np.ndarray:
    """Nodes of all cells, each cell in its own order, cells sorted by their midpoints."""
    size = data.mesh.topology.index_map(data.mesh.topology.dim).size_local
    x = data.mesh.geometry.x[compat.geometry_nodes(data.mesh)[:size]]
    x = np.concatenate(data.mesh.comm.allgather(x))
    return x[np.lexsort(x.mean(axis=1).round(9).T)]


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(("version", "binary"), FORMATS)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cell", BUILD)
def test_file_is_read_as_by_gmsh_and_dolfinx(
    comm, model, tmp_path, monkeypatch, cell, order, version, binary
):
    path = comm.bcast(tmp_path / "mesh.msh")
    if model:
        BUILD[cell](model, cell)
        model.mesh.setOrder(order)
        model.mesh.renumberNodes()
    write(model, path, version, binary)
    live = read_mesh(model, comm)
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "gmsh", None)
        data = read_mesh(path, comm)
    assert dict(data.tag) == dict(live.tag)
    np.testing.assert_allclose(corners(data), corners(live), atol=1e-14)
    for ours, gmsh_s in ((data.cells, live.cells), (data.facets, live.facets)):
        np.testing.assert_array_equal(tagged(data.mesh, ours), tagged(live.mesh, gmsh_s))
    # DOLFINx requires consecutive numbers, and has no names.
    try:
        reader = import_module("dolfinx.io.gmsh")
    except ModuleNotFoundError:
        reader = import_module("dolfinx.io.gmshio")
    mesh, cells, facets = reader.model_to_mesh(model, comm, 0, gdim=data.mesh.topology.dim)[:3]
    for ours, theirs in ((data.cells, cells), (data.facets, facets)):
        np.testing.assert_array_equal(tagged(data.mesh, ours), tagged(mesh, theirs))


@pytest.mark.serial
@pytest.mark.parametrize(("version", "binary"), FORMATS)
def test_read_from_msh_gives_the_same_mesh(comm, model, tmp_path, version, binary):
    in_space(model, "tetrahedron")
    write(model, tmp_path / "mesh.msh", version, binary)
    reader = import_module(
        "dolfinx.io.gmsh" if "dolfinx.io.gmsh" in sys.modules else "dolfinx.io.gmshio"
    )
    mesh, cells, facets = reader.read_from_msh(tmp_path / "mesh.msh", comm)[:3]
    import gmsh

    if not gmsh.isInitialized():  # DOLFINx ends it.
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    data = read_mesh(tmp_path / "mesh.msh", comm)
    np.testing.assert_array_equal(tagged(data.mesh, data.cells), tagged(mesh, cells))
    np.testing.assert_array_equal(tagged(data.mesh, data.facets), tagged(mesh, facets))


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize(("version", "binary"), FORMATS)
def test_mixed_cells_and_facets_without_groups_of_a_file(comm, model, tmp_path, version, binary):
    path = comm.bcast(tmp_path / "mesh.msh")
    if model:
        import gmsh

        add_box(model, "a", **BOX)
        add_box(model, "b", **BOX | {"corner": (0, 0, 2)}, cell="tetrahedron")
        model.removePhysicalGroups([(2, 2)])
        # In format 2.2, gmsh writes all elements without their groups, or none without a group.
        gmsh.option.setNumber("Mesh.SaveAll", version == 4.1)
    write(model, path, version, binary)
    data = read_mesh(path, comm)
    assert data.tag.get("a_left") is None
    for name in ("a", "b"):
        assert measure(data, name) == pytest.approx(1, rel=ROUNDING)
        assert measure(data, f"{name}_top", "ds") == pytest.approx(1, rel=ROUNDING)


@pytest.mark.serial
def test_element_types_agree_with_gmsh(model):
    import gmsh

    for number, kind in KINDS.items():
        name, dim, order, num_nodes, _, _ = gmsh.model.mesh.getElementProperties(number)
        assert (kind.name, kind.dim, kind.num_nodes) == (name, dim, num_nodes)
        assert kind.order == order or kind.name == "Point"


@pytest.mark.serial
@pytest.mark.parametrize("kind", [2, 3, 4, 5, 6])
def test_pieces_of_a_cell_have_its_orientation(model, kind):
    """In gmsh's own reference element, whose volume they share."""
    _, dim, _, num_nodes, x, _ = model.mesh.getElementProperties(kind)
    x = np.pad(np.reshape(x, (num_nodes, dim)), ((0, 0), (0, 3 - dim)))
    other = {2: 3, 3: 2, 4: 5, 5: 4, 6: 4}[kind]
    far = x[:1] + 9.0 + np.arange(3 * KINDS[other].num_nodes).reshape(-1, 3)
    cell = dict(dim=dim, entity=1, kind=kind, numbers=np.array([8]))
    blocks = (
        Block(**cell, nodes=np.arange(1, num_nodes + 1)[None]),
        Block(dim, 2, other, np.array([9]), num_nodes + 1 + np.arange(len(far))[None]),
    )
    numbers = np.arange(1, num_nodes + 1 + len(far))
    groups = {(dim, 1): (1,), (dim, 2): (2,)}
    cut = only_one_kind(Elements(numbers, np.vstack([x, far]), groups, {}, blocks), dim)
    (pieces,) = (block for block in cut.blocks if block.entity == 1)
    corner = cut.positions(pieces.nodes)
    ends = [1, 3, 4] if dim == 3 else [1, 3]
    det = np.linalg.det((corner[:, ends] - corner[:, :1])[..., :dim])
    assert len(pieces.nodes) == num_nodes and (det > 0).all()


# --- refused arguments ---------------------------------------------------


def refused(path: Path, match: str) -> None:
    with pytest.raises(ValueError, match=rf"given {re.escape(str(path))}: .*{match}"):
        read_msh(path)


@pytest.mark.serial
@pytest.mark.parametrize(("version", "binary"), FORMATS)
def test_file_that_is_cut_off_anywhere_is_refused(model, tmp_path, version, binary):
    in_space(model, "hexahedron")
    write(model, tmp_path / "whole.msh", version, binary)
    whole, path = (tmp_path / "whole.msh").read_bytes(), tmp_path / "part.msh"
    for size in np.linspace(5, len(whole) - 15, 97).astype(int):
        path.write_bytes(whole[:size])
        refused(path, "")


@pytest.mark.serial
@pytest.mark.parametrize(("version", "binary"), FORMATS)
def test_damaged_file_is_read_or_refused(model, tmp_path, version, binary):
    """Bytes are changed anywhere: nothing but ``ValueError`` is raised."""
    in_space(model, "tetrahedron")
    write(model, tmp_path / "whole.msh", version, binary)
    whole, path = (tmp_path / "whole.msh").read_bytes(), tmp_path / "part.msh"
    random, refusals = np.random.default_rng(5), 0
    for _ in range(200):
        damaged = bytearray(whole)
        damaged[random.integers(len(whole))] = random.integers(256)
        path.write_bytes(bytes(damaged))
        try:
            read_msh(path)
        except ValueError as error:
            assert str(path) in str(error)
            refusals += 1
    assert refusals > 10


@pytest.mark.serial
@pytest.mark.parametrize("version", [1.0, 4.0])
def test_other_formats_are_refused_with_the_remedy(model, tmp_path, version):
    in_space(model, "hexahedron")
    path = tmp_path / "old.msh"
    write(model, path, version, 0)
    match = "-save -format msh41" if version == 4.0 else "expected a gmsh mesh"
    with pytest.raises(ValueError, match=match):
        read_mesh(path, MPI.COMM_SELF)


@pytest.mark.serial
def test_partitioned_file_is_refused_with_the_remedy(model, tmp_path):
    in_space(model, "hexahedron")
    model.mesh.partition(2)
    write(model, tmp_path / "parts.msh", 4.1, 0)
    refused(tmp_path / "parts.msh", r"read_mesh partitions meshes itself: call .*unpartition\(\)")


@pytest.mark.serial
@pytest.mark.parametrize(("version", "binary"), FORMATS)
def test_elements_of_third_order_of_a_file_are_refused(model, tmp_path, version, binary):
    in_space(model, "hexahedron")
    model.mesh.setOrder(4)
    write(model, tmp_path / "high.msh", version, binary)
    refused(tmp_path / "high.msh", r"element type \d+, of third or higher order: .*setOrder")


# --- binary files of another order of bytes ----------------------------

X = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)


def big_endian(version: str) -> bytes:
    """One tetrahedron, number 7, in group 3 on volume 5, with nodes 1 to 4."""

    def pack(layout: str, *values: float) -> bytes:
        return struct.pack(f">{layout}", *values)

    parts = [f"$MeshFormat\n{version} 1 8\n".encode(), pack("i", 1), b"\n$EndMeshFormat\n"]
    if version == "2.2":
        parts += [b"$Nodes\n4\n", *(pack("i3d", i + 1, *x) for i, x in enumerate(X))]
        parts += [b"\n$EndNodes\n$Elements\n1\n", pack("3i", 4, 1, 2)]
        parts += [pack("7i", 7, 3, 5, 1, 2, 3, 4), b"\n$EndElements\n"]
        return b"".join(parts)
    parts += [b"$Entities\n", pack("4Q", 0, 0, 0, 1), pack("i6dQiQ", 5, *[0.0] * 6, 1, 3, 0)]
    parts += [b"\n$EndEntities\n$Nodes\n", pack("4Q3iQ", 1, 4, 1, 4, 3, 5, 0, 4)]
    parts += [pack("4Q12d", 1, 2, 3, 4, *X.ravel()), b"\n$EndNodes\n$Elements\n"]
    parts += [pack("4Q3iQ5Q", 1, 1, 7, 7, 3, 5, 4, 1, 7, 1, 2, 3, 4), b"\n$EndElements\n"]
    return b"".join(parts)


@pytest.mark.serial
@pytest.mark.parametrize("version", ["2.2", "4.1"])
def test_binary_file_of_a_machine_with_another_order_of_bytes(tmp_path, version):
    path = tmp_path / "big.msh"
    path.write_bytes(big_endian(version))
    mesh = read_msh(path)
    np.testing.assert_array_equal(mesh.x, X)
    (block,) = mesh.blocks
    assert (block.dim, block.entity, block.kind) == (3, 5, 4)
    assert block.numbers.tolist() == [7] and block.nodes.tolist() == [[1, 2, 3, 4]]
    assert mesh.groups == {(3, 5): (3,)}


@pytest.mark.serial
def test_elements_of_types_that_alternate_and_have_more_tags_are_read(tmp_path):
    """As other programs write format 2: no tags, or several, in any order."""
    rows = ["1 15 2 0 9 1", "2 4 3 3 5 0 1 2 3 4", "3 2 2 8 6 1 2 3", "4 15 0 2", "5 2 2 8 6 1 3 4"]
    nodes = [f"{i + 1} {x[0]} {x[1]} {x[2]}" for i, x in enumerate(X)]
    lines = ["$Comments", "by $hand", "$EndComments", "$MeshFormat", "2.2 0 8", "$EndMeshFormat"]
    lines += ["$Nodes", "4", *nodes, "$EndNodes", "$Elements", "5", *rows, "$EndElements"]
    path = tmp_path / "hand.msh"
    path.write_bytes("\r\n".join(lines).encode())
    mesh = read_msh(path)
    assert mesh.kinds(2) == {2: 2} and mesh.kinds(3) == {4: 1}
    assert mesh.groups == {(0, 0): (), (0, 9): (), (2, 6): (8,), (3, 5): (3,)}
    faces = [row for block in mesh.blocks if block.dim == 2 for row in block.nodes.tolist()]
    assert faces == [[1, 2, 3], [1, 3, 4]]
