"""Laws of friction against closed forms, and a law of a user in all kinds of steps.

A block on a plate that brakes, a mass on a spring that a belt drags along, a block that is pressed
on a plate and dragged. The dissipation is never negative, and closes the ledger of energy.
"""

from collections.abc import Callable
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models.boxed import Box
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

G, RHO, HEIGHT = 10.0, 1e3, 0.25
UP = (0.0, 0.0, 1.0)
# Until then gravity grows smoothly, so that a block on springs does not bounce [s].
LOADED = 0.25
# Stiff springs: the mass moves by 0.1 mm under the largest friction.
SPRINGS = {"enforcement": nts.Penalty(eps_N=1e6), "eps_T": 1e7}
MULTIPLIERS = {"enforcement": nts.LagrangeMultiplier(), "eps_T": None}


def gravity(t: float) -> tuple[float, float, float]:
    s = min(t / 0.2, 1.0)
    return 0.0, 0.0, -G * s**3 * (10 - 15 * s + 6 * s**2)


def block() -> nts.RigidBody:
    """Rigid block of 1 m x 1 m x 0.25 m on the plane z = 0, which does not turn. Collective."""

    def build(model: Any) -> None:
        nts.parts.add_box(model, "b", corner=(0, 0, 0), size=(1, 1, HEIGHT), cells=(1, 1, 1))

    mesh, tags, _, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    return nts.RigidBody(V, tags, tag["b"], rho=RHO, guide=nts.Guide(slides="xz"))


def on_plate(body: nts.Body, travel: Any, law: Any, enforcement: Any) -> nts.ContactPair:
    """Contact of the lower side with a plate of prescribed motion along x. Collective."""
    plate = nts.RigidPlane((0, 0, 0), UP).moving(
        nts.Motion(translation=lambda t: (travel(t), 0.0, 0.0))
    )
    return nts.ContactPair(
        nts.boundary_of(body, where=lambda x: x[2] < 1e-9),
        plate,
        enforcement,
        law,
        method="node-to-segment",
    )


@pytest.mark.parametrize(
    ("stepper", "dt", "contact", "tolerance"),
    [
        (nts.EnergyMomentum, 0.01, MULTIPLIERS, 1e-3),
        once(nts.EnergyMomentum, 0.005, SPRINGS, 1e-3),
        once(nts.CentralDifference, 0.001, SPRINGS, 5e-3),
    ],
)
def test_block_on_a_braking_plate_follows_the_stribeck_curve(stepper, dt, contact, tolerance):
    """Relative speed v, with dv/dt = a - g mu(v) and mu = mu_k + (mu_s - mu_k) exp(-v/v_s).

    The plate takes the block along. At one time its speed drops, and then it brakes.
    """
    a, v0, jump, static, kinetic, speed = 5.0, 2.0, 0.2, 0.4, 0.2, 0.5

    def travel(t: float) -> float:
        braking = max(t - LOADED, 0.0)
        return v0 * t - jump * braking - a * braking**2 / 2

    b = block()
    law = nts.Stribeck(static, kinetic, speed, eps_T=contact["eps_T"])
    pair = on_plate(b, travel, law, contact["enforcement"])
    s = stepper([b], [pair], dt=dt, loads=[nts.Gravity([b], gravity)])
    s.set_velocity(b, (v0, 0, 0))
    energy = RHO * HEIGHT * v0**2
    for report in s.run(LOADED + 0.3):
        assert report.contact_work.friction <= 1e-12 * energy
    t, net = s.t - LOADED, a - G * kinetic
    c = G * (static - kinetic) / net
    expected = speed * np.log((np.exp(jump / speed) - c) * np.exp(net * t / speed) + c)
    found = nts.Diagnostics(s).body_velocity(b)[0] - (v0 - jump - a * t)
    assert found == pytest.approx(expected, rel=tolerance)


