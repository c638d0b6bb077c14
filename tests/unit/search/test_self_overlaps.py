"""Bodies inside themselves, against closed forms."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.search.overlap.overlaps import OverlapSearch
from helpers.once import once
from reference.bulk import rotation

LENGTH, THICKNESS, WIDENING = 2 * np.pi + 0.83, 0.2, 0.02
RUBBER = nts.NeoHookean(E=1e5, nu=0.3, rho=1e3)


def strip(comm, cell="hexahedron", length=LENGTH):
    """A straight strip, slightly longer than 2 pi."""
    mesh, tags, _, tag = nts.read_mesh(
        lambda model: parts.add_box(
            model,
            "strip",
            corner=(0, -0.5, 0),
            size=(length, 1, THICKNESS),
            cells=(56, 3, 2),
            cell=cell,
        ),
        comm,
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    return nts.Body(V, tags, tag["strip"], RUBBER)


def spiral(X, turn):
    """The strip wound to a spiral with a given distance of turns; its width grows along it."""
    s, y, z = X.T
    radius = 1 + turn * s / (2 * np.pi) - z
    wound = np.column_stack([radius * np.cos(s), y * (1 + WIDENING * s), radius * np.sin(s)])
    return wound @ rotation(np.array([1.0, 0.4, -2.0]), 0.8).T


def is_inside(X, turn):
    """Which points of the strip are inside another turn."""
    found = np.zeros(len(X), dtype=bool)
    s, y, z = X.T
    for travel in (-2 * np.pi, 2 * np.pi):
        there = s + travel
        y_there = y * (1 + WIDENING * s) / (1 + WIDENING * there)
        z_there = z + turn * travel / (2 * np.pi)
        within = (there > 0) & (there < LENGTH) & (abs(y_there) < 0.5)
        found |= within & (z_there > 0) & (z_there < THICKNESS)
    return found


@pytest.mark.parametrize("cell", ["hexahedron", once("tetrahedron")])
def test_turns_of_a_spiral_are_as_deep_in_each_other_as_they_are_too_near(comm, cell):
    body = strip(comm, cell)
    X, turn = body.V.tabulate_dof_coordinates(), 0.12
    (overlap,), _ = OverlapSearch([body], []).find(spiral(X, turn))
    assert overlap.names == ("strip", "strip")
    # Up to the error of facets between nodes.
    assert overlap.depth == pytest.approx(THICKNESS - turn, rel=0.1)
    n = body.V.dofmap.index_map.size_local
    own, low, high = X[:n], [0, -0.5, 0], [LENGTH, 0.5, THICKNESS]
    outer = (np.isclose(own, low) | np.isclose(own, high)).any(axis=1)
    assert overlap.nodes == comm.allreduce(int(is_inside(own[outer], turn).sum()))
    centres = X[body.V.dofmap.list[body.cells]].mean(axis=1)
    cells = body.V.mesh.topology.index_map(3).size_local
    own = body.cells < cells
    assert overlap.cells == comm.allreduce(int(is_inside(centres[own], turn).sum()))


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("turn", [once(0.25), THICKNESS])
def test_turns_that_are_apart_or_touch_do_not_overlap(comm, turn):
    # Nodes of each turn are above the nodes of the turn below.
    body = strip(comm, length=2 * np.pi * 56 / 48)
    found, _ = OverlapSearch([body], []).find(spiral(body.V.tabulate_dof_coordinates(), turn))
    assert found == []


@pytest.mark.serial
def test_only_named_boundaries_are_checked():
    body = strip(MPI.COMM_SELF)
    x = spiral(body.V.tabulate_dof_coordinates(), 0.12)
    assert OverlapSearch([body], []).find(x, selves=())[0] == []
