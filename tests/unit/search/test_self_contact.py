"""Local search of a surface with itself, compared with brute force over all segments."""

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.self_contact import SelfContactSearch
from helpers.once import once
from helpers.scenes import part
from reference.bulk import rotation

REACH = 0.25
cells_ = pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])


def strip(comm, cell, thickness, cells=(24, 1, 2)):
    """Boundary of a straight strip of length 2 along x."""
    size, number = (2.0, 0.2, thickness), (cells[0], cells[2], cells[1])
    V, tags, _, tag = part(comm, "box", cell, corner=(0, 0, 0), size=size, cells=number)
    rubber = nts.SaintVenantKirchhoff(E=1e5, nu=0.3, rho=1e3)
    return nts.boundary_of(nts.Body(V, tags, tag["box"], rubber))


def folded(X, distance):
    """The strip bent into a U; its ends are parallel, a distance apart."""
    radius = distance / 2
    straight = 1 - np.pi * radius / 2
    s, y, z = X.T
    angle = np.clip((s - straight) / radius, 0, np.pi)
    bend = np.stack(
        [straight + (radius - z) * np.sin(angle), radius - (radius - z) * np.cos(angle)]
    )
    before, after = np.minimum(s - straight, 0), np.maximum(s - straight - np.pi * radius, 0)
    x = np.column_stack([bend[0] + before - after, y, bend[1]])
    return x @ rotation([1, 2, 3], 0.7).T


def searched(surface, x, reach=REACH):
    """Segments of the surface's nodes: candidates, segment, gap, normals."""
    candidates, _ = SelfContactSearch(surface, surface).update(x, reach)
    x = candidates.scatter.forward(x)
    none = np.full(len(surface.nodes), -1, dtype=np.int32)
    return candidates, x, *candidates.pair(NodalPoints(surface.nodes), x, none, reach)


@cells_
@pytest.mark.parametrize("thickness", [once(0.1), 0.01])
@pytest.mark.parametrize("share", [once(0.0), once(0.2), 1.0])
def test_straight_strip_touches_nothing_of_itself(comm, cell, thickness, share):
    surface = strip(comm, cell, thickness)
    X = surface.V.tabulate_dof_coordinates()
    # Slightly bent, and pressed flat to a fifth.
    x = (
        X * [1, 1, 1 - 0.8 * share]
        + share * np.column_stack([0 * X[:, 0], 0 * X[:, 0], X[:, 0] ** 2]) / 9
    )
    *_, segment, gap = searched(surface, x)
    assert comm.allreduce(int(np.count_nonzero(segment >= 0))) == 0
    assert np.isnan(gap).all()


@cells_
@pytest.mark.parametrize("thickness", [once(0.05), 0.01])
@pytest.mark.parametrize("gap", [once(0.03), once(0.003), -0.004])
def test_legs_of_a_folded_strip_touch_with_the_sides_that_face_each_other(
    comm, cell, thickness, gap
):
    surface = strip(comm, cell, thickness)
    X = surface.V.tabulate_dof_coordinates()
    distance = 0.1 + 2 * thickness
    x = folded(X, distance)
    # Bring the ends together without bending more.
    upper = X[:, 0] > 1
    x[upper] += rotation([1, 2, 3], 0.7) @ [0, 0, gap - distance + 2 * thickness]
    *_, segment, found = searched(surface, x)
    face = np.isclose(X[surface.nodes, 2], thickness)
    end = np.minimum(X[surface.nodes, 0], 2 - X[surface.nodes, 0]) < 0.7
    inside = np.abs(X[surface.nodes, 0] % 2 - 1) < 0.999
    legs = face & end & inside
    assert comm.allreduce(int(np.count_nonzero(legs))) > 40
    assert np.all(segment[legs] >= 0)
    assert np.allclose(found[legs], gap, atol=1e-3 * abs(gap) + 1e-12)
    # Sides that do not face each other stay without a segment.
    others = np.isclose(X[surface.nodes, 2], 0) & end & inside
    assert comm.allreduce(int(np.count_nonzero(others))) > 40
    assert np.all(segment[others] < 0)


@cells_
@pytest.mark.parametrize("radius", [once(0.9), 0.06])
def test_nodes_of_a_cavity_face_the_other_side_of_it(comm, cell, radius):
    shape = {"inner_radius": 0.9, "outer_radius": 1.0, "cells_per_edge": 4, "layers": 1}
    V, _, facets, tag = part(comm, "hollow_ball", cell, centre=(0, 0, 0), **shape)
    surface = nts.Surface(V, facets, tag["hollow_ball_inner"])
    X = V.tabulate_dof_coordinates()
    x = X * [1, 1, radius / 0.9]
    *_, gap = searched(surface, x, 2.0)
    pole = np.linalg.norm(X[surface.nodes, :2], axis=1) < 0.3
    assert comm.allreduce(int(np.count_nonzero(pole))) > 1
    # The height of the cavity, reduced by the chord error of facets.
    height = 2 * np.abs(x[surface.nodes[pole], 2])
    assert np.all(np.abs(gap[pole] / height - 1) < 0.1)


def test_node_keeps_its_segment_and_is_not_given_one_it_may_not_touch(comm):
    surface = strip(comm, "hexahedron", 0.05)
    x = folded(surface.V.tabulate_dof_coordinates(), 0.2)
    candidates, x, segment, gap = searched(surface, x)
    again = candidates.pair(NodalPoints(surface.nodes), x, segment, REACH)
    assert np.array_equal(again[0], segment)
    assert np.array_equal(again[1], gap, equal_nan=True)
    # A node does not keep a segment to which it belongs itself.
    own = np.full(len(segment), -1, dtype=np.int32)
    for number, vertices in enumerate(candidates.segments):
        own[np.isin(surface.nodes, vertices)] = number
    assert np.array_equal(candidates.pair(NodalPoints(surface.nodes), x, own, REACH)[0], segment)
