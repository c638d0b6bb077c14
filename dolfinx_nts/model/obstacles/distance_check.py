"""Check of the signed distance of a user-defined obstacle."""

from typing import Any

import numpy as np

from dolfinx_nts.common.arguments import check_spelling, is_of_package, kind_of, positive
from dolfinx_nts.common.arrays import Flags, Floats
from dolfinx_nts.model.obstacles.exact_obstacle import ExactObstacle
from dolfinx_nts.model.obstacles.user_distance import signed_distance

__all__ = ["check_distance"]

# Number of points at which the distance is compared with the normal [-].
_NUM_POINTS = 12
# Shift of the test points from nodes, relative to a facet [-]: nodes are often on planes of
# symmetry, where the distance may have a kink.
_SHIFT = 0.05 * np.array([0.31, -0.47, 0.23])
# Distance from the surface at which the gradient is compared, and step of the differences, relative
# to a facet [-].
_NEAR, _STEP = 1e-4, 1e-7
# Least step relative to the positions [-], for scenes far from the origin.
_ROUNDING = 1e-12
# Admissible deviation of points from the distance `_NEAR`, relative to it [-]. Other points are
# left out.
_CLOSE = 0.1
# Deviation of the gradient from the normal above which it is wrong [-], larger than effects of
# curvature; and admissible deviation of the length of normals, larger than round-off [-].
_WRONG, _NOT_UNIT = 1e-2, 1e-6
# Excess of a distance over the distance from a point near the surface, relative to it, above which
# the distance is too large [-].
_TOO_LARGE = 1e-3
# Optional lengths of an obstacle, infinite if it has no far side or is nowhere convex.
_LENGTHS = {
    "shortest_passage": "a quarter of its least thickness",
    "least_radius": "its least radius of convex curvature",
}
# Largest number of iterations towards the surface [-]; points that do not reach it are left out.
_MOST_ITERATIONS = 50


def check_distance(obstacle: ExactObstacle, x: Floats, size: float) -> None:
    """Compare the distance with the normal by differences near the surface. Local.

    Obstacles of the package are not checked here.

    Args:
        obstacle: The obstacle.
        x: Positions of nodes in its frame, shape ``(n, 3)`` [m].
        size: Size of a facet [m].

    Raises:
        AttributeError: An attribute is an optional one of `ExactObstacle`, misspelt.
        TypeError: The method `ExactObstacle.distance` takes other arguments, or
            ``shortest_passage`` or ``least_radius`` is not a number.
        ValueError: One of these is not positive. The method changes the positions, or returns
            arrays of other shapes or types; normals are not unit vectors, or not the gradient of
            the distance at the surface; outside an obstacle with a far side, a distance is larger
            than the distance from the surface.
    """
    check_spelling(obstacle, ("shortest_passage", "least_radius", "is_of_revolution"))
    for name, meaning in _LENGTHS.items():
        if (length := getattr(obstacle, name)) != np.inf:
            positive(f"{name} of {obstacle!r}, {meaning} [m]", length)
    if len(x) == 0 or is_of_package(type(obstacle).distance):
        return
    dim = obstacle.dim
    shift = size * _SHIFT * (np.arange(3) < dim)
    some = np.unique(np.linspace(0, len(x) - 1, _NUM_POINTS, dtype=np.int32))
    x = x[some] + shift
    gap, normal = _evaluated(obstacle, x)
    if not np.isfinite(gap).any():
        raise _error(obstacle, "finite distances", f"none at the {len(x)} points near nodes", x[0])
    length = np.linalg.norm(normal, axis=1)
    if np.any(np.abs(length - 1) > _NOT_UNIT):
        i = int(np.argmax(np.abs(length - 1) > _NOT_UNIT))
        raise _error(obstacle, "unit normals", f"one of length {length[i]:.6g}", x[i])
    x = x[np.isfinite(gap)]
    start, height = x, gap[np.isfinite(gap)]
    h = max(_STEP * size, _ROUNDING * float(np.abs(x).max()))

    def differences(x: Floats) -> tuple[Any, Any]:
        """One-sided differences of the distance along the axes, both ``(m, dim)`` [-]."""
        at = _evaluated(obstacle, x)[0]
        sides = [[_evaluated(obstacle, x + s * h * e)[0] for e in np.eye(3)[:dim]] for s in (-1, 1)]
        before, after = (np.stack(side, axis=1) for side in sides)
        return (at[:, None] - before) / h, (after - at[:, None]) / h

    with np.errstate(invalid="ignore", divide="ignore"):
        for _ in range(_MOST_ITERATIONS):
            excess = _evaluated(obstacle, x)[0] - _NEAR * size
            if not np.any(np.abs(excess) > _CLOSE * _NEAR * size):
                break
            slope = np.zeros(x.shape)
            slope[:, :dim] = np.mean(differences(x), axis=0)
            square = np.einsum("mi,mi->m", slope, slope)[:, None]
            x = x - np.clip(excess[:, None] * slope / square, -size, size)
    gap, normal = _evaluated(obstacle, x)
    is_near: Flags = np.abs(gap - _NEAR * size) < _CLOSE * _NEAR * size
    if obstacle.shortest_passage < np.inf:
        _check_bound(obstacle, start[is_near], height[is_near], x[is_near], gap[is_near])
    has_normal: Flags = np.isfinite(np.linalg.norm(normal, axis=1))
    if is_near.any() and not has_normal[is_near].any():
        i = int(np.argmax(is_near))
        raise _error(obstacle, "unit normals near the surface", _text(normal[i]), x[i])
    x, normal = x[is_near & has_normal], normal[is_near & has_normal]
    least, most = np.sort(differences(x), axis=0)
    wrong = (normal[:, :dim] < least - _WRONG) | (normal[:, :dim] > most + _WRONG)
    if wrong.any():
        i = int(np.argmax(wrong.any(axis=1)))
        slope = (least[i] + most[i]) / 2
        raise _error(
            obstacle,
            "normals that are the gradient of the distance",
            f"the normal {_text(normal[i, :dim])} where differences of the distance are "
            f"{_text(slope)}",
            x[i],
        )


