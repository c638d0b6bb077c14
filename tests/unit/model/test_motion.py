"""Moving obstacles, compared with fixed obstacles at the moved position."""

import numpy as np
import pytest

import dolfinx_nts as nts
from reference.bulk import rotation, taylor_order

pytestmark = pytest.mark.serial

ROUNDING = 1e3 * np.finfo(float).eps
CENTRE, AXIS, ANGLE = np.array([0.2, -0.1, 0.4]), np.array([1.0, -2.0, 0.5]), 0.7
FIRST, SHIFT = np.array([0.1, 0.3, -0.2]), np.array([-0.2, 0.05, 0.3])
UPWARD, ALONG = np.array([1.0, 2.0, 2.0]), np.array([1.0, 0.0, 0.0])
CORNERS = np.array([[-3.0, -3, 0], [3, -3, 0.2], [-3, 3, -0.1], [3, 3, 0.3]])


def start(X):
    return CENTRE + FIRST + (X - CENTRE) @ rotation([0, 1, 1], 0.4).T


def turn(angle):
    return rotation(AXIS, angle) @ rotation([0, 1, 1], 0.4)


def end(X):
    return CENTRE + FIRST + SHIFT + (X - CENTRE) @ turn(ANGLE).T


MOTION = nts.Motion(lambda t: FIRST + t * SHIFT, lambda t: turn(t * ANGLE), CENTRE)
FRAME = MOTION.frame(0.0, 1.0)
# Each obstacle as a function of the map of its points.
SHAPES = {
    "plane": lambda at: nts.RigidPlane(at(CENTRE), at(CENTRE + UPWARD) - at(CENTRE)),
    "sphere": lambda at: nts.RigidSphere(at(CENTRE + UPWARD / 10), 0.7),
    "tube": lambda at: nts.RigidCylinder(
        at(CENTRE + 0.1), at(CENTRE + ALONG) - at(CENTRE), 4.0, hollow=True
    ),
    "facet": lambda at: nts.RigidSurface(at(CORNERS), [[0, 1, 2, 3]], at(np.array([0, 0, 9.0]))),
}
shapes = pytest.mark.parametrize("name", SHAPES)
schemes = pytest.mark.parametrize("scheme", ["conserving", "midpoint", "static"])


def states(rng, m=20):
    """Positions in space, in front of the obstacles at both ends."""
    X_n = np.array([0.3, 0.2, 1.5]) + rng.uniform(-0.7, 0.7, size=(m, 3))
    return start(X_n), end(X_n + 0.1 * rng.normal(size=(m, 3))), np.zeros(m, dtype=np.int32)


def contact(name, scheme, x_n, x, segment):
    seen = FRAME.at_start(x_n), FRAME.at_end(x)
    obstacle = SHAPES[name](lambda X: X).moving(MOTION)
    return FRAME.turned(scheme, obstacle.contact(scheme, *seen, segment))


def slip(name, x_n, x, segment):
    seen = FRAME.at_start(x_n), FRAME.at_end(x)
    return FRAME.turned_slip(SHAPES[name](lambda X: X).slip(*seen, segment))


def work_on_both(force, x_n, x):
    """Work of forces on nodes and their reactions on the obstacle, by its Cayley vector."""
    cayley = 2 * np.tan(ANGLE / 2) * AXIS / np.linalg.norm(AXIS)
    arm = (x_n + x) / 2 - (CENTRE + FIRST + SHIFT / 2)
    on_node = np.einsum("mi,mi->m", force, x - x_n)
    return on_node - force @ SHIFT - np.cross(arm, force) @ cayley


@shapes
@schemes
def test_gaps_agree_with_the_obstacle_declared_where_it_is(name, scheme, rng):
    x_n, x, segment = states(rng)
    seen = contact(name, scheme, x_n, x, segment)
    for place, at, gap in ((start, x_n, seen.gap_n), (end, x, seen.gap)):
        there = SHAPES[name](place).contact("static", at, at, segment)
        np.testing.assert_allclose(gap, there.gap, atol=ROUNDING)
    # The last position is the one at the end of the step.
    np.testing.assert_allclose(seen.gradient, there.gradient, atol=ROUNDING)
    if scheme == "static":
        np.testing.assert_allclose(seen.force, there.force, atol=ROUNDING)


@shapes
def test_work_on_node_and_obstacle_is_the_change_of_the_gap(name, rng):
    x_n, x, segment = states(rng)
    seen = contact(name, "conserving", x_n, x, segment)
    work = work_on_both(seen.force, x_n, x)
    np.testing.assert_allclose(work, seen.gap - seen.gap_n, atol=ROUNDING)


@shapes
def test_work_on_the_obstacle_agrees_with_the_motion_it_imparts(name, rng):
    x_n, x, _ = states(rng)
    force = rng.normal(size=x.shape)
    seen = FRAME.at_start(x_n), FRAME.at_end(x)
    relative = np.einsum("mi,mi->m", force, FRAME.relative(*seen))
    carried = np.einsum("mi,mi->m", force, FRAME.carried(*seen))
    np.testing.assert_allclose(relative, work_on_both(force, x_n, x), atol=ROUNDING)
    np.testing.assert_allclose(
        relative + carried, np.einsum("mi,mi->m", force, x - x_n), atol=ROUNDING
    )
    np.testing.assert_allclose(FRAME.in_space(seen[1]), x, atol=ROUNDING)


