"""Resolved impact by massless contact nodes: order, energy, momenta and forces.

So it is by springs that follow the stiffness of the cells.
"""

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers.models import shapes
from helpers.once import once
from helpers.order import observed_order

pytestmark = pytest.mark.at_most_two_ranks

# Tolerances of the total energy and of momenta, relative.
ENERGY_TOLERANCE, MOMENTUM_TOLERANCE = 1e-10, 1e-11
CELLS, SPEED, GAP = 10, 0.1, 0.01  # of a bar of length 1, wave speed 1
LAWS = {
    "resolved": nts.LagrangeMultiplier("resolved"),
    "elastic": nts.LagrangeMultiplier("elastic"),
    "springs": nts.Penalty(),
}


@dataclass(frozen=True)
class Bar:
    """A run of a bar against a wall.

    Attributes:
        u, v: At the nodes behind those that strike, at the end.
        force: Contact force of each step over the force by wave theory.
        energy_error: Largest change of the energy, relative.
        depth: How deep nodes sink in, over the length of a cell.
    """

    u: np.ndarray
    v: np.ndarray
    force: np.ndarray
    energy_error: float
    depth: float


# Times at which a run of each law is evaluated.
TIMES = {"resolved": (1.2, 2.6), "elastic": (2.6,), "springs": (1.2,)}
# Cells of bars by name, and their degree; at degree 2 they are twice as long.
HEXAHEDRA, HEXAHEDRA_2, TETRAHEDRA_2 = ("hexahedron", 1), ("hexahedron", 2), ("tetrahedron", 2)


def bar(law, dt, until, element=HEXAHEDRA):
    """State of a bar at one of the times of its law. Collective."""
    return bars(law, dt, element=element)[until]


@cache
def bars(law, dt, times=None, gap=GAP, element=HEXAHEDRA):
    """Let a bar in uniaxial strain strike a wall; runs that end at some times. Collective."""
    cell, degree = element
    num_cells = CELLS // degree
    side = 1 / num_cells
    mesh, tags, facets, tag = nts.read_mesh(
        lambda model: parts.add_box(
            model,
            "bar",
            corner=(gap, 0, 0),
            size=(1, side, side),
            cells=(num_cells, 1, 1),
            cell=cell,
        ),
        MPI.COMM_WORLD,
    )
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    body = nts.Body(V, tags, tag["bar"], shapes.linear_in_stretch(1.0, 0.0, 1.0))
    wall = nts.RigidPlane((0, 0, 0), (1, 0, 0))
    end = nts.Surface(V, facets, tag["bar_left"])
    pair = nts.ContactPair(end, wall, LAWS[law], method="node-to-segment")
    bcs = [
        shapes.rollers(V, facets, [tag[f"bar_{side}"] for side in sides], axis)
        for axis, sides in ((1, ("front", "back")), (2, ("bottom", "top")))
    ]
    stepper = nts.EnergyMomentum([body], [pair], dt=dt, bcs=bcs)
    stepper.set_velocity(body, (-SPEED, 0, 0))
    diagnostics = nts.Diagnostics(stepper)
    energy, force, depth = [diagnostics.balance().total_energy], [], 0.0
    behind, runs = V.tabulate_dof_coordinates()[:, 0] > gap + 0.5 / CELLS, {}
    for until in times or TIMES[law]:
        for _ in stepper.run(until):
            energy.append(diagnostics.balance().total_energy)
            force.append(diagnostics.contact_force()[0] / (SPEED * side**2))
            gaps = np.nan_to_num(stepper.contacts[0].history.gap, nan=np.inf)
            depth = max(depth, -CELLS * gaps.min())
        u, v = (f.x.array.reshape(-1, 3)[behind] for f in (stepper.u, stepper.v))
        error = np.abs(np.array(energy) / energy[0] - 1).max()
        runs[until] = Bar(u, v, np.array(force), float(error), depth)
    return runs


