"""Small sums of friction over pairs, against NumPy."""

import numpy as np
import pytest

from dolfinx_nts import _kernels

pytestmark = pytest.mark.serial

M, N, D, MU = 5, 9, 12, 0.3


class Friction:
    """Friction of `N` nodes, of which `M` have pairs."""

    def __init__(self, rng, has_springs=False):
        """Draw random states of the nodes; the last pair is on an axis, the third inactive."""
        self.node = rng.permutation(N)[:M].astype(np.int32)
        self.active = np.array([True, True, False, True, True])
        self.on_axis, self.rounding = np.zeros(N, dtype=bool), np.full(N, 1e-9)
        self.on_axis[self.node[4]] = True
        self.sliding = np.zeros(N, dtype=bool)
        self.sliding[self.node[1:]] = True
        self.flips = np.zeros(N, dtype=np.int32)
        self.traction, self.explicit, self.direction, self.heading = rng.normal(size=(4, N, 2))
        self.present, self.modelled = rng.normal(size=(2, N, 2))
        self.stiffness = rng.normal(size=(N, 2, 2))
        self.frame = np.zeros((N, 2, 3))
        names = "on_axis rounding sliding flips traction explicit direction stiffness heading"
        arrays = (getattr(self, name) for name in f"{names} present modelled frame".split())
        self.kernel = _kernels.NodalFriction(has_springs, *arrays)


def test_nodes_at_the_limit_or_on_the_axis_keep_their_state(rng):
    of, limit, known = Friction(rng), np.full(M, 2 * MU), np.zeros(M, dtype=bool)
    trial = np.array([[0.3, 0.0], [1.0, 0.0], [0.1, 0.0], [0.6, 0.0], [0.0, 0.0]])
    of.heading[of.node] = of.traction[of.node] = [1.0, 0.0]
    of.traction[of.node[0]] = 0.0
    heading, sliding = of.kernel.judge(of.node, known, limit, trial, trial)
    assert sliding.tolist() == [False, True, False, True, True]
    np.testing.assert_array_equal(heading[0], trial[0])
    # The pressing force of new contacts is unknown.
    _, unknown = of.kernel.judge(of.node, of.active, limit, trial, trial)
    assert unknown.tolist() == [False, True, False, True, True]
    # Without a pressing force, what has a tangential force slides.
    assert of.kernel.judge(of.node, known, 0 * limit, trial, trial)[1][:4].all()
    # Nodes stick before their slip reverses.
    assert not of.kernel.judge(of.node, known, limit, -2 * trial, -trial)[1][1]


