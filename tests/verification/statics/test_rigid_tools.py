"""Rigid tools pressed into a body in space: flat punch, cone and sphere, by force or displacement.

With 1/E* = (1 - nu^2)/E, see K. L. Johnson, Contact Mechanics, chapters 3 to 5 (Boussinesq,
Sneddon, Hertz), as `test_axisymmetric_closed_forms`. The body is half a ball of 3200 radii of
contact, of which a quarter is meshed, with cells that grow: one of 400 radii has forces that are
0.2 % larger.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

from helpers.models.rigid_tools import press

pytestmark = pytest.mark.serial

E, NU, FAR = 1.0, 0.3, 3200.0  # Pa, -, m
E_STAR = E / (1 - NU**2)
# Towards the edge of the punch, where the pressure has no bound, and around contact.
AT_EDGE = "0.05 + 0.4 * Sqrt((Sqrt(x*x + y*y) - 1)^2 + z*z)"
AROUND = "0.12 + 0.5 * Max(0, Sqrt(x*x + y*y + z*z) - 1.2)"
STEEP, R = np.radians(0.5), 100.0  # of the cone [rad], of the sphere [m]


class Tool(NamedTuple):
    """A tool that touches a body to a radius of 1 m.

    Attributes:
        profile: Height over the radius [m].
        depth: How far it moves [m].
        force: On it, by the closed form [N].
        moment: Of its pressure, sum p r^2/F a^2 [-].
        size: Size of cells as a formula of gmsh [m].
        scales: By what cells are multiplied in the coarser and in the finer mesh.
        edge: Radius up to which nodes may touch [m].
        rings: Rings of facets.
    """

    profile: Callable[[float], float]
    depth: float
    force: float
    moment: float
    size: str
    scales: tuple[float, float]
    edge: float = 1.3
    rings: int = 1


CONE_DEPTH = np.pi / 2 * np.tan(STEEP)
TOOLS = {
    # F = 2 a E* d.
    "flat punch": Tool(lambda r: 0.0, 1e-3, 2e-3 * E_STAR, 2 / 3, AT_EDGE, (1.0, 0.6), 1.0),
    # F = 2/pi E* d^2/tan, a = 2/pi d/tan.
    "cone": Tool(
        *(lambda r: r * np.tan(STEEP), CONE_DEPTH),
        *(2 / np.pi * E_STAR * CONE_DEPTH**2 / np.tan(STEEP), 1 / 3, AROUND, (1.0, 0.8)),
    ),
    # F = 4/3 E* sqrt(R) d^(3/2), a = sqrt(R d).
    "sphere": Tool(
        *(lambda r: R - np.sqrt(R**2 - r**2), 1 / R),
        *(4 / 3 * E_STAR * R**0.5 * R**-1.5, 2 / 5, AROUND, (1.25, 1.0)),
        rings=16,
    ),
}


@cache
def prescribed(name: str, scale: float) -> tuple[float, float]:
    """Force on a moving tool [N], and radius of contact by the moment of its pressure [m]."""
    tool = TOOLS[name]
    size = f"{scale} * ({tool.size})"
    _, force, r, p = press(tool.profile, size, depth=tool.depth, **scene(tool))
    return force, float(np.sqrt(p @ r**2 / (tool.moment * p.sum())))


def scene(tool: Tool) -> dict[str, Any]:
    """Arguments of `press` that all runs of a tool share."""
    return {"E": E, "nu": NU, "far": FAR, "edge": tool.edge, "rings": tool.rings}


@pytest.mark.parametrize("name", TOOLS)
def test_tool_in_space_has_the_force_of_the_closed_form(name, table_row):
    tool = TOOLS[name]
    results = [prescribed(name, scale) for scale in tool.scales]
    errors = [force / tool.force - 1 for force, _ in results]
    radii = [radius - 1 for _, radius in results]
    table_row(
        f"{name} pressed into a body in space, degree 2, two meshes",
        "Boussinesq, Sneddon, Hertz: force, radius by the moment of the pressure",
        f"force {changes(errors)}, radius {changes(radii)}",
    )
    assert abs(errors[1]) < abs(errors[0]) and abs(errors[1]) <= 0.01
    assert abs(radii[1]) <= 0.01


@pytest.mark.parametrize("name", TOOLS)
def test_tool_under_the_force_of_a_prescribed_motion_makes_this_motion(name, table_row):
    tool = TOOLS[name]
    force, _ = prescribed(name, 1.0)
    depth, *_ = press(tool.profile, tool.size, force=force, **scene(tool))
    error = abs(depth / tool.depth - 1)
    table_row(
        f"{name} in space under the force that its guide had: depth",
        "depth of the guide",
        f"the same within {max(error, 1e-8):.0e}",
    )
    assert error <= 1e-8


def changes(errors: list[float]) -> str:
    """Errors in per cent."""
    return ", ".join(f"{100 * error:+.2f}" for error in errors) + " %"
