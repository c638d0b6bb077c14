"""Obstacles of users, given by a signed distance: a torus, and a sphere against the closed form."""

import numpy as np
import pytest
from dolfinx import fem, mesh

import dolfinx_nts as nts
from dolfinx_nts.model.obstacles.distance_check import check_distance
from helpers.models.boxed import Box
from reference.bulk import taylor_order

pytestmark = pytest.mark.serial


class Torus(nts.ExactObstacle):
    """Torus of radii 1 m and 0.3 m around the axis z."""

    def distance(self, x):
        across = np.hypot(x[:, 0], x[:, 1])
        middle = x * [1, 1, 0] / across[:, None]
        away = np.linalg.norm(x - middle, axis=1)
        return away - 0.3, (x - middle) / away[:, None]


class Ball(nts.ExactObstacle):
    """Ball of radius 1 m by its distance alone."""

    def distance(self, x):
        r = np.linalg.norm(x, axis=1)
        return r - 1.0, x / r[:, None]


def test_work_of_the_force_is_the_change_of_the_gap(rng):
    x_n, d = rng.normal(size=(2, 50, 3))
    for size in (1.0, 1e-3, 1e-9):
        x = x_n + size * d
        of = Torus().contact("conserving", x_n, x, np.zeros(50, dtype=np.int32))
        work = np.einsum("mi,mi->m", of.force, x - x_n)
        np.testing.assert_allclose(work, of.gap - of.gap_n, atol=1e-14)


@pytest.mark.parametrize("scheme", ["conserving", "midpoint", "static"])
def test_tangent_is_the_derivative_of_the_force(rng, scheme):
    x_n, x, d = rng.normal(size=(3, 20, 3))
    segment = np.zeros(20, dtype=np.int32)
    slope = np.einsum("mij,mj->mi", Torus().contact(scheme, x_n, x, segment).tangent, 1e-3 * d)

    def force(y):
        return Torus().contact(scheme, x_n, y, segment).force

    assert taylor_order(force, x, 1e-3 * d, slope) > 1.9


def test_ball_by_its_distance_is_a_rigid_sphere(rng):
    x_n, x = 2 * rng.normal(size=(2, 50, 3))
    exact, ball = nts.RigidSphere((0, 0, 0), 1.0), Ball()
    outside = np.full(50, -1, dtype=np.int32)
    inside = np.linalg.norm(x_n, axis=1) < 1
    x_n[inside] *= 2 / np.linalg.norm(x_n[inside], axis=1)[:, None]
    found, expected = (each.follow(x_n, x, outside, None) for each in (ball, exact))
    np.testing.assert_array_equal(found.entered, expected.entered)
    assert (found.entered == 0).sum() > 5
    enters = found.entered == 0
    np.testing.assert_allclose(found.begin[enters], expected.begin[enters], atol=1e-6)
    np.testing.assert_allclose(found.length[enters], expected.length[enters], atol=1e-6)


def test_obstacle_of_a_user_shows_its_arguments():
    class Bowl(Ball):
        def __init__(self, radius):
            self.radius, self.shortest_passage = radius, radius / 2

    def lift(t):
        return 0.0, 0.0, t

    bowl = Bowl(2.0)
    assert repr(bowl) == "Bowl(radius=2)"
    assert repr(bowl.moving(nts.Motion(lift))).startswith("Bowl(radius=2).moving(Motion(")


def change(distance):
    """A torus whose distance and normal a function of both changes."""

    class Wrong(Torus):
        def distance(self, x):
            return distance(*super().distance(x))

    return Wrong()


