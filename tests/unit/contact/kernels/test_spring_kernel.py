"""Springs of an explicit step, against NumPy."""

import numpy as np
import pytest

from dolfinx_nts import _kernels

pytestmark = pytest.mark.serial


@pytest.mark.parametrize("k", [3, 4])
def test_springs_press_nodes_that_are_inside(rng, k):
    c = 6
    gap = np.array([-0.1, 0.2, np.nan, -0.3, 0.0, -0.2])
    segment = np.array([1, 0, -1, 2, 1, 0], dtype=np.int32)
    node, segments = np.arange(20, 20 + c, dtype=np.int32), np.arange(3 * k).reshape(3, k)
    xi, normal, stiffness = rng.uniform(size=(c, 2)), rng.normal(size=(c, 3)), rng.uniform(size=c)
    number, key = np.arange(40, 40 + c, dtype=np.int32), np.array([7, 5, 9])
    springs = _kernels.penalty_forces(
        number, node, segment, xi, gap, normal, segments.astype(np.int32), key, stiffness
    )
    position, dofs, force, energy = [0, 3, 5], springs.dofs, springs.force, springs.energy
    np.testing.assert_array_equal(springs.node, number[position])
    np.testing.assert_array_equal(springs.key, key[segment[position]])
    np.testing.assert_array_equal(dofs[:, 0], node[position])
    np.testing.assert_array_equal(dofs[:, 1:], segments[segment[position]])
    s, t = xi[position].T
    if k == 3:
        phi = np.column_stack([1 - s - t, s, t])
    else:
        phi = np.column_stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t])
    shape = np.column_stack([np.ones(3), -phi])
    size = (stiffness * gap)[position]
    np.testing.assert_allclose(force, -(size[:, None] * shape)[:, :, None] * normal[position, None])
    np.testing.assert_allclose(energy, (stiffness * gap**2)[position] / 2)
    np.testing.assert_allclose(force.sum(axis=1), 0, atol=1e-15)


@pytest.mark.parametrize("num_own", [1, 2])
def test_contact_of_springs_is_put_where_their_nodes_are(rng, num_own):
    n, gap = 9, np.array([-0.1, 0.2, np.nan, -0.3, -0.2])
    number, segment = np.array([1, 2, 4, 7, 8], np.int32), np.array([1, 0, -1, 2, 0], np.int32)
    stiffness, key, pressed = rng.uniform(1, 2, 5), np.array([7, 5, 9]), gap < 0
    node, force = number[pressed], rng.normal(size=(3, 5, 3))
    dofs, energy = np.zeros((3, 5), dtype=np.int32), rng.uniform(size=3)
    springs = _kernels.Springs(node, key[segment[pressed]], dofs, force, energy)
    found = _kernels.contact_of_springs(springs, num_own, n, number, segment, gap, key, stiffness)
    keys, multiplier, gaps = np.full(n, -1), np.zeros(n), np.full(n, np.nan)
    forces, normals, energies = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
    keys[number[[0, 1, 3, 4]]] = key[segment[[0, 1, 3, 4]]]
    multiplier[node], gaps[number], energies[node] = (stiffness * gap)[pressed], gap, energy
    forces[node] = force[:, :num_own].sum(axis=1)
    normals[node] = forces[node] / -multiplier[node, None]
    active = np.isin(np.arange(n), node)
    expected = keys, active, multiplier, forces, gaps, normals, energies
    for value, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(value, other)


def test_springs_of_a_node_on_several_segments_are_summed_up(rng):
    node, key = np.array([2, 2, 5], np.int32), np.array([7, 5, 9])
    number, segment = np.array([2, 2, 4, 5], np.int32), np.array([2, 0, 1, 1], np.int32)
    gap, stiffness = np.array([-0.1, -0.1, 0.3, -0.2]), np.array([1.0, 1.0, 3.0, 4.0])
    normal, energy = rng.normal(size=(3, 3)), rng.uniform(size=3)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    pressed = gap < 0
    force = (-(stiffness * gap)[pressed, None] * normal)[:, None].repeat(5, axis=1)
    dofs = np.zeros((3, 5), dtype=np.int32)
    springs = _kernels.Springs(node, key[segment[pressed]], dofs, force, energy)
    assert springs.num_nodes == 2
    found = _kernels.contact_of_springs(springs, 1, 6, number, segment, gap, key, stiffness)
    keys, active, multiplier, forces, gaps, normals, energies = found
    np.testing.assert_array_equal(keys, [-1, -1, 9, -1, 5, 5])
    np.testing.assert_array_equal(np.flatnonzero(active), [2, 5])
    np.testing.assert_allclose(multiplier[[2, 5]], [-0.2, -0.8])
    np.testing.assert_allclose(forces[2], 0.1 * (normal[0] + normal[1]))
    np.testing.assert_allclose(energies[[2, 5]], [energy[0] + energy[1], energy[2]])
    np.testing.assert_array_equal(gaps, [np.nan, np.nan, -0.1, np.nan, 0.3, -0.2])
    mean = normal[0] + normal[1]
    np.testing.assert_allclose(normals[[2, 5]], [mean / np.linalg.norm(mean), normal[2]])


