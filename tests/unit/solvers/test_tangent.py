"""Matrix of the tangent: its age, and how a former one comes back."""

import numpy as np

from helpers import scenes


def test_a_former_matrix_comes_back_bit_for_bit(comm, agree):
    stepper = scenes.blocks(comm).stepper
    tangent, u = stepper._tangent, stepper.u.x.array
    former = []
    for assemble in (tangent.assemble_nearby, tangent.assemble_exact):
        u[:] += 0.01 * np.sin(np.arange(len(u)) + len(former))
        stepper.u.x.scatter_forward()
        assemble()
        former.append((tangent.point, tangent.rows.value.copy(), tangent.nodal_stiffness()))
    present = u.copy()
    assert not np.array_equal(former[0][1], former[1][1])
    for count, (point, value, stiffness) in enumerate(former, start=3):
        tangent.restore(point)
        assert agree(np.array_equal(tangent.rows.value, value))
        assert agree(np.array_equal(tangent.nodal_stiffness(), stiffness))
        assert tangent.num_assembled == count
        np.testing.assert_array_equal(u, present)


def test_stiffness_of_nodes_asks_for_a_matrix_only_if_there_is_none(comm):
    tangent = scenes.blocks(comm).stepper._tangent
    first = tangent.nodal_stiffness()
    assert tangent.nodal_stiffness() is first and tangent.num_assembled == 1
    tangent.forget()
    np.testing.assert_array_equal(tangent.nodal_stiffness(), first)
    assert tangent.num_assembled == 2 and first.min() > 0