@shapes
@schemes
def test_tangents_are_the_derivatives_of_the_forces(name, scheme, rng):
    x_n, x, segment = states(rng)
    d, t = 0.1 * rng.normal(size=x.shape), rng.normal(size=(len(x), 2))

    def slip_of_scheme(y):
        travel = slip(name, x_n, y, segment)
        return travel.at_end() if scheme == "static" else travel

    def force(y):
        normal = contact(name, scheme, x_n, y, segment).force
        return normal + np.einsum("mi,mij->mj", t, slip_of_scheme(y).force)

    tangent = contact(name, scheme, x_n, x, segment).tangent + slip_of_scheme(x).tangent(t)
    slope = np.einsum("mij,mj->mi", tangent, d)
    if name == "plane":
        np.testing.assert_allclose(force(x + d) - force(x), slope, atol=ROUNDING)
    else:
        assert taylor_order(force, x, d, slope) > 1.9


@shapes
def test_work_of_a_traction_is_the_slip_relative_to_the_obstacle(name, rng):
    x_n, x, segment = states(rng)
    seen = slip(name, x_n, x, segment)
    for number in range(2):
        work = work_on_both(seen.force[:, number], x_n, x)
        np.testing.assert_allclose(work, seen.value[:, number], atol=ROUNDING)
    # A node that moves with the obstacle does not slip, and its frame rotates with it.
    seen = slip(name, x_n, end(FRAME.at_start(x_n)), segment)
    np.testing.assert_allclose(seen.value, 0, atol=ROUNDING)
    turned = seen.frame_n @ rotation(AXIS, ANGLE).T
    np.testing.assert_allclose(seen.frame, turned, atol=ROUNDING)
    np.testing.assert_allclose(seen.normal, seen.normal_n @ rotation(AXIS, ANGLE).T, atol=ROUNDING)


def test_a_rotation_vector_is_the_matrix_about_its_axis():
    unit = AXIS / np.linalg.norm(AXIS)
    x = np.array([[1.0, 2.0, 3.0]])
    for angle in (0.0, 1e-9, 0.3, 3.0):
        frame = nts.Motion(rotation=lambda t, a=angle: t * a * unit, centre=CENTRE).frame(0, 1)
        turned = CENTRE + (x - CENTRE) @ rotation(AXIS, angle).T
        np.testing.assert_allclose(frame.in_space(x), turned, atol=ROUNDING)
        assert frame.angle == pytest.approx(angle, abs=1e-7)


def test_a_whole_turn_in_a_step_is_seen_at_half_of_it():
    frame = nts.Motion(rotation=lambda t: (0, 0, 2 * np.pi * t)).frame(0, 1)
    assert frame.angle == pytest.approx(2 * np.pi)


def test_the_frame_carries_points_as_far_as_they_say(rng):
    _, x, _ = states(rng)
    travel = np.linalg.norm(x - start(FRAME.at_end(x)), axis=1)
    np.testing.assert_allclose(FRAME.displacement(x), travel, atol=ROUNDING)


def test_an_obstacle_is_another_one_when_it_moves():
    plane = nts.RigidPlane((0, 0, 0), (0, 0, 2))
    moving = plane.moving(MOTION)
    assert plane.motion.is_rest and moving.motion is MOTION
    assert not nts.Motion().frame(0, 1).moves and nts.Motion().frame(0, 1).angle == 0
    assert repr(moving).startswith(f"{plane!r}.moving(Motion(translation=<lambda>, rotation=")
    with pytest.raises(AttributeError, match="expected no change of a RigidPlane after"):
        moving.motion = nts.Motion()


def test_invalid_motions_are_refused():
    with pytest.raises(TypeError, match=r"expected a Motion, .* given <function"):
        nts.RigidPlane((0, 0, 0), (0, 0, 1)).moving(lambda t: (0, 0, t))
    with pytest.raises(TypeError, match=r"expected a function of the time as translation, given"):
        nts.Motion((0, 0, 1))
    with pytest.raises(ValueError, match="three finite numbers for centre, given"):
        nts.Motion(centre=(0,))
    with pytest.raises(ValueError, match="three finite numbers for centre, given"):
        nts.RigidPlane((0, 0, 0), (0, 0, 1)).moving(nts.Motion(centre=(0, 1)))
    for value in ((0, 1), (0, 0, np.nan), 1.0):
        with pytest.raises(ValueError, match=r"three finite numbers for a translation at t = 0"):
            nts.Motion(lambda t, v=value: v).frame(0, 1)
    for value in (2 * np.eye(3), -np.eye(3), np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match=r"rotation matrix, or a rotation vector, for a rot"):
            nts.Motion(rotation=lambda t, v=value: v).frame(0, 1)