@pytest.mark.serial
@pytest.mark.parametrize(
    ("law", "element", "until", "order"),
    [
        ("resolved", HEXAHEDRA, 1.2, 1.9),
        ("resolved", HEXAHEDRA, 2.6, 1.9),
        ("springs", HEXAHEDRA, 1.2, 1.6),
        *(("resolved", HEXAHEDRA_2, until, 1.9) for until in TIMES["resolved"]),
        *(("resolved", TETRAHEDRA_2, until, 1.7) for until in TIMES["resolved"]),
    ],
    ids=[
        *("loading", "release", "loading of springs"),
        *("loading of degree 2", "release of degree 2"),
        *("loading of tetrahedra of degree 2", "release of tetrahedra of degree 2"),
    ],
)
def test_error_is_of_second_order_in_the_step_also_through_release(
    law, element, until, order, table_row
):
    # A wave takes 0.1 through a cell of degree 1, and through half of one of degree 2.
    *runs, finest = (bar(law, dt, until, element) for dt in (0.02, 0.01, 0.0025))
    orders = []
    for name in ("u", "v"):
        exact = getattr(finest, name)
        coarse, fine = (np.linalg.norm(getattr(run, name) - exact) for run in runs)
        orders.append(np.log2(coarse / fine))
    table_row(
        f"bar on a wall by {law} until t = {until}" + _of(element),
        "second order of displacements and velocities in the step",
        f"{orders[0]:.2f}, {orders[1]:.2f}",
    )
    assert min(orders) >= order
    assert max(run.energy_error for run in (*runs, finest)) <= ENERGY_TOLERANCE


def _of(element):
    """Describe the cells of a bar where they are not the default ones."""
    cell, degree = element
    return "" if element == HEXAHEDRA else f", {cell[:-2]}a of degree {degree}"


@pytest.mark.serial
def test_order_does_not_depend_on_where_in_a_step_the_impact_falls(table_row):
    # It falls a quarter, a half and three quarters of the longest step after the end of one.
    until, changes = 0.6, []
    for gap in GAP + SPEED * 0.02 * np.array([0.25, 0.5, 0.75]):
        steps = (0.02, 0.01, 0.005)
        runs = [bars.__wrapped__("resolved", dt, (until,), gap)[until] for dt in steps]
        assert max(run.energy_error for run in runs) <= ENERGY_TOLERANCE
        changes.append(
            [
                [np.linalg.norm(getattr(a, name) - getattr(b, name)) for name in "uv"]
                for a, b in pairwise(runs)
            ]
        )
    coarse, fine = np.max(changes, axis=0)
    orders = np.log2(coarse / fine)
    table_row(
        "bar on a wall by resolved, impact within a step",
        "second order of the greatest change of displacements and velocities with the step",
        f"{orders[0]:.2f}, {orders[1]:.2f}",
    )
    assert min(orders) >= 1.7


@pytest.mark.serial
def test_compression_of_springs_does_not_depend_on_the_step():
    depths = [bar("springs", dt, 1.2).depth for dt in (0.02, 0.0025)]
    # 5/3 of the compression of a cell behind the front.
    assert depths == pytest.approx([5 / 3 * SPEED] * 2, rel=0.1)
    assert depths[0] == pytest.approx(depths[1], rel=1e-3)


@pytest.mark.serial
def test_resolved_impact_agrees_with_wave_theory_without_chatter(table_row):
    resolved, elastic = (bar(law, 0.02, 2.6).force for law in ("resolved", "elastic"))
    # Contact from 0.1 to 2.1 s with the force 1 of wave theory.
    impulses = [force.sum() * 0.02 / 2 for force in (resolved, elastic)]
    assert impulses == pytest.approx([1, 1], abs=0.02)
    overshoot = [100 * (force.max() - 1) for force in (resolved, elastic)]
    table_row(
        "force of a bar on a wall, 10 elements",
        "wave theory; behind a jump a mesh oscillates",
        f"greatest force {overshoot[0]:+.0f} %, by elastic impact {overshoot[1]:+.0f} %",
    )
    zigzag = [np.abs(np.diff(f, 2)).sum() / (4 * f.sum()) for f in (resolved, elastic)]
    assert zigzag[0] <= 0.01
    assert zigzag[1] >= 0.5
    finest = bar("resolved", 0.0025, 2.6).force
    coarse, fine = (
        np.sqrt(np.mean((force - finest.reshape(len(force), -1).mean(axis=1)) ** 2))
        for force in (resolved, bar("resolved", 0.01, 2.6).force)
    )
    assert coarse <= 0.05
    assert fine <= coarse / 3