def _check_bound(
    obstacle: ExactObstacle, x: Floats, height: Floats, near: Floats, gap: Floats
) -> None:
    """Raise if a distance outside is larger than the distance from a point near the surface. Local.

    Otherwise the check of long steps misses nodes that pass through the obstacle.

    Args:
        obstacle: The obstacle.
        x: Points, shape ``(m, 3)`` [m].
        height: Their signed distances, shape ``(m,)`` [m].
        near: A point near the surface for each, shape ``(m, 3)`` [m].
        gap: Signed distances of these, shape ``(m,)`` [m].
    """
    bound = np.linalg.norm(x - near, axis=1) + np.abs(gap)
    excess = height - (1 + _TOO_LARGE) * bound
    if np.any(excess > 0):
        i = int(np.argmax(excess))
        raise _error(
            obstacle,
            f"distances that are at most the distance from the surface, here {bound[i]:.4g} m",
            f"{height[i]:.4g} m",
            x[i],
        )


def _evaluated(obstacle: ExactObstacle, x: Floats) -> tuple[Floats, Floats]:
    """Distance and normals, with a check of their shapes."""
    found: Any = signed_distance(obstacle, x)
    is_pair = isinstance(found, tuple | list) and len(found) == 2
    if is_pair and all(isinstance(each, np.ndarray) for each in found):
        gap, normal = found
        if gap.shape == x.shape[:1] and normal.shape == x.shape:
            return gap, normal
    raise ValueError(
        f"expected two NumPy arrays from distance(x) of {obstacle!r}, signed distances of shape "
        f"{x.shape[:1]} and outward normals of shape {x.shape}, for x of shape {x.shape}, given "
        f"{' and '.join(map(_kind, found)) if is_pair else _kind(found)}"
    )


def _kind(value: Any) -> str:
    """Class of a returned value, and shape of an array."""
    shape = f" of shape {value.shape}" if isinstance(value, np.ndarray) else ""
    return f"{kind_of(value)}{shape}"


def _error(obstacle: ExactObstacle, expected: str, given: str, x: Floats) -> ValueError:
    return ValueError(
        f"expected {expected} from distance(x) of {obstacle!r}, given {given} at x = {_text(x)} m, "
        "in the frame of the obstacle: correct the method distance"
    )


def _text(vector: Floats) -> str:
    return f"({', '.join(f'{value:.4g}' for value in vector + 0.0)})"