@pytest.mark.parametrize(
    ("obstacle", "given"),
    [
        (change(lambda g, n: (g, -n)), "normals that are the gradient of the distance"),
        (change(lambda g, n: (2 * g, n)), "normals that are the gradient of the distance"),
        (change(lambda g, n: (g * np.abs(g), n)), "normals that are the gradient of the distance"),
        (change(lambda g, n: (g, 0 * n + [0, 0, 1])), "normals that are the gradient"),
        (change(lambda g, n: (g, 1.5 * n)), "unit normals .* given one of length 1.5"),
        (change(lambda g, n: (g * np.nan, n)), "finite distances .* given none at the 12 points"),
        (change(lambda g, _: g), r"two NumPy arrays .* given ndarray of shape \(12,\)"),
        (change(lambda g, n: (g[:, None], n)), r"given ndarray of shape \(\d+, 1\) and ndarray"),
        (change(lambda g, n: (g, n.T)), r"shape \(3, \d+\)"),
        (change(lambda g, n: (g.tolist(), n)), "given list and ndarray"),
        (change(lambda *_: None), "given NoneType"),
    ],
)
def test_wrong_distance_is_refused(rng, obstacle, given):
    with pytest.raises(ValueError, match=f"expected .*{given}"):
        check_distance(obstacle, rng.normal(size=(12, 3)), 0.1)


def test_right_distances_are_accepted(rng):
    class Paraboloid(nts.ExactObstacle):
        """z < x^2 + y^2, by f/|grad f|, which is exact to first order at the surface."""

        def distance(self, x):
            f = x[:, 2] - x[:, 0] ** 2 - x[:, 1] ** 2
            slope = np.stack([-2 * x[:, 0], -2 * x[:, 1], np.ones(len(x))], axis=1)
            size = np.linalg.norm(slope, axis=1)
            return f / size, slope / size[:, None]

    class Cube(nts.ExactObstacle):
        """Cube of 1 m, whose distance has kinks at edges and corners."""

        def distance(self, x):
            beyond = np.abs(x) - 0.5
            outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
            axis = np.eye(3)[beyond.argmax(axis=1)]
            gap = np.where(outside > 0, outside, beyond.max(axis=1))
            away = np.maximum(beyond, 0) / np.where(outside > 0, outside, 1)[:, None]
            return gap, np.sign(x) * np.where(outside[:, None] > 0, away, axis)

    for obstacle in Torus(), Ball(), Paraboloid(), Cube():
        for shift in 0.0, 1e6:
            moved = Moved(obstacle, shift)
            check_distance(moved, shift + rng.normal(size=(200, 3)), 0.1)


class Moved(nts.ExactObstacle):
    """Another obstacle, shifted along all axes."""

    def __init__(self, other, shift):
        self.other, self.shift = other, shift

    def distance(self, x):
        return self.other.distance(x - self.shift)


def test_methods_of_obstacles_that_are_missing_or_take_other_arguments_are_named():
    class NoDistance(nts.ExactObstacle):
        pass

    class NoPoints(nts.ExactObstacle):
        def distance(self):
            return 0.0

    with pytest.raises(
        TypeError, match=r"expected a method distance\(self, x\) in the class NoDis"
    ):
        NoDistance()
    with pytest.raises(TypeError, match=r"expected distance\(x\) of NoPoints, given \(\)"):
        check_distance(NoPoints(), np.zeros((1, 3)), 1.0)


def test_wrong_distance_is_refused_by_a_stepper(comm):
    box = Box(comm)
    obstacle = change(lambda g, n: (g, -n))
    pair = nts.ContactPair(box.surface("bottom 0"), Moved(obstacle, -2.0))
    stepper = nts.EnergyMomentum([box.body], [pair], dt=1e-3)
    with pytest.raises(ValueError, match="expected normals that are the gradient of the distance"):
        stepper.advance()


def test_distance_that_grows_too_fast_is_refused_if_nodes_may_pass_through():
    class Steep(Ball):
        shortest_passage = 0.5

        def distance(self, x):
            gap, normal = super().distance(x)
            return np.where(gap > 0.1, 5 * gap, gap), normal

    class WithoutFarSide(Steep):
        shortest_passage = np.inf

    x = 1.5 * np.eye(3)
    with pytest.raises(ValueError, match=r"at most the distance from the surface.* correct the"):
        check_distance(Steep(), x, 0.1)
    check_distance(WithoutFarSide(), x, 0.1)


def test_obstacle_without_any_normal_is_refused(rng):
    obstacle = change(lambda gap, normal: (gap, np.nan * normal))
    with pytest.raises(
        ValueError, match=r"unit normals near the surface .* given \(nan, nan, nan\)"
    ):
        check_distance(obstacle, rng.normal(size=(12, 3)), 0.1)