@pytest.mark.serial
@pytest.mark.parametrize(
    ("stepper", "dt", "contact", "tolerance"),
    [
        (nts.EnergyMomentum, 0.005, MULTIPLIERS, (0.005, 0.03)),
        (nts.CentralDifference, 0.001, SPRINGS, (0.01, 0.06)),
    ],
)
def test_mass_on_a_spring_sticks_and_slips_on_a_belt(stepper, dt, contact, tolerance):
    """Period and amplitude with a static and a kinetic coefficient, the belt at a steady speed.

    The mass rides until the spring has the static limit. It slips by an arc of a harmonic motion
    about the kinetic equilibrium, until its speed is that of the belt again.
    """
    static, kinetic, v, omega = 0.4, 0.2, 0.4, 10.0
    mass = RHO * HEIGHT
    k, normal, at_start = mass * omega**2, mass * G, v * LOADED
    drop = (static - kinetic) * normal
    b = block()
    law = nts.Stribeck(static, kinetic, speed=0.0, eps_T=contact["eps_T"])
    pair = on_plate(b, lambda t: v * t, law, contact["enforcement"])

    def pull(u: Any, eta: Any, t: Any) -> Any:
        stretch = ufl.conditional(ufl.gt(t, LOADED), u[0] - at_start, 0.0)
        return -k / HEIGHT * stretch * eta[0] * ufl.dx

    loads = [nts.Gravity([b], gravity), nts.FormLoad(b.V, pull)]
    s = stepper([b], [pair], dt=dt, loads=loads)
    s.set_velocity(b, (v, 0, 0))
    diagnostics = nts.Diagnostics(s)
    centre = diagnostics.centre_of_mass(b)[0] + at_start + kinetic * normal / k
    period = 2 * (np.pi - np.arctan(drop * omega / (k * v))) / omega + 2 * drop / (k * v)
    first = LOADED + static * normal / (k * v)
    states = []
    for report in s.run(first + 2.2 * period):
        assert report.contact_work.friction <= 1e-12 * mass * v**2
        states.append((report.t, diagnostics.centre_of_mass(b)[0] - centre))
    t, x = np.array(states).T
    # Times at which the mass passes the kinetic equilibrium on its return.
    back = np.flatnonzero((x[:-1] > 0) & (x[1:] <= 0))
    times = t[back] + x[back] / (x[back] - x[back + 1]) * (t[back + 1] - t[back])
    assert len(times) == 2
    amplitude = np.ptp(x[t > times[0]]) / 2
    assert times[1] - times[0] == pytest.approx(period, rel=tolerance[0])
    assert amplitude == pytest.approx(np.hypot(drop / k, v / omega), rel=tolerance[1])


# --- a block that is pressed on a plate and dragged ----------------------


def dragged(
    law: Callable[[fem.FunctionSpace], nts.FrictionLaw],
    method: Any = "node-to-segment",
    enforcement: Any = None,
    press: float = 0.005,
    drag: float = 0.02,
) -> nts.QuasiStatic:
    """Press a block on a plate in one step of 1 s, and drag it in two. Collective.

    ``law`` makes the law of friction by the space.
    """

    def build(model: Any) -> None:
        nts.parts.add_box(model, "low", corner=(0, 0, 0), size=(2, 1, 0.3), cells=(5, 3, 1))
        nts.parts.add_box(model, "up", corner=(0.3, 0.15, 0.3), size=(1, 0.7, 0.3), cells=(3, 2, 1))

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.SaintVenantKirchhoff(E=1e6, nu=0.3, rho=RHO)
    bodies = [nts.Body(V, cells, tag[name], material) for name in ("low", "up")]
    surfaces = [nts.Surface(V, facets, tag[name]) for name in ("up_bottom", "low_top")]
    pair = nts.ContactPair(*surfaces, enforcement, law(V), method)
    motion = fem.Function(V)
    bcs = []
    for name, value in (("low_bottom", fem.Function(V)), ("up_top", motion)):
        dofs = fem.locate_dofs_topological(V, 2, facets.find(tag[name]))
        bcs.append(fem.dirichletbc(value, dofs))

    def update(t: float) -> None:
        motion.x.array.reshape(-1, 3)[:] = (drag * max(t - 1, 0), 0.0, -press * min(t, 1))

    s = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, update=update)
    for _ in range(3):
        assert s.advance().newton_iterations <= 15
    return s


