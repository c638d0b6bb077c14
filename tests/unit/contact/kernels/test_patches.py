"""Smooth segments: kernels of cubic patches and of facets of degree 2.

``geometry/patch*.h``, ``geometry/facet.h`` and ``patch_gradient.h``.
"""

import basix
import numpy as np
import pytest

from dolfinx_nts import _kernels
from dolfinx_nts.fem.elements import Element
from reference.bulk import rotation

pytestmark = pytest.mark.serial

SCHEMES = ("conserving", "midpoint", "static")
STEP = 1e-6
# Places of the control points on the reference cell, in the order of the kernels.
PLACES = {
    "edge": [(i / 3, 0.0) for i in range(4)],
    "triangle": [(i / 3, j / 3) for j in range(4) for i in range(4 - j)],
    "quadrilateral": [(i / 3, j / 3) for j in range(4) for i in range(4)],
    "edge of degree 2": [(0.0, 0.0), (1.0, 0.0), (0.5, 0.0)],
    "triangle of degree 2": Element("triangle", 2).points,
    "quadrilateral of degree 2": Element("quadrilateral", 2).points,
}
patches = pytest.mark.parametrize("kind", PLACES)


def point(kind, x, xi):
    """Point of a patch by de Casteljau's algorithm, or of a facet by Basix, shape ``(3,)``."""
    u, v = xi
    if kind.endswith("of degree 2"):
        cell = basix.CellType["interval" if kind.startswith("edge") else kind.split()[0]]
        element = basix.create_element(basix.ElementFamily.P, cell, 2)
        return element.tabulate(0, np.array([xi[: len(basix.topology(cell)) - 1]]))[0, 0, :, 0] @ x
    if kind == "triangle":
        net = dict(zip([(i, j) for j in range(4) for i in range(4 - j)], x, strict=True))
        for degree in (2, 1, 0):
            net = {
                (i, j): (1 - u - v) * net[i, j] + u * net[i + 1, j] + v * net[i, j + 1]
                for j in range(degree + 1)
                for i in range(degree + 1 - j)
            }
        return net[0, 0]
    rows = x.reshape(-1, 4, 3)
    for t, axis in ((u, 1), (v, 0)):
        while rows.shape[axis] > 1:
            first, second = (
                np.take(rows, range(s, rows.shape[axis] - 1 + s), axis) for s in (0, 1)
            )
            rows = (1 - t) * first + t * second
    return rows[0, 0]


def states(kind, seed, m=12, change=0.1):
    """Pairs at both ends of steps, ``(2, m, 1 + c, 3)``, of curved patches, and orientations."""
    rng = np.random.default_rng([seed, len(kind)])
    in_plane = kind.startswith("edge")
    places = np.array(PLACES[kind])
    centre = places.mean(axis=0)
    x = np.zeros((m, 1 + len(places), 3))
    curved = 0.3 * ((places - centre) ** 2).sum(axis=1)
    x[:, 1:, 0], x[:, 1:, 1 if in_plane else 2] = places[:, 0], curved
    if not in_plane:
        x[:, 1:, 1] = places[:, 1]
    x[:, 0] = x[:, 1:].mean(axis=1)
    x += rng.uniform(-0.05, 0.05, x.shape)
    x_n = x + rng.uniform(-change, change, x.shape)
    if in_plane:
        x[..., 2] = x_n[..., 2] = 0.0
    return x_n, x, rng.choice([-1.0, 1.0], m)


def work(force, x_n, x):
    return np.einsum("md,md->m", force, (x - x_n).reshape(len(x), -1))


@patches
def test_projection_is_where_the_surface_is_across_to_the_node(kind):
    _, x, orientation = states(kind, 1)
    xi, gap, normal, status = _kernels.patch_project(x, orientation)
    assert not status.any()
    directions = np.eye(2)[: 1 if kind.startswith("edge") else 2]
    for pair, place, g, n in zip(x, xi, gap, normal, strict=True):
        assert np.abs(pair[0] - point(kind, pair[1:], place) - g * n).max() < 1e-13
        for d in STEP * directions:
            ends = (point(kind, pair[1:], place + s * d) for s in (1, -1))
            assert abs((next(ends) - next(ends)) @ n) / (2 * STEP) < 1e-9