def exact_in_time(num_cells, edges):
    """Mean force between instants of a bar whose end has no mass, from its modes.

    The bar of wave speed 1 touches from t = 0 on; the force of wave theory is 1.
    """
    n, side = num_cells + 1, 1 / num_cells
    K, M = np.zeros((2, n, n))
    for e in range(num_cells):
        K[e : e + 2, e : e + 2] += np.array([[1, -1], [-1, 1]]) / side
        M[e : e + 2, e : e + 2] += np.array([[2, 1], [1, 2]]) * side / 6
    P = np.eye(n)
    P[0, :3] = 0, 2, -1
    L = np.linalg.inv(np.linalg.cholesky((P.T @ M @ P)[1:, 1:]))
    squares, modes = np.linalg.eigh(L @ K[1:, 1:] @ L.T)
    modes, omega = L.T @ modes, np.sqrt(squares)
    # u_1 = -sum a sin(omega t), and the force is -u_1/side until it pulls.
    a = modes[0] * (np.linalg.inv(modes) @ np.ones(n - 1)) / omega / side
    fine = np.linspace(0, 2.2, 2201)
    pulls = fine[(fine > 1.5) & (np.sin(np.outer(fine, omega)) @ a < 0)][0]
    t = np.clip(edges, 0, pulls)
    return np.diff((1 - np.cos(np.outer(t, omega))) @ (a / omega)) / np.diff(edges)


@pytest.mark.serial
def test_resolved_force_agrees_with_exact_time_integration_of_the_mesh(table_row):
    force = bar("resolved", 0.0025, 2.6).force
    exact = exact_in_time(CELLS, np.arange(len(force) + 1) * 0.0025 - GAP / SPEED)
    assert np.sqrt(np.mean((force - exact) ** 2)) <= 0.01
    errors = []
    for num_cells in (100, 400):
        edges = np.arange(0, 2.2, 0.1 / num_cells)
        theory = np.diff(np.minimum(edges, 2.0)) / np.diff(edges)
        square = (exact_in_time(num_cells, edges) - theory) ** 2
        errors.append(100 * np.sqrt(np.sum(square * np.diff(edges)) / 2))
    table_row(
        "force of a bar of 100 and 400 elements on a wall, exactly integrated in time",
        "wave theory, which needs all wave lengths",
        f"{errors[0]:.0f} % rms, {errors[1]:.0f} %",
    )


def ball(comm, cell, dt, loads=(), friction=None, degree=1):
    """Return a stepper of a hollow ball that flies obliquely onto a plane, and the ball.

    At degree 2 it is one layer of curved cells.
    """

    def build(model):
        parts.add_hollow_ball(
            model,
            "ball",
            centre=(0, 0, 1.02),
            inner_radius=0.7,
            outer_radius=1.0,
            cells_per_edge=3,
            layers=5 - 2 * degree,
            cell=cell,
        )
        model.mesh.setOrder(degree)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    body = nts.Body(V, cells, tag["ball"], nts.NeoHookean(1e5, 0.3, 1e3))
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["ball_outer"]),
        nts.RigidPlane((0, 0, 0), (0, 0, 1)),
        LAWS["resolved"],
        friction,
        method="node-to-segment",
    )
    loads = [load([body]) for load in loads]
    stepper = nts.EnergyMomentum([body], [pair], dt=dt, loads=loads)
    stepper.set_velocity(body, (0.3, 1.0, -1.0))
    return stepper, body


