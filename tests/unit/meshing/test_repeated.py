"""Meshes with repeated cells, and bodies whose parts only touch."""

from mpi4py import MPI

import pytest

import dolfinx_nts as nts
from dolfinx_nts import parts

pytestmark = pytest.mark.at_most_two_ranks

# A unit square of two triangles.
SQUARE = {1: (0, 0), 2: (1, 0), 3: (1, 1), 4: (0, 1)}
CELLS = [(1, 2, 3), (1, 3, 4)]


def write(path, points, cells, tags):
    """Write triangles in named physical surfaces, in format 2.2; tags from 1."""
    if MPI.COMM_WORLD.rank == 0:
        names = "\n".join(f'2 {tag} "body {tag}"' for tag in sorted(set(tags)))
        rows = "\n".join(f"{number} {x!r} {y!r} 0" for number, (x, y) in points.items())
        numbered = enumerate(zip(tags, cells, strict=True), start=11)
        elements = "\n".join(f"{n} 2 2 {t} {t} {a} {b} {c}" for n, (t, (a, b, c)) in numbered)
        path.write_text(
            f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
            f"$PhysicalNames\n{len(set(tags))}\n{names}\n$EndPhysicalNames\n"
            f"$Nodes\n{len(points)}\n{rows}\n$EndNodes\n"
            f"$Elements\n{len(cells)}\n{elements}\n$EndElements\n"
        )
    MPI.COMM_WORLD.barrier()
    return path


def test_a_cell_that_is_given_twice_is_refused_by_both_numbers(folder, refused):
    again = (3, 1, 2)  # the first one, from another vertex
    path = write(folder / "again.msh", SQUARE, [*CELLS, again], [1, 1, 1])
    with refused(ValueError, "1 with the nodes of another one, first the gmsh elements 11 and 13"):
        nts.read_mesh(path, MPI.COMM_WORLD)


@pytest.mark.parametrize("off", [0.0, 1e-15, -1e-15])
def test_nodes_of_a_body_at_the_same_place_are_reported(folder, caplog, off):
    """The triangles have the nodes of their common edge each, as in CAD parts not merged."""
    points = SQUARE | {5: (0 + off, 0 - off), 6: (1 + off, 1 + off)}
    path = write(folder / "parts.msh", points, [CELLS[0], (5, 6, 4)], [1, 1])
    nts.read_mesh(path, MPI.COMM_WORLD)
    reported = "body body 1 has 2 nodes at the place of another one, for instance at [0.0, 0.0, 0"
    assert (reported in caplog.text) == (MPI.COMM_WORLD.rank == 0)


def test_nodes_of_two_bodies_may_be_at_the_same_place(folder, caplog):
    points = SQUARE | {5: (0, 0), 6: (1, 1)}
    path = write(folder / "bodies.msh", points, [CELLS[0], (5, 6, 4)], [1, 2])
    nts.read_mesh(path, MPI.COMM_WORLD)
    assert "at the place of" not in caplog.text


ONE_SIDE = "facets have both of their cells on one side"


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_node_that_has_passed_through_a_facet_is_reported(folder, caplog, mirrored):
    """Node 4 lies below the diagonal, where the other triangle is; the order does not matter."""
    cells = [CELLS[0], CELLS[1][::-1] if mirrored else CELLS[1]]
    path = write(folder / "tangled.msh", SQUARE | {4: (0.9, 0.2)}, cells, [1, 1])
    nts.read_mesh(path, MPI.COMM_WORLD)
    reported = f"1 {ONE_SIDE}, first that of the gmsh elements 11 and 12 near [0.6"
    assert (reported in caplog.text) == (MPI.COMM_WORLD.rank == 0)


@pytest.mark.parametrize("second", [(1, 3, 4), (4, 3, 1), (3, 1, 4)])
def test_mirrored_cells_are_on_their_own_side(folder, caplog, second):
    path = write(folder / "mirrored.msh", SQUARE, [CELLS[0], second], [1, 1])
    assert nts.read_mesh(path, MPI.COMM_WORLD).mesh.topology.dim == 2
    assert ONE_SIDE not in caplog.text


@pytest.mark.parametrize("moved", [0.7, 1.2])
def test_tetrahedra_are_checked_too(caplog, moved):
    """Of a cube of 48 tetrahedra the inner node moves, or leaves through a face of its cells."""

    def build(model):
        box = {"corner": (0, 0, 0), "size": (1, 1, 1), "cells": (2, 2, 2)}
        parts.add_box(model, "box", **box, cell="tetrahedron")
        tags, x, _ = model.mesh.getNodes()
        inner = int(tags[abs(x.reshape(-1, 3) - 0.5).max(axis=1).argmin()])
        model.mesh.setNode(inner, [moved, 0.5, 0.5], [])

    mesh = nts.read_mesh(build, MPI.COMM_WORLD).mesh
    assert mesh.topology.index_map(3).size_global == 48
    assert (ONE_SIDE in caplog.text) == (moved > 1 and MPI.COMM_WORLD.rank == 0)