@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
@pytest.mark.parametrize("enforcement", [nts.LagrangeMultiplier(), once(nts.Penalty())])
def test_capped_friction_is_cap_times_area(method, enforcement):
    """Under a pressure at which Coulomb's limit is far above the cap everywhere."""
    cap = 300.0
    (pair,) = dragged(lambda V: nts.Tresca(0.5, cap), method, enforcement).pairs
    comm = MPI.COMM_WORLD
    traction = comm.allreduce(pair.history.traction.sum(axis=0))
    assert comm.allreduce(int((~pair.history.sliding).sum())) == 0
    lengths = comm.allreduce(np.linalg.norm(pair.history.traction, axis=1).sum())
    assert lengths == pytest.approx(cap * 0.7, rel=1e-3)
    # Nodes at the ends also slide across, as the block bulges.
    assert abs(traction[0]) == pytest.approx(cap * 0.7, rel=0.02)


class OfSpheres(nts.FrictionLaw):
    """Friction of a sphere on a plane by its contact area, proportional to p^(2/3)."""

    def limit(self, p, slip, dt, nodes):
        return 2.0 * p ** (2 / 3), 4 / 3 * p ** (-1 / 3), 0.0


@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
@pytest.mark.parametrize("enforcement", [nts.LagrangeMultiplier(), nts.Penalty()])
def test_slope_of_a_law_may_be_infinite_where_nodes_are_open(method, enforcement):
    """Regression: the residual was not finite."""
    s = dragged(lambda V: OfSpheres(), method, enforcement)
    history = s.pairs[0].history
    traction = np.linalg.norm(history.traction, axis=1)[history.sliding]
    np.testing.assert_allclose(traction, 2.0 * (-history.lambda_N[history.sliding]) ** (2 / 3))
    assert MPI.COMM_WORLD.allreduce(int(history.sliding.sum())) == 12


class Broken(nts.FrictionLaw):
    """Law that is no number for nodes that have slipped by more than 1 mm."""

    def limit(self, p, slip, dt, nodes):
        mu = np.where(nodes.slipped > 1e-3, np.nan, 0.3)
        return mu * p, mu, 0.0


@pytest.mark.serial  # the rank of the node raises the error alone, which ends the others
def test_limit_that_is_nan_in_a_step_is_named():
    with pytest.raises(ValueError, match=r"finite limit from Broken\(\), given nan at p = "):
        dragged(lambda V: Broken())


class ByPressure(nts.FrictionLaw):
    """Coefficient 0.5 at low pressures, and a shear stress of 300 Pa at high ones."""

    def limit(self, p, slip, dt, nodes):
        pressure, scale = p / nodes.area, 600.0
        part = np.exp(-pressure / scale)
        return 0.5 * scale * nodes.area * (1 - part), 0.5 * part, 0.0


@pytest.mark.parametrize(
    ("scheme", "dt"),
    [(nts.QuasiStatic, 0.01), (nts.EnergyMomentum, 1e-3), (nts.CentralDifference, None)],
)
@pytest.mark.parametrize("law", [nts.Tresca(0.5, 300.0), ByPressure()], ids=["capped", "curve"])
def test_capped_friction_is_cap_times_area_at_degree_two(scheme, dt, law):
    """Vertices of quadratic triangles have no area, as a uniform pressure has no force there.

    The largest force counts, as the trailing edge may lift off in steps with inertia.
    """
    box = Box(MPI.COMM_WORLD, "tetrahedron", size=(1.0, 0.8, 0.1), shape=(4, 3, 1))
    V = fem.functionspace(box.mesh, ("Lagrange", 2, (3,)))
    material = nts.SaintVenantKirchhoff(1e6, 0.0, RHO, mass_damping=300.0)
    body = nts.Body(V, box.cells, box.tag["body 0"], material)
    bottom = nts.Surface(V, box.facets, box.tag["bottom 0"])
    floor = nts.RigidPlane((0, 0, 0), (0, 0, 1))
    motion = fem.Function(V)
    top = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], 0.1))
    pressed = 0.02  # s

    def update(t: float) -> None:
        dragged = 2 * max(t - pressed, 0)
        motion.x.array.reshape(-1, 3)[:] = (dragged, 0.0, -2e-3 * min(t / pressed, 1))

    pair = nts.ContactPair(bottom, floor, friction=law)
    bcs = [fem.dirichletbc(motion, top)]
    s = scheme([body], [pair], bcs=bcs, update=update, dt=dt)
    (pair,) = s.pairs
    forces = []
    for _ in s.run(until=2 * pressed):
        traction = MPI.COMM_WORLD.allreduce(pair.history.traction.sum(axis=0))
        forces.append(np.linalg.norm(traction))
    assert max(forces) == pytest.approx(300.0 * 0.8, rel=0.01)