@pytest.mark.parametrize("has_springs", [False, True])
def test_tractions_follow_their_model(rng, has_springs):
    of = Friction(rng, has_springs)
    sliding, before = np.array([True, False, True, True, True]), of.traction.copy()
    p, limiting = rng.random((2, M))
    slip, explicit, direction = rng.normal(size=(3, M, 2))
    model, lags = (explicit, direction, rng.normal(size=(M, 2, 2))), np.arange(M) == 3
    of.kernel.accept(of.node, of.active, sliding, p, slip, *model, lags, limiting)
    assert of.flips[of.node].tolist() == [1, 1, 0, 0, 0]
    np.testing.assert_array_equal(of.sliding[of.node], sliding)
    np.testing.assert_array_equal(of.modelled[of.node], slip)
    traction = explicit + p[:, None] * direction
    traction[3] = explicit[3] + limiting[3] * direction[3]
    traction[[2, 4]] = 0.0
    if not has_springs:
        traction[1] = before[of.node[1]]
    np.testing.assert_allclose(of.traction[of.node], traction, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(of.heading[of.node[:4]], direction[:4])
    assert not of.direction[of.node[3:]].any()
    others = np.setdiff1d(np.arange(N), of.node)
    np.testing.assert_array_equal(of.traction[others], before[others])


def test_known_tractions_turn_with_the_slip_of_sliding_nodes(rng):
    of, not_own = Friction(rng), np.arange(M) == 3
    rank, known, direction = of.kernel.known(of.node, of.active, not_own, 3)
    assert rank.tolist() == [3, 1, 0, 0, 1]
    turned = np.einsum("nij,nj->ni", of.stiffness, of.present - of.modelled)
    expected = (of.explicit + turned)[of.node]
    expected[0] = 0.0
    np.testing.assert_allclose(known, expected, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(direction, of.direction[of.node])
    multipliers = rng.normal(size=(M, 3))
    of.kernel.balance(of.node, of.active, rank, multipliers, known)
    traction = known - multipliers[:, :1] * direction
    traction[0], traction[2] = multipliers[0, 1:], 0.0
    np.testing.assert_allclose(of.traction[of.node], traction, rtol=0, atol=1e-14)
    with pytest.raises(ValueError, match="expected row numbers of the other arrays"):
        of.kernel.known(of.node + N, of.active, not_own, 3)


def test_known_tractions_are_the_same_in_other_frames(rng):
    of, names = Friction(rng), ("traction", "explicit", "direction", "heading", "modelled")
    frame = np.linalg.qr(rng.normal(size=(M, 3, 3)))[0][:, :2]
    before = {name: getattr(of, name).copy() for name in (*names, "stiffness")}
    of.kernel.turn(of.node, frame)  # a node without a frame takes the first one
    for name, values in before.items():
        np.testing.assert_array_equal(getattr(of, name), values)
    turned = rng.permutation(np.array([[1.0, 0.0], [0.0, -1.0]]))[None] @ frame
    of.kernel.turn(of.node, turned)
    for name in names:
        vectors = (
            np.einsum("ma,mai->mi", values[of.node], tangents)
            for values, tangents in ((before[name], frame), (getattr(of, name), turned))
        )
        np.testing.assert_allclose(*vectors, rtol=0, atol=1e-14)
    tensors = (
        np.einsum("mab,mai,mbj->mij", values[of.node], tangents, tangents)
        for values, tangents in ((before["stiffness"], frame), (of.stiffness, turned))
    )
    np.testing.assert_allclose(*tensors, rtol=0, atol=1e-14)
    # Lengths stay the same where planes differ, as they do beyond an edge.
    length = np.linalg.norm(of.traction, axis=1)
    of.kernel.turn(of.node, np.linalg.qr(rng.normal(size=(M, 3, 3)))[0][:, :2])
    np.testing.assert_allclose(np.linalg.norm(of.traction, axis=1), length, rtol=1e-14)
    with pytest.raises(ValueError, match="expected row numbers of the other arrays"):
        of.kernel.turn(of.node + N, frame)


def test_tractions_act_along_both_tangents(rng):
    of = Friction(rng)
    rows, force = rng.normal(size=(M, 3, D)), rng.normal(size=(M, D))
    t, s = of.traction[of.node], of.direction[of.node]
    slides = of.active & of.sliding[of.node]
    assert np.array_equal(of.kernel.sticks(of.node, of.active), of.active & ~slides)
    expected = force + np.einsum("mi,mid->md", t, rows[:, 1:])
    columns, slopes = of.kernel.add_to(of.node, of.active, rows, rows, force)
    np.testing.assert_allclose(force, expected, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(columns[:, 1:], rows[:, 1:])
    mixed = _kernels.with_friction(rows, np.where(slides[:, None], s, 0.0))
    np.testing.assert_allclose(columns, mixed, rtol=0, atol=1e-14)
    assert not slopes[:, 0].any() and not slopes[:, :, 0].any()
    K = np.where(slides[:, None, None], of.stiffness[of.node], 0.0)
    np.testing.assert_array_equal(slopes[:, 1:, 1:], K)


def test_points_stand_before_the_vertices_of_their_segments(rng):
    points, x = rng.normal(size=(M, 3)), rng.normal(size=(N, 3))
    vertices = rng.integers(N, size=(4, 3)).astype(np.int32)
    segment = rng.integers(4, size=M).astype(np.int32)
    pairs = _kernels.with_vertices(points, x, vertices, segment)
    np.testing.assert_array_equal(pairs[:, 0], points)
    np.testing.assert_array_equal(pairs[:, 1:], x[vertices[segment]])
    with pytest.raises(ValueError, match="expected row numbers of vertices"):
        _kernels.with_vertices(points, x, vertices, segment - 4)
    with pytest.raises(ValueError, match="expected row numbers of x"):
        _kernels.with_vertices(points, x, vertices + N, segment)


def test_unit_vectors_have_unit_length_or_none(rng):
    rows = rng.normal(size=(M, D))
    rows[2] = 0
    unit = _kernels.unit_vectors(rows)
    length = np.linalg.norm(rows[:, :3], axis=1)
    np.testing.assert_array_equal(unit[2], 0)
    np.testing.assert_allclose(unit * length[:, None], rows[:, :3], rtol=0, atol=1e-14)


def test_vectors_stay_in_cones_up_to_the_longest_step(rng):
    v, travel = rng.normal(size=(2, M, 3))
    v[:, 0] = 0.1 + np.linalg.norm(v[:, 1:], axis=1)
    longest = _kernels.longest_in_cones(v, travel)

    def distance(part):
        x = v + part * travel
        return (x[:, 0] - np.linalg.norm(x[:, 1:], axis=1)).min()

    assert abs(distance(longest)) < 1e-13
    assert distance(longest / 2) > 0
    assert np.isinf(_kernels.longest_in_cones(v, v))
