"""Machine elements in statics: a belt on a pulley, a press fit, a wedge between two blocks.

Formulas: any textbook on machine elements. Forces are reactions of supports, so that neither the
contact law nor the diagnostics of contact judge themselves.
"""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.compat import geometry_nodes
from helpers.models.belt import ANGLE, MU, PULL, RADIUS, THICKNESS, belt

pytestmark = pytest.mark.serial

# Of the ratio of forces in a belt, of the mean pressure of a press fit, of the force on a wedge.
BELT_TOLERANCE, FIT_TOLERANCE, WEDGE_TOLERANCE = 2e-3, 2e-3, 3e-4
# Balance of supports and contact, relative to the force.
ROUND_OFF = 1e-9


def held(V, data, side, axis=None):
    """Condition that fixes a side in all directions, or in one direction."""
    space = V if axis is None else V.sub(axis)
    dofs = fem.locate_dofs_topological(space, 1, data.facets.find(data.tag[side]))
    return fem.dirichletbc(np.zeros(2) if axis is None else np.float64(0), dofs, space)


def displaced(V, data, side, motion):
    """Condition that moves a side by a function of time, and the update of a stepper."""
    dofs = fem.locate_dofs_topological(V, 1, data.facets.find(data.tag[side]))
    value = fem.Function(V)

    def update(t):
        value.x.array.reshape(-1, 2)[dofs] = motion(t)

    return fem.dirichletbc(value, dofs), update


def test_belt_on_a_pulley_obeys_the_capstan_equation(table_row):
    """T1/T2 = exp(mu phi R/(R + h/2)): friction acts at R, the belt pulls at R + h/2."""
    scene = belt(dt=0.1)
    # Nodes change one after the other, where the belt is laid on and as slip spreads from the
    # drawn end, and no step fails by that.
    for step in scene.stepper.run(until=1.35):
        (reaction,) = step.reactions
    history = scene.pair.history
    assert history.sliding[history.active].all()
    force = np.array(reaction.force)
    assert force + nts.Diagnostics(scene.stepper).contact_force() == pytest.approx(
        [0, PULL], abs=ROUND_OFF * PULL
    )
    error = force[0] / PULL / np.exp(MU * ANGLE * RADIUS / (RADIUS + THICKNESS / 2)) - 1
    table_row(
        "belt on a pulley, a quarter turn, 20 cells on it, mu = 0.3",
        "capstan equation: exp(μφR/(R + h/2)), the ratio of the forces",
        f"{100 * error:+.2f} %",
    )
    assert abs(error) < BELT_TOLERANCE


def test_belt_is_laid_on_and_drawn_over_twice_the_distance_in_a_step(caplog):
    """On its curved part, tangential motion leaves gaps unrelated to the pressure."""
    scene = belt(dt=0.2)
    for step in scene.stepper.run(until=1.4):
        assert step.newton_iterations < 50  # from the first start
    assert not [text for text in caplog.messages if "no equilibrium near" in text]


