"""The shortest straight path through a body, against boxes and a shell."""

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_nts.model.thickness import least_thickness

pytestmark = pytest.mark.at_most_two_ranks

ROUNDING = 1e-4  # the paths begin just below the triangles


def box(corner, size):
    """Triangles of a box in outward sense."""
    x = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=float)
    sides = [(0, 2, 1, 3), (4, 5, 6, 7), (0, 1, 4, 5), (2, 6, 3, 7), (0, 4, 2, 6), (1, 3, 5, 7)]
    rows = [row for a, b, c, d in sides for row in ((a, b, c), (b, d, c))]
    return (np.array(corner) + x * size)[rows]


def wall(comm, triangles):
    """The thinnest wall, of triangles that the ranks share."""
    return least_thickness(comm, triangles[comm.rank :: comm.size])


@pytest.mark.parametrize("size", [(1.0, 2.0, 3.0), (2.0, 0.1, 5.0)])
def test_a_box_is_as_thick_as_its_shortest_edge(comm, size):
    np.testing.assert_allclose(wall(comm, box((3, 1, 2), size)), min(size), rtol=ROUNDING)


def test_a_hollow_box_is_as_thick_as_its_wall(comm):
    inner = box((0.1, 0.2, 0.3), (0.5, 0.6, 0.65))[:, ::-1]
    triangles = np.concatenate([box((0, 0, 0), (1.0, 1.0, 1.0)), inner])
    np.testing.assert_allclose(wall(comm, triangles), 0.05, rtol=ROUNDING)


def test_a_surface_without_another_side_is_as_thick_as_it_is_wide(comm):
    top = box((0, 0, 0), (3.0, 4.0, 1.0))[2:4]
    np.testing.assert_allclose(wall(comm, top), 5.0, rtol=ROUNDING)


def test_without_triangles_thickness_is_infinite():
    assert least_thickness(MPI.COMM_SELF, np.empty((0, 3, 3))) == np.inf