@pytest.mark.parametrize(
    ("cell", "degree"),
    [
        ("hexahedron", 1),
        once("tetrahedron", 1),
        once("hexahedron", 2),
        ("tetrahedron", 2),
    ],
)
def test_ball_on_a_plane_keeps_energy_and_the_momenta_that_the_plane_leaves(
    comm, agree, cell, degree
):
    stepper, _ = ball(comm, cell, 0.005, degree=degree)
    diagnostics = nts.Diagnostics(stepper)
    first, refund, active = diagnostics.balance(), 0.0, 0
    for step in stepper.run(0.15):
        balance = diagnostics.balance()
        assert agree(abs(balance.total_energy / first.total_energy - 1) <= ENERGY_TOLERANCE)
        change = balance.linear_momentum - first.linear_momentum
        scale = MOMENTUM_TOLERANCE * np.linalg.norm(first.linear_momentum)
        assert agree(np.abs(change[:2]).max() <= scale)
        turn = balance.angular_momentum[2] - first.angular_momentum[2]
        assert agree(abs(turn) <= scale)
        refund, active = refund + abs(step.contact_work.refund), max(active, step.num_active)
    assert agree(active >= 4)
    assert agree(refund > 1e-6 * first.total_energy)


@pytest.mark.serial
def test_gravity_lets_a_body_fall_without_strain(comm, agree):
    stepper, body = ball(comm, "hexahedron", 0.01, [lambda b: nts.Gravity(b, (1.0, 0, -9.81))])
    stepper.set_velocity(body, (0.0, 0.0, 3.0))
    diagnostics = nts.Diagnostics(stepper)
    steps = list(stepper.run(0.05))
    kinetic = diagnostics.kinetic_energy()
    assert agree(diagnostics.strain_energy() <= 1e-14 * kinetic)
    velocity = [0.05, 0.0, 3.0 - 9.81 * 0.05]
    assert agree(diagnostics.body_velocity(body) == pytest.approx(velocity, rel=1e-12, abs=1e-12))
    work = sum(step.load_work for step in steps)
    gained = kinetic - 0.5 * 9.0 * kinetic / (0.5 * np.dot(velocity, velocity))
    assert agree(work == pytest.approx(gained, rel=1e-11))


def plate_cells(element, finer=0):
    """Count the cells along an edge of the plate, which is 2.4 long."""
    return (3 if element[1] == 2 else 7) + 2 * finer


def on_plate(
    comm,
    dt,
    method,
    mu,
    *,
    element=HEXAHEDRA,
    finer=0,
    shift=(0.05, 0.037),
    velocity=(0.3, 0.2, -1.0),
    rigid=False,
    smooth=False,
):
    """Return a stepper of a hollow ball just above a plate, both free; the plate may be rigid.

    At degree 2 both are one layer of cells. The top of the plate may be smooth.
    """
    cell, degree = element

    def build(model):
        parts.add_hollow_ball(
            model,
            "ball",
            centre=(*shift, 1.0053),
            inner_radius=0.7,
            outer_radius=1.0,
            cells_per_edge=4 - degree + finer,
            layers=5 - 2 * degree + finer,
            cell=cell,
        )
        n = plate_cells(element, finer)
        parts.add_box(
            model,
            "plate",
            corner=(-1.2, -1.2, -0.4),
            size=(2.4, 2.4, 0.4),
            cells=(n, n, 3 - degree),
            cell=cell,
        )

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    rubber = nts.NeoHookean(1e5, 0.3, 1e3)
    ball = nts.Body(V, cells, tag["ball"], rubber)
    make, law = (nts.RigidBody, rubber.rho) if rigid else (nts.Body, rubber)
    plate = make(V, cells, tag["plate"], law)
    outer = nts.Surface(V, facets, tag["ball_outer"])
    top = nts.Surface(V, facets, tag["plate_top"], smooth=smooth)
    friction = None if mu == 0 else nts.Coulomb(mu)
    pair = nts.ContactPair(outer, top, LAWS["resolved"], friction, method)
    stepper = nts.EnergyMomentum([ball, plate], [pair], dt=dt)
    stepper.set_velocity(ball, velocity)
    return stepper