@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
@pytest.mark.parametrize("element", [("Lagrange", 1), once(("DG", 0))])
def test_coefficient_may_be_a_function(method, element):
    """Friction of each node that slides is mu(X) times its normal force."""

    def law(V: fem.FunctionSpace) -> nts.FrictionLaw:
        mu = fem.Function(fem.functionspace(V.mesh, element))
        if element == ("DG", 0):  # another number in the upper block
            mu.interpolate(lambda x: np.where(x[2] > 0.3, 0.1, 0.3))
        else:
            mu.interpolate(lambda x: 0.1 + 0.2 * x[0])
        return nts.Coulomb(mu)

    (pair,) = dragged(law, method).pairs
    history = pair.history
    X = pair.nodes.V.tabulate_dof_coordinates()[pair.nodes.nodes]
    mu = 0.1 if element == ("DG", 0) else 0.1 + 0.2 * X[:, 0]
    expected = np.where(history.sliding, -mu * history.lambda_N, 0.0)
    assert MPI.COMM_WORLD.allreduce(int(history.sliding.sum())) > 6
    found = np.where(history.sliding, np.linalg.norm(history.traction, axis=1), 0.0)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)
    assert "mu = a Function" in str(pair)


def by_function(V: fem.FunctionSpace, least: float) -> fem.Function:
    """Function that is 0.4 for x > 0.6 m and small elsewhere, also at all nodes of some ranks."""
    found = fem.Function(fem.functionspace(V.mesh, ("Lagrange", 1)))
    found.interpolate(lambda x: np.where(x[0] < 0.6, least, 0.4))
    return found


@pytest.mark.parametrize("kind", ["Coulomb", "Tresca", "SlipWeakening"])
def test_negative_values_of_a_function_within_round_off_are_zero(kind):
    def law(V: fem.FunctionSpace, least: float = -1e-16) -> nts.FrictionLaw:
        mu = by_function(V, least)
        return {
            "Coulomb": lambda: nts.Coulomb(mu),
            "Tresca": lambda: nts.Tresca(0.3, mu),
            "SlipWeakening": lambda: nts.SlipWeakening(mu, mu, 0.1),
        }[kind]()

    (pair,) = dragged(law).pairs
    assert MPI.COMM_WORLD.allreduce(int(pair.history.sliding.sum())) > 0
    b = block()
    explicit = nts.CentralDifference([b], [on_plate(b, float, law(b.V), None)], dt=1e-3)
    explicit.set_velocity(b, (0.0, 0.0, -1.0))
    explicit.advance()
    with pytest.raises(ValueError, match=r"limits of friction >= 0 from .*given -"):
        on_plate(b, float, law(b.V, -1e-9), None)


def test_law_without_a_limit_is_refused():
    """On all ranks, when the pair is made."""
    b = block()
    other = fem.Function(fem.functionspace(block().V.mesh, ("Lagrange", 1)))
    vector = fem.Function(b.V)
    with pytest.raises(TypeError, match="as a scalar Function, given shape"):
        nts.Coulomb(vector)
    negative = fem.Function(fem.functionspace(b.V.mesh, ("Lagrange", 1)))
    negative.interpolate(lambda x: x[0] - 0.5)

    class Short(nts.FrictionLaw):
        def limit(self, p: Any, slip: Any, dt: float, nodes: Any) -> Any:
            return 0.3 * p, 0.3

    for law, message in (
        (nts.Coulomb(other), "expected a Function of the mesh of the contact pair"),
        (nts.Coulomb(negative), "expected limits of friction >= 0"),
        (Short(), r"expected the limit and its .* given 2 of the shapes \(\d+,\), \(\)"),
    ):
        with pytest.raises(ValueError, match=message):
            on_plate(b, lambda t: 0.0, law, None)