@patches
@pytest.mark.parametrize("scheme", SCHEMES)
def test_pairs_far_from_the_origin_have_the_results_of_near_ones(kind, scheme):
    x_n, x, orientation = states(kind, 6, m=40)
    place = 1e4 * np.array([1, -2, 0 if kind.startswith("edge") else 3])
    far = x_n + place, x + place
    near = far[0] - place, far[1] - place  # exact: both have the same digits
    kernel = getattr(_kernels, f"patch_{scheme}")
    for found, expected in zip(kernel(*far, orientation), kernel(*near, orientation), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@patches
@pytest.mark.parametrize("scheme", SCHEMES)
def test_gradient_and_tangent_are_derivatives(kind, scheme):
    x_n, x, orientation = states(kind, 2)
    kernel = getattr(_kernels, f"patch_{scheme}")
    *_, gradient, tangent, _ = kernel(x_n, x, orientation)
    in_plane = np.arange(gradient.shape[1]) % 3 < (2 if kind.startswith("edge") else 3)
    for column in np.flatnonzero(in_plane):
        node, axis = divmod(column, 3)
        moved = [x.copy(), x.copy()]
        moved[0][:, node, axis] -= STEP
        moved[1][:, node, axis] += STEP
        less, more = (kernel(x_n, y, orientation) for y in moved)
        slope = (more[2] - less[2]) / (2 * STEP)
        assert np.abs((slope - tangent[:, :, column])[:, in_plane]).max() < 1e-7
        slope = (more[1] - less[1]) / (2 * STEP)
        assert np.abs(slope - gradient[:, column]).max() < 1e-8


@patches
def test_conserving_force_does_the_work_of_the_gap_and_changes_no_momentum(kind):
    x_n, x, orientation = states(kind, 3, m=40)
    turn = rotation([0, 0, 1] if kind.startswith("edge") else [1, 2, 3], 0.7)
    x = x @ turn.T + [0.3, -0.2, 0.0]
    gap_n, gap, force, *_ = _kernels.patch_conserving(x_n, x, orientation)
    assert np.abs(work(force, x_n, x) - (gap - gap_n)).max() < 1e-13
    forces = force.reshape(x.shape)
    assert np.abs(forces.sum(axis=1)).max() < 1e-13
    assert np.abs(np.cross((x_n + x) / 2, forces).sum(axis=1)).max() < 1e-13
    # The midpoint rule does not: this guards the test.
    force = _kernels.patch_midpoint(x_n, x, orientation)[2]
    assert np.abs(work(force, x_n, x) - (gap - gap_n)).max() > 1e-5


@patches
def test_conserving_force_is_continuous_where_a_rigid_motion_is_disturbed(kind):
    x_n, disturbance, orientation = states(kind, 4)
    turn = rotation([0, 0, 1] if kind.startswith("edge") else [3, 1, 2], 0.8)
    rigid = x_n @ turn.T
    exact = _kernels.patch_conserving(x_n, rigid, orientation)[2]
    assert np.abs(work(exact, x_n, rigid)).max() < 1e-13
    for size in (1e-3, 1e-6, 1e-9):
        x = rigid + size * disturbance
        force = _kernels.patch_conserving(x_n, x, orientation)[2]
        assert np.abs(force - exact).max() < 20 * size


@pytest.mark.parametrize("kind", ["edge", "triangle"])
def test_force_of_a_flat_patch_agrees_with_the_flat_segment(kind):
    x_n, x, orientation = states(kind, 5)
    places = np.array(PLACES[kind])
    corners = [0, 3] if kind.startswith("edge") else [0, 3, 9]
    shares = np.column_stack([1 - places.sum(axis=1), places])[:, : len(corners)]
    pairs = [y[:, [0, *(1 + c for c in corners)]] for y in (x_n, x)]
    for y in (x_n, x):
        y[:, 1:] = shares @ y[:, [1 + c for c in corners]]
    for scheme in SCHEMES:
        flat = getattr(_kernels, f"contact_{scheme}")(*pairs, orientation)[2]
        force = getattr(_kernels, f"patch_{scheme}")(x_n, x, orientation)[2].reshape(x.shape)
        force = np.concatenate([force[:, :1], shares.T @ force[:, 1:]], axis=1)
        assert np.abs(force.reshape(flat.shape) - flat).max() < 1e-12


@patches
def test_slip_does_the_work_of_its_force_without_momenta_and_ignores_rigid_motion(kind):
    x_n, x, orientation = states(kind, 6)
    value, force, *_ = _kernels.patch_slip(x_n, x, orientation)
    for i in range(1 if kind.startswith("edge") else 2):
        assert np.abs(work(force[:, i], x_n, x) - value[:, i]).max() < 1e-13
        forces = force[:, i].reshape(x.shape)
        assert np.abs(forces.sum(axis=1)).max() < 1e-13
        assert np.abs(np.cross((x_n + x) / 2, forces).sum(axis=1)).max() < 1e-13
    turn = rotation([0, 0, 1] if kind.startswith("edge") else [3, 1, 2], 1.1)
    value = _kernels.patch_slip(x_n, x_n @ turn.T, orientation)[0]
    assert np.abs(value).max() < 1e-13