@pytest.mark.serial
@pytest.mark.parametrize(
    ("method", "smooth", "mu", "element", "finer"),
    [
        ("mortar", False, 0.0, HEXAHEDRA, 1),
        ("mortar", False, 0.2, HEXAHEDRA, 1),
        ("mortar", False, 0.0, HEXAHEDRA_2, 0),
        ("mortar", False, 0.2, TETRAHEDRA_2, 0),
        ("node-to-segment", True, 0.0, HEXAHEDRA, 1),
        ("node-to-segment", True, 0.2, HEXAHEDRA, 1),
    ],
)
def test_nodes_on_edges_of_facets_keep_second_order_by_mortar_and_on_smooth_surfaces(
    method, smooth, mu, element, finer, table_row
):
    # The lowest node comes down above an edge of the plate; a wave takes 0.008 through a cell,
    # and at degree 2 0.013 through half of one.
    shift = [1.2 / plate_cells(element, finer)] * 2
    # On smooth surfaces the order shows in shorter steps.
    ends, steps = [], (0.002, 0.001, 0.00025 if smooth else 0.0005)
    for dt in steps:
        velocity = (1.0 if mu else 0.0, 0.2, -1.0)
        stepper = on_plate(
            *(MPI.COMM_SELF, dt, method, mu),
            element=element,
            finer=finer,
            shift=shift,
            velocity=velocity,
            smooth=smooth,
        )
        zigzag, forces = 0.0, []
        for _ in range(round(0.08 / dt)):
            stepper.advance()
            forces.append(-stepper.contacts[0].history.lambda_N.sum())
        zigzag = np.abs(np.diff(forces, 2)).sum() / (4 * sum(forces))
        massless = stepper.pairs[0].nodes.nodes
        ends.append(
            [np.delete(f.x.array.reshape(-1, 3), massless, axis=0) for f in (stepper.u, stepper.v)]
        )
    orders = [observed_order(steps, results) for results in zip(*ends, strict=True)]
    plate = "smooth plate" if smooth else "plate"
    table_row(
        f"ball on a {plate}, {method}, resolved impact, friction {mu}" + _of(element),
        "second order of displacements and velocities in the step",
        f"{orders[0]:.2f}, {orders[1]:.2f}",
    )
    assert min(orders) >= 1.7
    assert zigzag <= 0.01


@pytest.mark.parametrize(
    ("method", "mu", "plate", "element"),
    [
        once("mortar", 0.0, {}, HEXAHEDRA),
        once("mortar", 0.3, {}, HEXAHEDRA),
        ("node-to-segment", 0.3, {}, HEXAHEDRA),
        once("node-to-segment", 0.0, {"rigid": True}, HEXAHEDRA),
        ("mortar", 0.3, {"rigid": True}, HEXAHEDRA),
        once("node-to-segment", 0.2, {}, HEXAHEDRA_2),
        once("mortar", 0.3, {}, TETRAHEDRA_2),
        once("node-to-segment", 0.3, {"smooth": True}, HEXAHEDRA),
        once("mortar", 0.3, {"smooth": True}, HEXAHEDRA),
    ],
)
def test_ball_on_a_plate_loses_the_frictional_dissipation_only(
    comm, agree, method, mu, plate, element
):
    stepper = on_plate(comm, 0.005, method, mu, element=element, **plate)
    diagnostics = nts.Diagnostics(stepper)
    first, energy, kept = diagnostics.balance(), 0.0, set()
    for step in stepper.run(0.2):
        balance, history = diagnostics.balance(), stepper.contacts[0].history
        energy += step.contact_work.friction
        assert agree(step.contact_work.friction <= 1e-14 * first.total_energy)
        error = (balance.total_energy - energy) / first.total_energy - 1
        assert agree(abs(error) <= ENERGY_TOLERANCE)
        scale = MOMENTUM_TOLERANCE * np.linalg.norm(first.linear_momentum)
        for name in ("linear_momentum", "angular_momentum"):
            change = getattr(balance, name) - getattr(first, name)
            assert agree(np.abs(change).max() <= scale)
        sticks = comm.allreduce(np.any(history.active & ~history.sliding), op=MPI.LOR)
        kept |= {("slides", "sticks")[int(sticks)]} if step.num_active else set()
    assert agree("slides" in kept if mu == 0 else "sticks" in kept)
    assert agree((energy < -1e-3 * first.total_energy) == (mu > 0))