# --- a law of a user -----------------------------------------------------


class Viscous(nts.FrictionLaw):
    """Coefficient that grows with the speed of slip."""

    mu, slope = 0.2, 0.1

    def limit(self, p: Any, slip: Any, dt: float, nodes: Any) -> Any:
        mu = self.mu + self.slope * slip / dt
        return mu * p, mu, self.slope / dt * p


def error_of_limits(s: Any, before: Any) -> float:
    """Largest error of the tractions of nodes that slide, relative to the largest traction.

    NaN where no traction is above 1 N.
    """
    history = s.pairs[0].history
    speed = (history.slip - before.slip) / s.dt
    limit = -(Viscous.mu + Viscous.slope * speed) * history.lambda_N
    size = np.linalg.norm(history.traction, axis=1)
    error = np.where(history.sliding, np.abs(size - limit), 0.0).max(initial=0.0)
    own = float(size.max(initial=0.0)), float(error)
    largest, error = (MPI.COMM_WORLD.allreduce(value, op=MPI.MAX) for value in own)
    # The forces of nodes that touch at the end of a step are round-off.
    return error / largest if largest > 1.0 else np.nan


@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
def test_law_of_a_user_in_statics(method):
    """The load prescribes the speed: a slip of 2 cm in each step of 1 s."""
    s = dragged(lambda V: Viscous(), method)
    before = s.pairs[0].history
    s.advance()
    assert error_of_limits(s, before) <= 1e-6


@pytest.mark.parametrize(
    ("stepper", "method", "enforcement"),
    [
        (nts.EnergyMomentum, "node-to-segment", nts.LagrangeMultiplier("plastic")),
        (nts.EnergyMomentum, "mortar", nts.LagrangeMultiplier("plastic")),
        once(nts.CentralDifference, "node-to-segment", nts.Penalty()),
    ],
)
def test_law_of_a_user_between_bodies_that_move(stepper, method, enforcement):
    def build(model: Any) -> None:
        nts.parts.add_box(model, "low", corner=(0, 0, 0), size=(2, 1, 0.3), cells=(5, 3, 1))
        nts.parts.add_box(
            model, "up", corner=(0.3, 0.15, 0.301), size=(1, 0.7, 0.3), cells=(3, 2, 1)
        )

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.SaintVenantKirchhoff(E=1e6, nu=0.3, rho=RHO)
    low, up = (nts.Body(V, cells, tag[name], material) for name in ("low", "up"))
    surfaces = [nts.Surface(V, facets, tag[name]) for name in ("up_bottom", "low_top")]
    pair = nts.ContactPair(*surfaces, enforcement, Viscous(), method)
    explicit = stepper is nts.CentralDifference
    s = stepper([low, up], [pair], dt=None if explicit else 0.002)
    s.set_velocity(up, (1.0, 0.3, -0.5))
    diagnostics = nts.Diagnostics(s)
    energy = diagnostics.balance().total_energy
    dissipated, slid = 0.0, 0
    for _ in range(40 if explicit else 6):
        before = pair.history
        report = s.advance()
        dissipated -= report.contact_work.friction
        assert report.contact_work.friction <= 1e-12 * energy
        if not np.isnan(error := error_of_limits(s, before)):
            slid += 1
            assert error <= (1e-12 if explicit else 1e-6)
            assert report.contact_work.friction < 0
    assert slid >= 2
    if explicit:  # which does not conserve the energy in a step
        return
    # Plastic impact of multipliers loses energy, too.
    assert energy - diagnostics.balance().total_energy >= dissipated