def test_property_that_hides_an_attribute_is_explained():
    with pytest.raises(AttributeError, match="or a property: write @property above def least_radi"):
        type("Blunt", (Ball,), {"least_radius": 2.0})
    with pytest.raises(AttributeError, match="expected another name for the attribute motion"):
        type("Moving", (Ball,), {"motion": lambda self: None})


@pytest.mark.parametrize(
    "name", ["key", "name", "motion", "extent", "depth", "nearest", "vertices"]
)
def test_attribute_that_hides_one_of_all_obstacles_is_refused(name):
    class Named(Ball):
        def __init__(self):
            setattr(self, name, 1.0)

    with pytest.raises(AttributeError, match=f"expected another name for the attribute {name} of"):
        Named()


@pytest.mark.parametrize(
    ("passage", "error"), [(-0.5, ValueError), (0.0, ValueError), ("half", TypeError)]
)
def test_wrong_shortest_passage_is_refused(rng, passage, error):
    obstacle = type("Thin", (Ball,), {"shortest_passage": passage})()
    with pytest.raises(error, match="shortest_passage of Thin"):
        check_distance(obstacle, rng.normal(size=(9, 3)), 0.1)


def test_misspelt_and_wrong_optional_attributes_are_refused(rng):
    x = rng.normal(size=(9, 3))
    with pytest.raises(AttributeError, match=r"expected shortest_passage .* given shortest_pasage"):
        check_distance(type("Thin", (Ball,), {"shortest_pasage": 0.1})(), x, 0.1)
    for radius, error in (("one", TypeError), (0.0, ValueError)):
        kind = type("Tip", (Ball,), {"least_radius": property(lambda self, r=radius: r)})
        with pytest.raises(error, match="least_radius of Tip"):
            check_distance(kind(), x, 0.1)


def test_dimension_of_an_obstacle_in_the_plane_is_named(comm):
    square = mesh.create_unit_square(comm, 2, 2)
    facets = mesh.locate_entities_boundary(square, 1, lambda x: np.isclose(x[1], 0.0))
    tags = mesh.meshtags(square, 1, facets, np.full(len(facets), 1, dtype=np.int32))
    bottom = nts.Surface(fem.functionspace(square, ("Lagrange", 1, (2,))), tags, 1)
    with pytest.raises(ValueError, match=r"2 dimensions, .* Ball\(\) in 3: .* class attribute dim"):
        nts.ContactPair(bottom, Ball())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("extent", 1.0),
        ("least_radius", 0.3),
        ("contact", True),
        ("name", "ball"),
        ("motion", None),
        ("slip", lambda self: 0.0),
        ("near", property(lambda self: 0.0)),
    ],
)
def test_class_attribute_that_hides_one_of_all_obstacles_is_refused(name, value):
    """Regression: they were accepted, and replaced those of the package."""
    message = f"expected another name for the attribute {name} of Named"
    with pytest.raises(AttributeError, match=message):
        type("Named", (Ball,), {name: value})


def test_attributes_of_obstacles_may_be_replaced_by_their_like():
    class Thin(Ball):
        is_of_revolution, dim, shortest_passage = True, 2, 0.1

        @property
        def least_radius(self):
            return 0.05

        def near(self, x, reach):
            return super().near(x, reach)

    assert Thin().least_radius == 0.05


def test_obstacle_with_a_distance_is_derived_from_the_exact_one():
    """Regression: it was asked for six other methods."""
    with pytest.raises(TypeError, match="expected ExactObstacle as the base class of Blob, "):

        class Blob(nts.Obstacle):
            def distance(self, x):
                return x[:, 2], np.tile([0, 0, 1], (len(x), 1))


CENTRE = np.array([0.0, 0.0, -1.0])


class InPlace(nts.ExactObstacle):
    def distance(self, x):
        x -= CENTRE
        r = np.linalg.norm(x, axis=1)
        return r - 1.0, x / r[:, None]