def test_contact_of_nodes_is_summed_up(rng):
    """The mortar gives areas of its own to some nodes."""
    x, nodes = rng.normal(size=(7, 3)), np.array([4, 0, 6], np.int32)
    force, energy, area = rng.normal(size=(3, 3)), rng.uniform(size=3), rng.uniform(size=3)
    active, acts_on = np.array([True, False, True]), np.array([0.0, 3.0, 5.0])
    expected = [energy.sum(), 2, area[0] + 5.0, *force.sum(axis=0)]
    expected += [*np.cross(x[nodes], force).sum(axis=0)]
    contact = force, energy, active, acts_on, area
    found = _kernels.contact_sums(x, nodes, *contact)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)
    assert not _kernels.contact_sums(x, nodes[:0], *(each[:0] for each in contact)).any()
    with pytest.raises(ValueError, match="nodes: expected row numbers of x"):
        _kernels.contact_sums(x[:6], nodes, *contact)


def test_arrays_of_springs_must_fit():
    node, key = np.zeros(2, dtype=np.int32), np.zeros(2, dtype=np.int64)
    dofs, force, energy = np.ones((2, 5), dtype=np.int32), np.zeros((2, 5, 3)), np.zeros(2)
    springs = _kernels.Springs(node, key, dofs, force, energy)
    springs.force[1, 2] = 3.0
    assert force[1, 2, 0] == 3.0  # the same array, which friction adds to
    with pytest.raises(ValueError, match=r"force: expected shape \(2, 5, 3\), given \(2, 4, 3\)"):
        _kernels.Springs(node, key, dofs, np.zeros((2, 4, 3)), energy)
    none = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.int32), np.empty(0)
    with pytest.raises(ValueError, match="num_own: expected at most the number of nodes"):
        _kernels.contact_of_springs(springs, 6, 9, *none, key, np.empty(0))
    beyond = np.array([9], dtype=np.int32), np.array([0], dtype=np.int32), np.ones(1)
    with pytest.raises(ValueError, match="number: expected numbers of nodes"):
        _kernels.contact_of_springs(springs, 1, 9, *beyond, key, np.ones(1))
    with pytest.raises(ValueError, match="row numbers of du"):
        _kernels.work_by_cause(springs, springs, np.zeros((1, 3)), np.zeros((2, 3)), np.empty(0))
    with pytest.raises(ValueError, match="row numbers of dissipation"):
        late = _kernels.Springs(node + 1, key, dofs, force, energy)
        _kernels.work_by_cause(springs, late, np.zeros((2, 3)), np.zeros((2, 3)), np.zeros(1))


@pytest.mark.parametrize("friction", [False, True])
def test_work_is_sorted_by_cause(rng, friction):
    n, k = 40, 4
    states, full = [], []
    for m in (17, 23):
        node = np.sort(rng.choice(n, m, replace=False)).astype(np.int32)
        key, dofs = rng.integers(2, size=m), rng.integers(9, size=(m, 1 + k)).astype(np.int32)
        force, energy, du = (
            rng.normal(size=(m, 1 + k, 3)),
            rng.uniform(size=m),
            rng.normal(size=(9, 3)),
        )
        states.append((_kernels.Springs(node, key, dofs, force, energy), du))
        keys, work, stored = np.full(n, -1), np.zeros(n), np.zeros(n)
        keys[node], stored[node] = key, energy
        work[node] = np.einsum("maj,maj->m", force, du[dofs])
        full.append((keys, work, stored))
    (key_n, work_n, energy_n), (key, work, energy) = full
    touched = (key_n >= 0) | (key >= 0)
    dissipation = np.where(touched, rng.uniform(size=n), 0.0) if friction else np.zeros(n)
    remainder = (work_n + work) / 2 + energy - energy_n + dissipation
    came, same = key_n < 0, (key_n == key) | (key < 0)
    expected = [remainder[part].sum() for part in (~came & same, came, ~came & ~same)]
    expected += [(energy_n - energy).sum(), -dissipation.sum()]
    (before, du_n), (after, du) = states
    given = _kernels.work_by_cause(
        before, after, du_n, du, dissipation if friction else np.empty(0)
    )
    np.testing.assert_allclose(given, expected)


def test_work_of_a_node_on_several_segments_has_one_cause(rng):
    """Node 1 stays on two segments, 2 goes to another set, 3 comes and 4 leaves."""

    def springs(node, key):
        m = len(node)
        values = rng.normal(size=(m, 4, 3)), rng.uniform(size=m)
        dofs = rng.integers(9, size=(m, 4)).astype(np.int32)
        return _kernels.Springs(np.array(node, np.int32), np.array(key), dofs, *values)

    def remainder(number):
        work = 0.0
        for side, sign in ((before, -1), (after, 1)):
            rows = side.node == number
            work += np.vdot(side.force[rows], du[side.dofs[rows]]) / 2
            work += sign * side.energy[rows].sum()
        return work + dissipation[number]

    du, dissipation = rng.normal(size=(9, 3)), rng.uniform(size=5)
    before = springs([1, 1, 2, 2, 4, 4], [5, 6, 5, 6, 7, 8])
    after = springs([1, 1, 2, 3, 3], [5, 6, 5, 1, 2])
    given = _kernels.work_by_cause(before, after, du, du, dissipation)
    stored = before.energy.sum() - after.energy.sum()
    causes = [remainder(1) + remainder(4), remainder(3), remainder(2)]
    np.testing.assert_allclose(given, [*causes, stored, -dissipation.sum()])


def test_rows_that_repeat_are_all_added(rng):
    total, rows = rng.normal(size=(5, 3)), np.array([[0, 3], [3, 0], [4, 4]], dtype=np.int32)
    values, expected = rng.normal(size=(3, 2, 3)), total.copy()
    np.add.at(expected, rows, values)
    _kernels.add_rows(total[:4], total[4:], rows, values)
    np.testing.assert_allclose(total, expected)
    with pytest.raises(ValueError, match="row numbers of total"):
        _kernels.add_rows(total[:4], total[4:], rows + 1, values)
