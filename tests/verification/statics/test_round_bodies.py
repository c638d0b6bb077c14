"""Effect of facets of round bodies on motion: a rolling disc, and two colliding discs.

A polygon that rolls falls onto each of its sides, so that its speed ripples. It turns what meets
it aside where a side is not normal to the line of the centres. On a smooth surface both depend on
the distance of the nodes only.
"""

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers.laws import NODAL
from helpers.models.plane import block
from helpers.models.round import plane_mesh, ring, tagged

pytest.importorskip("gmsh")
pytestmark = pytest.mark.serial

SPEED, GRAVITY = 2.0, 10.0  # m/s, m/s^2
STEEL = nts.NeoHookean(1e7, 0.3, 1e3)  # Waves take 0.02 s through a disc.


def rolling(cells: int, *, by_disc: bool = False, smooth: bool = False) -> np.ndarray:
    """Speeds of a disc of a number of facets that rolls over a rigid plate.

    The plate gives the nodes, eight on the length of a facet; or the disc does, on a plane.
    """
    length = 2 * np.pi / cells
    plate = block((-0.5, -0.1), (3.2, 0.1), (round(8 * 3.2 / length), 1))
    domain = plane_mesh(MPI.COMM_SELF, ring((0.0, 1.0), 1.0, cells), plate)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    tags = tagged(domain, lambda x: x[:, 1] < 0)
    disc, floor = nts.Body(V, tags, 1, STEEL), nts.RigidBody(V, tags, 2, 1e3, guide=nts.Guide())
    rim = nts.boundary_of(disc, where=lambda x: np.hypot(x[0], x[1] - 1) > 0.99, smooth=smooth)
    # Softer springs smooth the facets.
    laws: Any = {"enforcement": nts.Penalty(1.08e7), "friction": nts.Coulomb(0.5)}
    if by_disc:
        pair = nts.ContactPair(rim, nts.RigidPlane((0, 0), (0, 1)), **(NODAL | laws))
    else:
        top = nts.boundary_of(floor, where=lambda x: x[1] > -1e-9)
        pair = nts.ContactPair(top, rim, **(NODAL | laws))

    return speeds_of(disc, [disc, floor], pair, rise=0.2, dt=0.01)


def rolling_in_space(*, by_ball: bool = False, smooth: bool = False) -> np.ndarray:
    """Speeds of a rigid ball of 16 facets around, as of `rolling`."""
    length = 2 * np.pi / 16

    def scene(model: Any) -> None:
        ball = {"inner_radius": 0.6, "outer_radius": 1.0, "cells_per_edge": 4, "layers": 1}
        parts.add_hollow_ball(model, "ball", centre=(0, 0, 1), **ball)
        size = (3.0, 0.4, 0.1)
        cells = (round(8 * size[0] / length), round(8 * size[1] / length), 1)
        parts.add_box(model, "plate", corner=(-0.5, -0.2, -0.1), size=size, cells=cells)

    domain, cells, facets, tag = nts.read_mesh(scene, MPI.COMM_SELF)
    V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    ball = nts.RigidBody(V, cells, tag["ball"], 1e3)
    floor = nts.RigidBody(V, cells, tag["plate"], 1e3, guide=nts.Guide())
    outer = nts.Surface(V, facets, tag["ball_outer"], smooth=smooth)
    laws: Any = {"enforcement": nts.Penalty(1e6), "friction": nts.Coulomb(0.5)}
    if by_ball:
        pair = nts.ContactPair(outer, nts.RigidPlane((0, 0, 0), (0, 0, 1)), **(NODAL | laws))
    else:
        pair = nts.ContactPair(nts.Surface(V, facets, tag["plate_top"]), outer, **(NODAL | laws))
    return speeds_of(ball, [ball, floor], pair, rise=0.4, dt=0.02)