@pytest.mark.serial
def test_node_that_is_pressed_into_a_dent_finds_a_place_where_the_plate_is_smooth():
    # The wave speed is 12 m/s. From step 17 on, a massless node between two flat facets may have
    # its equilibrium beyond the edge of both.
    stepper = on_plate(
        MPI.COMM_SELF, 0.002, "node-to-segment", 0.0, velocity=(0.0, 5.0, -10.0), smooth=True
    )
    diagnostics = nts.Diagnostics(stepper)
    energy = diagnostics.balance().total_energy
    for _ in stepper.run(0.05):
        now = diagnostics.balance().total_energy
        assert now == pytest.approx(energy, rel=ENERGY_TOLERANCE)


@pytest.mark.parametrize("method", ["node-to-segment", once("mortar")])
def test_free_rigid_plate_moves_as_newton_says_by_the_forces_of_all_steps(comm, agree, method):
    stepper = on_plate(comm, 0.005, method, 0.0, rigid=True)
    diagnostics, impulse = nts.Diagnostics(stepper), np.zeros(3)
    for _ in stepper.run(0.1):
        impulse -= 0.005 * diagnostics.contact_force()
    # Its mass is that of 2.4 x 2.4 x 0.4 m^3, and its top the plane z = 0.
    velocity = diagnostics.body_velocity(stepper.bodies[1])
    assert agree(impulse[2] < -10)
    assert agree(np.abs(2.4 * 2.4 * 0.4e3 * velocity - impulse).max() <= 1e-11 * abs(impulse[2]))


@pytest.mark.serial
def test_ball_that_slides_on_a_plane_loses_as_much_speed_as_coulomb_says():
    stepper, body = ball(MPI.COMM_SELF, "hexahedron", 0.005, friction=nts.Coulomb(0.2))
    stepper.set_velocity(body, (3.0, 4.0, -1.0))
    diagnostics = nts.Diagnostics(stepper)
    before = diagnostics.body_velocity(body)
    list(stepper.run(0.2))
    change = diagnostics.body_velocity(body) - before
    assert change[2] > 0.1
    assert change[:2] == pytest.approx(-0.2 * change[2] * np.array([0.6, 0.8]), rel=1e-2)


@pytest.mark.serial
def test_reversed_motion_leads_back_to_where_it_came_from():
    errors = []
    for dt in (0.004, 0.001):
        stepper, body = ball(MPI.COMM_SELF, "hexahedron", dt)
        start = stepper.x.copy()
        list(stepper.run(0.12))
        assert stepper.contacts[0].history.active.any()
        stepper.v.x.array[:] *= -1
        stepper.set_velocity(body, stepper.v)
        list(stepper.run(0.24))
        errors.append(np.linalg.norm(stepper.x - start, axis=1).max())
    assert errors[1] <= 1e-3  # of the radius
    assert errors[1] <= errors[0] / 3


@pytest.mark.serial
@pytest.mark.parametrize("dt", [1.0, 3.0, 10.0])
def test_energy_is_exact_in_steps_in_which_waves_cross_many_cells(dt):
    for gap in (0.01, 0.07):
        run = bars.__wrapped__("resolved", dt, [30 * dt], gap)[30 * dt]
        assert run.energy_error <= ENERGY_TOLERANCE


@pytest.mark.serial
def test_steps_that_do_not_resolve_a_cell_are_reported_once(caplog):
    bars.__wrapped__("resolved", 0.15, [0.6])
    (message,) = (m for m in caplog.messages if "Courant number" in m)
    assert "Courant number 1.4 of cells" in message
    assert "use dt <= 0.11 s" in message
    caplog.clear()
    bars.__wrapped__("resolved", 0.04, [0.3])
    assert not caplog.messages
