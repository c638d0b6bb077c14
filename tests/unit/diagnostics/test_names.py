"""Names of columns follow one rule, and no two are alike."""

import numpy as np
import pytest

from dolfinx_nts.diagnostics.names import ByName, flat, part_names

pytestmark = pytest.mark.serial


def test_names_of_parts_are_words_without_letters_that_a_column_cannot_have():
    names = ["Ball outer RigidPlane", "body 7", "Größe (mm)"]
    assert part_names("body", names) == ["ball_outer_rigid_plane", "7", "größe_mm"]


def test_prefixes_of_a_name_are_left_out_and_its_words_are_kept():
    names = [
        *("a moving RigidPlane", "the boundary of tube", "a part of the boundary of tube"),
        *("a", "a_rim", "rim", "end of the rod", "the boundary of a, a RigidSphere"),
    ]
    assert part_names("body", names) == [
        *("moving_rigid_plane", "boundary_tube", "part_boundary_tube"),
        *("a", "a_rim", "rim", "end_of_the_rod", "boundary_a_rigid_sphere"),
    ]


def test_names_that_are_alike_too_long_or_empty_get_numbers():
    assert part_names("pair", ["a b", "c", "A-B", 50 * "d", "%"]) == [
        *("a_b_1", "c", "a_b_3", "4", "unnamed"),
    ]


def test_parts_are_found_by_their_column_name_and_by_the_name_given():
    forces = ByName("obstacle", ["rigid_sphere", "lid"], [1.0, 2.0])
    assert forces["rigid_sphere"] == forces["RigidSphere"] == 1.0
    assert list(forces.items()) == [("rigid_sphere", 1.0), ("lid", 2.0)]
    said = r"there is no obstacle 'Lit': did you mean 'lid'\?; there are \['rigid_sphere', 'lid'\]"
    with pytest.raises(KeyError, match=said):
        forces["Lit"]


def test_vectors_become_three_columns():
    columns = flat("body_ball_", {"mass": 2.0, "velocity": np.array([1.0, 2.0, 3.0])})
    names = "body_ball_mass", *(f"body_ball_velocity_{axis}" for axis in "xyz")
    assert columns == dict(zip(names, [2.0, 1.0, 2.0, 3.0], strict=True))