def speeds_of(
    body: nts.Body, bodies: list[nts.Body], pair: nts.ContactPair, *, rise: float, dt: float
) -> np.ndarray:
    """Speeds of a body of radius 1 m that rolls from 0.1 s after gravity has risen until 1 s."""
    dim = body.V.mesh.geometry.dim
    up = np.eye(dim)[-1]

    def gravity(t: float) -> np.ndarray:
        s = min(t / rise, 1.0)
        return -GRAVITY * s * s * (3 - 2 * s) * up

    def velocity(x: np.ndarray) -> np.ndarray:
        v = np.zeros((dim, x.shape[1]))
        v[0], v[-1] = SPEED * x[dim - 1], -SPEED * x[0]
        return v

    stepper = nts.EnergyMomentum(bodies, [pair], dt=dt, loads=[nts.Gravity([body], gravity)])
    stepper.set_velocity(body, velocity)
    diagnostics, speeds = nts.Diagnostics(stepper), []
    for step in stepper.run(until=1.0):
        if step.t > rise + 0.1:
            speeds.append(diagnostics.body_velocity(body)[0])
    return np.array(speeds)


def ripple(speeds: np.ndarray) -> float:
    """Rms difference from a uniform acceleration, relative to the mean [%]."""
    t = np.arange(len(speeds))
    rest = speeds - np.polyval(np.polyfit(t, speeds, 1), t)
    return float(100 * rest.std() / speeds.mean())


def test_a_disc_with_smooth_segments_rolls_as_a_disc(table_row):
    polygon = ripple(rolling(32, by_disc=True))
    flat, smooth = (ripple(rolling(32, smooth=smooth)) for smooth in (False, True))
    table_row(
        "ripple of the speed of a disc of 32 facets that rolls, rms",
        "constant",
        f"{polygon:.1f} % with its nodes on a plane; as segments against fine nodes {flat:.1f} %, "
        f"with `smooth=True` {smooth:.2f} %",
    )
    assert smooth < min(polygon, flat) / 10
    assert smooth < 0.1


def test_a_rigid_ball_with_smooth_segments_rolls_as_a_ball(table_row):
    polyhedron = ripple(rolling_in_space(by_ball=True))
    flat, smooth = (ripple(rolling_in_space(smooth=smooth)) for smooth in (False, True))
    table_row(
        "ripple of the speed of a rigid ball of 16 facets around that rolls, rms",
        "constant",
        f"{polyhedron:.1f} % with its nodes on a plane; as segments against fine nodes "
        f"{flat:.1f} %, with `smooth=True` {smooth:.2f} %",
    )
    assert smooth < min(polyhedron, flat) / 10


def turned_aside(upper_cells: int, *, smooth: bool = False, **laws: Any) -> float:
    """Largest lateral speed after a central collision of discs at 1 m/s, over rotations of both."""
    speeds = []
    for lower_phase, upper_phase in ((0.0, 0.3), (0.25, 0.3), (0.25, 0.6)):
        two = ring((0, 0), 1.0, 16, lower_phase), ring((0, 2.005), 1.0, upper_cells, upper_phase)
        domain = plane_mesh(MPI.COMM_SELF, *two)
        V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
        tags = tagged(domain, lambda x: x[:, 1] > 1)
        lower, upper = (nts.Body(V, tags, tag, STEEL) for tag in (1, 2))
        segments = nts.boundary_of(lower, smooth=smooth)
        pair = nts.ContactPair(nts.boundary_of(upper), segments, **(NODAL | laws))
        stepper = nts.EnergyMomentum([lower, upper], [pair], dt=0.005)
        stepper.set_velocity(upper, (0.0, -1.0))
        for _ in stepper.run(until=0.2):
            pass
        aside, ahead = nts.Diagnostics(stepper).body_velocity(lower)
        assert ahead < -0.5
        speeds.append(abs(aside))
    return float(max(speeds))


def test_balls_of_few_facets_collide_centrally_on_a_smooth_one_with_fine_nodes(table_row):
    springs = {"enforcement": nts.Penalty()}
    coarse, coarse_smooth, fine, fine_smooth = (
        turned_aside(cells, smooth=smooth, **springs)
        for cells in (16, 64)
        for smooth in (False, True)
    )
    table_row(
        "discs of 16 facets collide centrally with 1 m/s: speed to the side",
        "0",
        f"{100 * coarse:.0f} % of the speed, with `smooth=True` {100 * coarse_smooth:.0f} %; "
        f"with 64 nodes on the other disc {100 * fine:.0f} %, and both {100 * fine_smooth:.1f} %",
    )
    assert fine_smooth < 0.03 < 0.06 < fine