def test_press_fit_has_the_pressure_of_lame(table_row):
    """A tube that is 5 um too wide for the hub in which it sits, in plane strain, as rings."""
    E, nu, inner, joint, outer, over, height = 200e9, 0.3, 0.02, 0.05, 0.10, 5e-6, 0.02

    def build(model):
        size = (joint + over - inner, height)
        parts.add_rectangle(model, "tube", corner=(inner, 0), size=size, cells=(8, 4))
        size = (outer - joint, height)
        parts.add_rectangle(model, "hub", corner=(joint, 0), size=size, cells=(12, 5))

    data = nts.read_mesh(build, MPI.COMM_WORLD)
    nts.axisymmetric(data.mesh)
    V = fem.functionspace(data.mesh, ("Lagrange", 1, (2,)))
    steel = nts.NeoHookean(E=E, nu=nu, rho=7800)
    bodies = [nts.Body(V, data.cells, data.tag[name], steel) for name in ("tube", "hub")]
    bore, seat = (nts.Surface(V, data.facets, data.tag[s]) for s in ("hub_left", "tube_right"))
    pair = nts.ContactPair(
        bore, seat, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    ends = [held(V, data, f"{b}_{end}", 1) for b in ("tube", "hub") for end in ("bottom", "top")]
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=ends)
    assert len(nts.Diagnostics(stepper).overlaps()) == 1
    stepper.advance()
    assert nts.Diagnostics(stepper).overlaps() == []
    wider = ((1 - 2 * nu) * joint**2 + outer**2) / (outer**2 - joint**2)
    narrower = ((1 - 2 * nu) * joint**2 + inner**2) / (joint**2 - inner**2)
    expected = over / (joint * (1 + nu) / E * (wider + narrower))
    pressure = np.average(pair.pressure, weights=bore.area)
    table_row(
        "press fit of two tubes, meshes that do not match",
        "Lame: pressure, mean of the nodes",
        f"{100 * (pressure / expected - 1):+.2f} %",
    )
    assert pressure == pytest.approx(expected, rel=FIT_TOLERANCE)


def test_wedge_needs_the_force_of_its_angle_and_friction(table_row):
    """2 H tan(alpha + arctan mu), with the horizontal force H on each block."""
    angle, mu = np.radians(10), 0.2

    def build(model):
        for name, corner in (("left", (-1.2, 0)), ("right", (0.2, 0))):
            parts.add_rectangle(model, name, corner=corner, size=(1, 1), cells=(8, 8))
        parts.add_rectangle(model, "wedge", corner=(-0.5, 0.35), size=(1, 1.4), cells=(6, 14))

    data = nts.read_mesh(build, MPI.COMM_WORLD)
    x, cells = data.mesh.geometry.x, data.cells.find(data.tag["wedge"])
    nodes = np.unique(geometry_nodes(data.mesh)[cells])
    x[nodes, 0] *= 2 * (0.2 + (x[nodes, 1] - 1) * np.tan(angle))
    V = fem.functionspace(data.mesh, ("Lagrange", 1, (2,)))
    rubber, steel = nts.NeoHookean(1e6, 0.3, 1e3), nts.NeoHookean(1e9, 0.3, 1e3)
    materials = {"left": rubber, "right": rubber, "wedge": steel}
    bodies = [nts.Body(V, data.cells, data.tag[n], m) for n, m in materials.items()]
    walls = [
        nts.boundary_of(body, where=lambda x, at=at: np.isclose(x[0], at) | np.isclose(x[1], 1))
        for body, at in zip(bodies, (-0.2, 0.2), strict=False)
    ]
    pairs = [
        nts.ContactPair(
            wall,
            nts.Surface(V, data.facets, data.tag[f"wedge_{side}"]),
            friction=nts.Coulomb(mu),
            method="mortar",
            enforcement=nts.LagrangeMultiplier(),
        )
        for wall, side in zip(walls, ("left", "right"), strict=True)
    ]
    driven, update = displaced(V, data, "wedge_top", lambda t: (0, -0.5 * t))
    bcs = [driven, held(V, data, "left_left"), held(V, data, "right_right")]
    stepper = nts.QuasiStatic(bodies, pairs, dt=0.1, bcs=bcs, update=update)
    errors = []
    for step in stepper.run(until=0.8):
        on_wedge, on_left, on_right = (np.array(r.force) for r in step.reactions)
        assert on_wedge + on_left + on_right == pytest.approx(0, abs=ROUND_OFF * on_left[0])
        errors.append(-on_wedge[1] / (2 * on_left[0] * np.tan(angle + np.arctan(mu))) - 1)
    largest = max(map(abs, errors[3:]))
    table_row(
        "wedge of 10 degrees between two blocks of rubber, mu = 0.2, mortar",
        "force on the wedge: 2 H tan(a + arctan μ)",
        f"largest error in eight steps {100 * largest:.2f} %",
    )
    assert largest < WEDGE_TOLERANCE