class InColumn(nts.ExactObstacle):
    def distance(self, x):
        x[:, 2] += 1.0
        return np.linalg.norm(x, axis=1) - 1.0, x


@pytest.mark.parametrize("kind", [InPlace, InColumn])
def test_distance_that_changes_the_positions_is_refused(rng, kind):
    """Regression: forces were those at other positions."""
    x = rng.normal(size=(12, 3))
    message = rf"expected distance\(x\) of {kind.__name__}\(\) to leave its arguments unchanged"
    for evaluate in (
        lambda: check_distance(kind(), x, 0.1),
        lambda: kind().contact("conserving", x, x + 0.1, np.zeros(12, dtype=np.int32)),
        lambda: kind().near(x, 0.1),
    ):
        with pytest.raises(ValueError, match=message):
            evaluate()
    x[:] = 0.0  # still allowed


def test_other_errors_of_a_distance_are_those_of_the_user():
    class Broken(nts.ExactObstacle):
        def distance(self, x):
            raise ValueError("no such table")

    with pytest.raises(ValueError, match=r"^no such table$"):
        Broken().near(np.zeros((1, 3)), 0.1)


class Holed(nts.ExactObstacle):
    """Plane z = 0 by a function that fails at x = 1, y = 0.8."""

    def distance(self, x):
        r = np.linalg.norm(x[:, :2] - [1.0, 0.8], axis=1)
        return np.where(r < 1e-3, np.nan, x[:, 2]), np.tile([0.0, 0.0, 1.0], (len(x), 1))


def test_node_without_a_distance_is_named(comm):
    """Regression: it was not in contact, and energies were no numbers."""
    box = Box(comm)
    pair = nts.ContactPair(box.surface("bottom 0"), Moved(Holed(), 0.0))
    stepper = nts.EnergyMomentum([box.body], [pair], dt=1e-3)
    message = r"expected a distance of each node .* Moved\(.*given nan at x = \(1, 0.8, .*\) m"
    with pytest.raises(ValueError, match=message):
        stepper.advance()


def test_diverged_positions_need_no_distance():
    x = np.array([[np.nan, 0.0, 0.0], [0.0, 3.0, 0.0]])
    assert len(Ball().near(x, 0.1)) == 0


def test_points_without_a_normal_are_allowed():
    x = np.zeros((1, 3))
    with np.errstate(invalid="ignore"):
        assert np.isnan(Ball().distance(x)[1]).all()
        assert Ball().find(x, np.full(1, -1, dtype=np.int32), 0.1, 0.1, None)[1] == [-1.0]


def test_integers_of_a_distance_become_numbers(rng):
    class Floor(nts.ExactObstacle):
        def distance(self, x):
            return x[:, 2], np.tile([0, 0, 1], (len(x), 1))

    x = rng.normal(size=(12, 3))
    check_distance(Floor(), x, 0.1)
    found = Floor().contact("static", x, x + 0.1, np.zeros(12, dtype=np.int32))
    assert found.gap.dtype == found.force.dtype == np.float64


@pytest.mark.parametrize("kind", ["float32", "complex128", "object"])
def test_distance_of_another_precision_is_refused(rng, kind):
    single = change(lambda g, n: (g.astype(kind), n))
    message = f"expected arrays of type float64 from distance.*, given {kind}"
    with pytest.raises(ValueError, match=message):
        check_distance(single, rng.normal(size=(12, 3)), 0.1)


def test_points_of_an_obstacle_in_the_plane_are_in_the_plane(rng):
    """Regression: curvatures were differences along z, too."""

    class Disc(Ball):
        dim = 2

        def distance(self, x):
            assert not x[:, 2].any()
            return super().distance(x)

    x_n, x = rng.normal(size=(2, 20, 3)) * [1, 1, 0]
    segment = np.zeros(20, dtype=np.int32)
    for scheme in ("conserving", "midpoint", "static"):
        disc, ball = (each.contact(scheme, x_n, x, segment) for each in (Disc(), Ball()))
        np.testing.assert_array_equal(disc.force, ball.force)
        np.testing.assert_allclose(disc.tangent[:, :2, :2], ball.tangent[:, :2, :2], atol=1e-12)
