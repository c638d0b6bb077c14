"""The scenes, and the accuracy that users need in each."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

from benchmarks.defaults import impacts, statics
from benchmarks.defaults.settings import Setting
from benchmarks.scenes import Scene

__all__ = ["SCENES", "Kind"]


class Kind(NamedTuple):
    """A scene, its kind of contact and its reference.

    Attributes:
        build: Makes the scene with a setting.
        contact: Kind of contact: "surfaces", "obstacle", "self", "edges", "rigid body".
        reference: What results are compared with.
        tolerances: Errors below which two results count as equally right [-], by quantity.
        conserves: Whether no force but contact acts, so that the energy is constant.
        is_dynamic: Whether there is inertia.
    """

    build: Callable[[Setting], Scene]
    contact: str
    reference: str
    tolerances: Mapping[str, float]
    conserves: bool = True
    is_dynamic: bool = True


# Limit of fine meshes, extrapolated to second order from 12 and 18 cells an edge with steps of 5
# and 3.5 ms [-, N], 0.9921 and 0.9931, 4919 and 4923: `python3 -m benchmarks.defaults --reference`.
REBOUND, PEAK = 0.994, 4926.0
_PLATEAU = {"force on the plateau": 0.05}
_HERTZ = "Hertz (Johnson, chapter 4)"
_IMPACT = "Hertz (Johnson, chapter 11)"
_LOADED = {"conserves": False}
_STATIC = {"conserves": False, "is_dynamic": False}


def _ball(setting: Setting) -> Scene:
    """Errors of the ball on the block."""
    scene = impacts.ball_on_block(setting)

    def judge() -> dict[str, float]:
        values = scene.judge()
        values["rebound"] = abs(values["rebound"] - REBOUND)
        values["peak force"] = abs(values["peak force"] / PEAK - 1)
        return values

    return Scene(scene.stepper, scene.body, judge, scene.record, scene.t_end)


def _pressure(tolerance: float) -> dict[str, float]:
    return {"pressure": tolerance}


SCENES = {
    "ball on a held block": Kind(
        *(_ball, "surfaces", "fine mesh"),
        {
            "rebound": 0.006,
            "sideways": 0.003,
            "roughness of the pressure": 0.05,
            "peak force": 0.02,
        },
    ),
    "rods 1:2, half a cell a step": Kind(
        partial(impacts.rods, num_cells=40, courant=0.5),
        *("surfaces", "St. Venant: force rho c v A/2, restitution 1/2"),
        {**_PLATEAU, "restitution": 0.016},
    ),
    "rods 1:2, a quarter": Kind(
        partial(impacts.rods, num_cells=20, courant=0.25),
        *("surfaces", "St. Venant: force rho c v A/2, restitution 1/2"),
        {"force on the plateau": 0.08, "restitution": 0.032},
    ),
    "rod on a wall": Kind(
        impacts.rod_on_wall, "obstacle", "rho c v A, rebound 1", {**_PLATEAU, "rebound": 0.01}
    ),
    "rigid mass on a rod": Kind(
        impacts.mass_on_rod,
        *("rigid body", "St. Venant: rho c v A exp(-c t/L)"),
        {"force": 0.05, "velocity": 0.01},
    ),
    "balls of revolution": Kind(
        partial(impacts.balls_of_revolution, plane=False),
        *("surfaces", _IMPACT),
        {"largest force": 0.02, "impulse": 0.02, "alternation of the force": 0.02},
    ),
    "ball of revolution on a plane": Kind(
        partial(impacts.balls_of_revolution, plane=True),
        *("obstacle", _IMPACT),
        {"largest force": 0.02, "impulse": 0.02, "alternation of the force": 0.02},
    ),
    "cubes that cross edges": Kind(impacts.cubes, "edges", "no overlap", {"overlap": 0.03}),
    "pile of balls": Kind(
        *(impacts.pile, "surfaces", "no overlap, no momentum aside"),
        {"overlap": 0.02, "momentum aside": 1e-3},
        **_LOADED,
    ),
    "line contact": Kind(
        *(partial(statics.line_contact, degree=1), "surfaces", _HERTZ), _pressure(0.02), **_STATIC
    ),
    "line contact, degree 2": Kind(
        *(partial(statics.line_contact, degree=2), "surfaces", _HERTZ), _pressure(0.02), **_STATIC
    ),
    "point contact, tetrahedra": Kind(
        partial(statics.paraboloid, cell="tetrahedron", degree=1, n=8),
        *("surfaces", _HERTZ),
        _pressure(0.05),
        **_STATIC,
    ),
    "point contact, tetrahedra of degree 2": Kind(
        partial(statics.paraboloid, cell="tetrahedron", degree=2, n=6),
        *("surfaces", _HERTZ),
        _pressure(0.05),
        **_STATIC,
    ),
    "sphere pressed in a cylinder": Kind(
        statics.sphere_in_block, "obstacle", _HERTZ, _pressure(0.03), **_STATIC
    ),
    "blocks of one surface": Kind(
        *(statics.surface_of_both, "self", "uniform stress"), {"strain energy": 0.005}, **_STATIC
    ),
    "shrink fit": Kind(
        *(statics.shrink_fit, "surfaces", "Lamé"),
        {"mean pressure": 0.02, "pressure": 0.05},
        **_STATIC,
    ),
    "dragged block": Kind(
        statics.dragged_block, "surfaces", "T = mu N", {"T / mu N": 0.02}, **_STATIC
    ),
    "block in a gripper": Kind(
        *(statics.held_block, "surfaces", "weight, no slip"),
        {"friction over weight": 1e-3, "slip": 0.01},
        **_STATIC,
    ),
    "stack at rest": Kind(
        *(statics.stack, "surfaces", "weights"),
        {"contact force": 0.01, "mean of the contact force": 1e-3},
        **_LOADED,
    ),
    "block that friction stops": Kind(
        statics.braking_block, "obstacle", "v^2/(2 mu g)", {"way": 0.005}, **_LOADED
    ),
}
