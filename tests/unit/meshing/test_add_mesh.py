"""Bodies from mesh files in a gmsh model."""

from mpi4py import MPI

import gmsh
import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers.models.gmsh_models import BOX, ROUNDING, count, measure

pytestmark = pytest.mark.serial


@pytest.fixture
def box(tmp_path):
    """File of the box of `BOX` with its surfaces."""
    path = tmp_path / "box.msh"

    def fill(model):
        parts.add_box(model, "box", **BOX)
        gmsh.write(str(path))

    nts.read_mesh(fill, MPI.COMM_SELF)
    return path


def test_a_file_gives_several_bodies_that_are_scaled_turned_and_shifted(box):
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

    def build(model):
        parts.add_mesh(model, "low", box)
        parts.add_mesh(model, "high", box, move=lambda x: 2 * x @ turn.T + (0, 0, 5))

    data = nts.read_mesh(build, MPI.COMM_SELF)
    assert [count(data, data.cells, name) for name in ("low", "high")] == [8, 8]
    assert count(data, data.facets, "high_box_top") == 4
    volumes = [measure(data, name) for name in ("low", "high")]
    assert volumes[1] == pytest.approx(8 * volumes[0], rel=ROUNDING)
    x = data.mesh.geometry.x
    corner, size = np.array(BOX["corner"]), np.array(BOX["size"])
    ends = 2 * np.array([corner, corner + size]) @ turn.T + (0, 0, 5)
    high = x[x[:, 2] > 2.5]
    np.testing.assert_allclose([high.min(axis=0), high.max(axis=0)], np.sort(ends, axis=0))


def test_a_file_of_the_plane_is_a_body_of_the_plane(tmp_path):
    path = tmp_path / "plane.msh"
    path.write_text(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 9 9 0\n2 0 0 0\n3 1 0 0\n4 0 1 0\n"
        "$EndNodes\n$Elements\n1\n1 2 2 0 7 2 3 4\n$EndElements\n"
    )
    data = nts.read_mesh(lambda model: parts.add_mesh(model, "part", path), MPI.COMM_SELF)
    assert list(data.tag) == ["part"] and len(data.mesh.geometry.x) == 3


@pytest.mark.parametrize(
    ("move", "match"),
    [
        (lambda x: x[:, :2], r"positions of shape \(27, 3\) from move, given \(27, 2\)"),
        (lambda x: "up", "expected .*move"),
    ],
)
def test_wrong_positions_are_refused(box, move, match):
    with pytest.raises((ValueError, TypeError), match=match):
        nts.read_mesh(lambda model: parts.add_mesh(model, "a", box, move=move), MPI.COMM_SELF)
