"""Central differences: momenta, order, ledger, stable step, cost."""

from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.contact.explicit import neighbour_list
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.linear_forms import CellForm
from dolfinx_nts.integrators.explicit import central_difference, stability
from helpers import scenes
from helpers.models.boxed import CLOSED, RHO, VOLUME, Box, Ledger, swirl
from helpers.models.swelling import swelling_box
from helpers.once import once, once_except
from helpers.scene import Scene, input_ids

pytestmark = pytest.mark.at_most_two_ranks

CONSERVED = 1e-12

cells_ = pytest.mark.parametrize("cell", ["hexahedron", once("tetrahedron")])
FRICTION = pytest.mark.parametrize("friction", [once(None, id="smooth"), nts.Coulomb(0.4)])


def blocks(comm, *, cell="hexahedron", friction=None, dt=0.005, owner=None):
    """Two blocks that collide, with springs between them."""
    first = scenes.blocks(comm, nts.Midpoint, nts.Penalty(), cell=cell, owner=owner)
    (pair,) = first.stepper.pairs
    pair = nts.ContactPair(
        pair.nodes, pair.segments, nts.Penalty(), friction, method="node-to-segment"
    )
    stepper = nts.CentralDifference(first.stepper.bodies, [pair], dt=dt)
    stepper.v.x.array[:] = first.stepper.v.x.array
    return Scene(stepper, first.bodies, first.numbers)


def momenta(diagnostics):
    return np.concatenate([diagnostics.linear_momentum(), diagnostics.angular_momentum()])


# --- physics -----------------------------------------------------------


@cells_
@FRICTION
def test_momenta_are_conserved_in_contact(comm, cell, friction):
    stepper = blocks(comm, cell=cell, friction=friction).stepper
    diagnostics = nts.Diagnostics(stepper)
    start, active = momenta(diagnostics), 0
    for _ in range(60):
        active = max(active, stepper.advance().num_active)
        assert np.abs(momenta(diagnostics) - start).max() <= CONSERVED * np.linalg.norm(start)
    assert active >= 2


@cells_
@FRICTION
def test_ledger_of_contact_closes_and_friction_takes_energy(comm, cell, friction):
    stepper = blocks(comm, cell=cell, friction=friction).stepper
    ledger = Ledger(stepper)
    ledger.run(60)
    assert max(report.num_active for report in ledger.reports) >= 2
    assert ledger.error <= CLOSED
    dissipated = -sum(report.contact_work.friction for report in ledger.reports)
    assert (dissipated > 1e-3 * ledger.scale) == (friction is not None)


@cells_
def test_ledger_with_loads_damping_and_moving_supports_closes(comm, cell):
    material = nts.SaintVenantKirchhoff(1.0e3, 0.3, RHO, mass_damping=0.5, stiffness_damping=0.002)
    box = Box(comm, cell, material)
    shift = fem.Function(box.V)
    dofs = box.dofs(0)
    bcs = [fem.dirichletbc(shift, dofs)]
    speed = np.array([0.2, -0.1, 0.3])

    def update(t):
        shift.x.array[:] = np.tile(speed * t, len(shift.x.array) // 3)

    loads = [
        nts.Gravity([box.body], (0, 0, -9.81)),
        nts.Pressure(box.surface("top 0"), lambda t: 50 * t),
    ]
    stepper = nts.CentralDifference([box.body], dt=0.004, bcs=bcs, loads=loads, update=update)
    stepper.set_velocity(box.body, speed)
    ledger = Ledger(stepper)
    ledger.run(60)
    assert ledger.error <= CLOSED
    for name in ("load_work", "support_work"):
        assert abs(ledger.total(name)) > 1e-3 * ledger.scale
    assert ledger.total("damping_work") < -1e-3 * ledger.scale


@pytest.mark.serial
@cells_
def test_error_falls_with_the_square_of_the_step(comm, cell):
    def result(dt):
        box = Box(comm, cell)
        stepper = nts.CentralDifference([box.body], dt=dt)
        stepper.set_velocity(box.body, lambda X: swirl(X) / 6)
        for _ in stepper.run(0.08):
            pass
        return box.positions(stepper)

    x = [result(0.004 / 2**i) for i in range(4)]
    differences = [np.abs(b - a).max() for a, b in pairwise(x)]
    assert 1.8 < np.log2(differences[1] / differences[2]) < 2.2


def test_steps_of_different_length_conserve_momenta(comm):
    box = Box(comm)
    stepper = nts.CentralDifference([box.body], dt=0.004)
    stepper.set_velocity(box.body, swirl)
    diagnostics = nts.Diagnostics(stepper)
    start = momenta(diagnostics)
    for dt in (0.004, 0.001, 0.003) * 5:
        stepper.dt = dt
        stepper.advance()
    assert np.abs(momenta(diagnostics) - start).max() <= CONSERVED * np.linalg.norm(start)


@pytest.mark.serial
def test_box_falls_as_a_stone(comm):
    """Velocity Verlet is exact for a constant force."""
    box = Box(comm)
    g, v, t = np.array([0, 0, -9.81]), np.array([1.0, 2.0, 3.0]), 0.1
    stepper = nts.CentralDifference([box.body], dt=0.004, loads=[nts.Gravity([box.body], g)])
    stepper.set_velocity(box.body, v)
    for _ in stepper.run(t):
        pass
    u, w = (f.x.array.reshape(-1, 3) for f in (stepper.u, stepper.v))
    np.testing.assert_allclose(u - (v * t + g * t**2 / 2), 0, atol=1e-12)
    np.testing.assert_allclose(w - (v + g * t), 0, atol=1e-12)
    balance = nts.Diagnostics(stepper).balance()
    np.testing.assert_allclose(balance.linear_momentum, RHO * VOLUME * (v + g * t), rtol=1e-12)


@pytest.mark.serial
def test_difference_to_the_energy_momentum_scheme_agrees_with_the_mass(comm):
    """It falls with the square of the cells, as lumped mass is of second order."""

    def end(scheme, cells):
        box = Box(comm, shape=(cells, 1, 1), size=(1.0, 0.2, 0.2), material=BAR)
        stepper = scheme([box.body], dt=0.1 / cells)
        stepper.set_velocity(box.body, lambda X: 0.01 * np.cos(np.pi * X) * [[1], [0], [0]])
        for _ in stepper.run(0.5):
            pass
        return box.positions(stepper)

    differences = []
    for cells in (6, 12):
        one, other = (end(scheme, cells) for scheme in (nts.CentralDifference, nts.EnergyMomentum))
        differences.append(np.abs(one - other).max())
    assert differences[0] < 0.03 * 0.01 / np.pi
    assert 1.8 < np.log2(differences[0] / differences[1]) < 2.2


# --- contact against theory --------------------------------------------

# Waves of speed 1 without lateral contraction.
BAR = nts.SaintVenantKirchhoff(1.0, 0.0, 1.0)


@pytest.mark.serial
def test_bar_rebounds_from_a_wall_as_in_wave_theory(comm, table_row):
    """Mean force rho c v times the section, for 2 L/c; all speed is back."""
    v, cells, side = 0.001, 80, 0.2
    box = Box(comm, shape=(1, 1, cells), size=(side, side, 1.0), material=BAR)
    wall = nts.RigidPlane((0, 0, 0), (0, 0, 1))
    pair = nts.ContactPair(box.surface("bottom 0"), wall, nts.Penalty(), method="node-to-segment")
    stepper = nts.CentralDifference([box.body], [pair])
    stepper.set_velocity(box.body, (0, 0, -v))
    diagnostics = nts.Diagnostics(stepper)
    start, force, active = diagnostics.balance().total_energy, [], []
    for report in stepper.run(2.6):
        force.append(diagnostics.contact_force()[2])
        active.append(report.t if report.num_active else 0.0)
    dt = stepper.dt
    duration, mean = max(active) / 2 - 1, np.sum(force) * dt / 2 / (v * side**2) - 1
    rebound = diagnostics.body_velocity(box.body)[2] / v - 1
    energy = diagnostics.balance().total_energy / start - 1
    table_row(
        "bar on a wall, `CentralDifference`, 80 elements",
        "wave theory",
        f"mean force {100 * mean:+.1f} %, duration {100 * duration:+.1f} %, "
        f"rebound {100 * rebound:+.1f} %, energy {100 * energy:+.2f} %",
    )
    assert abs(duration) <= 0.03
    assert abs(mean) <= 0.02
    assert abs(rebound) <= 0.02
    assert abs(energy) <= 0.005


OBSTACLES = {
    "plane": nts.RigidPlane((0, 0, -0.01), (0, 0, 1)),
    "sphere": nts.RigidSphere((0.5, 0.4, -2.01), 2.0),
    "facets": nts.RigidSurface(
        [(-3, -3, -0.01), (4, -3, -0.01), (-3, 4, -0.01), (4, 4, -0.01)],
        [(0, 1, 2), (1, 2, 3)],
        (0, 0, 9),
    ),
}


@FRICTION
@pytest.mark.parametrize("obstacle", once_except(list(OBSTACLES), "facets"))
def test_box_bounces_off_an_obstacle(comm, obstacle, friction):
    box = Box(comm)
    pair = nts.ContactPair(
        box.surface("bottom 0"),
        OBSTACLES[obstacle],
        nts.Penalty(),
        friction,
        method="node-to-segment",
    )
    stepper = nts.CentralDifference([box.body], [pair], dt=0.004)
    stepper.set_velocity(box.body, (0.3, 0.0, -1.0))
    ledger = Ledger(stepper)
    ledger.run(120)
    active = [report.num_active for report in ledger.reports]
    assert active[0] == 0 and max(active) >= 1 and active[-1] == 0
    assert ledger.error <= CLOSED
    v = ledger.diagnostics.body_velocity(box.body)
    assert v[2] > 0.2
    if friction is None and obstacle != "sphere":
        assert v[0] == pytest.approx(0.3, rel=1e-12)
    else:
        assert abs(v[0] - 0.3) > 1e-3


def test_nodes_far_from_an_obstacle_are_not_looked_up(comm, monkeypatch):
    box, floor = Box(comm), nts.RigidPlane((0.0, 0.0, -3.0), (0.0, 0.0, 1.0))
    found, find = [], nts.RigidPlane.find

    def counted(self, *arguments):
        found.append(arguments)
        return find(self, *arguments)

    pair = nts.ContactPair(box.surface("bottom 0"), floor, nts.Penalty(), method="node-to-segment")
    stepper = nts.CentralDifference([box.body], [pair])
    stepper.set_velocity(box.body, (0.0, 0.0, -3.0))
    monkeypatch.setattr(nts.RigidPlane, "find", counted)
    stepper.advance()
    found.clear()
    height = comm.allreduce(stepper.x[:, 2].min(), op=MPI.MIN) + 3.0
    while comm.allreduce(stepper.x[:, 2].min(), op=MPI.MIN) > 0.5 * height - 3.0:
        stepper.advance()
    assert not found
    while not stepper.advance().num_active:
        pass
    assert comm.allreduce(len(found)) > 0


@pytest.mark.serial
@pytest.mark.parametrize("friction", [None, nts.Coulomb(0.3)], ids=["smooth", "rough"])
def test_ball_on_plate(comm, friction, table_row):
    """Energy without friction; with friction the converged reference."""
    first = scenes.ball_plate(comm, nts.Midpoint, nts.Penalty())
    (pair,), bodies = first.stepper.pairs, first.stepper.bodies
    pair = nts.ContactPair(
        pair.nodes, pair.segments, nts.Penalty(), friction, method="node-to-segment"
    )
    stepper = nts.CentralDifference(bodies, [pair], dt=0.0025)
    stepper.v.x.array[:] = first.stepper.v.x.array
    ledger = Ledger(stepper)
    start = momenta(ledger.diagnostics)
    ledger.run(400)
    assert np.abs(momenta(ledger.diagnostics) - start).max() <= CONSERVED * np.linalg.norm(start)
    assert ledger.error <= CLOSED
    energy = ledger.diagnostics.balance().total_energy
    table_row(
        f"ball on plate, `CentralDifference`, {'frictionless' if friction is None else 'μ = 0.3'}",
        "momenta, and energy with all that the ledger has, are conserved",
        f"ledger {ledger.error:.0e}; energy "
        f"{100 * (energy / ledger.start.total_energy - 1):+.2f} %",
    )
    if friction is None:
        assert abs(energy / ledger.start.total_energy - 1) <= 0.005
    else:
        # As the implicit schemes: 1670 to 1684 J of 1983.8 J, 300 to 311 J dissipated.
        assert 1650 <= energy <= 1690
        dissipated = -sum(report.contact_work.friction for report in ledger.reports)
        assert 290 <= dissipated <= 315


@pytest.mark.several_ranks
def test_contact_does_not_depend_on_the_number_of_ranks(comm):
    distributed, alone = (blocks(c, friction=nts.Coulomb(0.4)) for c in (comm, MPI.COMM_SELF))
    for _ in range(60):
        distributed.stepper.advance()
        alone.stepper.advance()
    np.testing.assert_allclose(distributed.positions(), alone.positions(), atol=1e-10)


# --- stable step -------------------------------------------------------


def test_step_above_the_estimate_is_refused_by_its_name(comm, refused):
    box = Box(comm)
    stable = nts.CentralDifference([box.body]).stable_step
    with refused(ValueError, f"expected a step dt <= {stable:.4g} s, the estimate"):
        nts.CentralDifference([box.body], dt=1.01 * stable)
    stepper = nts.CentralDifference([box.body], dt=stable)
    with refused(ValueError, "the estimate of the largest stable one, given 1"):
        stepper.dt = 1.0
    assert stepper.dt == stable


@pytest.mark.serial
@cells_
def test_default_step_leaves_room(comm, cell):
    box = Box(comm, cell)
    stepper = nts.CentralDifference([box.body])
    assert stepper.dt == pytest.approx(0.7 * stepper.stable_step)
    scene = blocks(comm, cell=cell, dt=None)
    assert 0.6 <= scene.stepper.dt / scene.stepper.stable_step <= 0.9


@pytest.mark.serial
@cells_
def test_motion_is_bounded_at_the_estimate(comm, cell):
    """Many steps just below it, from a state with all frequencies."""
    box = Box(comm, cell)
    stepper = nts.CentralDifference([box.body])
    stepper.dt = 0.999 * stepper.stable_step
    rng = np.random.default_rng(1)
    noise = rng.normal(scale=1e-4, size=box.positions(stepper).shape)
    stepper.u.x.array[:] = noise[input_ids(box.V)].ravel()
    for _ in range(1000):
        stepper.advance()
    largest = comm.allreduce(np.abs(stepper.u.x.array).max(initial=0.0), op=MPI.MAX)
    assert largest <= 20 * np.abs(noise).max()


def test_wrong_estimate_is_found_out_and_the_state_stays(comm, monkeypatch, refused, agree):
    """A step of twice the limit: the energy grows until the step is refused."""
    box = Box(comm)
    stable = nts.CentralDifference([box.body]).stable_step
    limits = stability.Cells.limits
    monkeypatch.setattr(
        stability.Cells, "limits", lambda self, x: (limits(self, x)[0] / 16, limits(self, x)[1])
    )
    stepper = nts.CentralDifference([box.body], dt=2 * stable)
    stepper.set_velocity(box.body, swirl)
    before = [0.0]
    with refused(nts.ConvergenceError, "is refused: .* largest stable step is .* s: a smaller"):
        for _ in range(500):
            before = [stepper.t, stepper.step, stepper.u.x.array.copy(), stepper.v.x.array.copy()]
            stepper.advance()
    after = [stepper.t, stepper.step, stepper.u.x.array, stepper.v.x.array]
    assert agree(all(np.array_equal(a, b) for a, b in zip(before, after, strict=True)))


@pytest.mark.untrapped
@pytest.mark.parametrize("name", ["displacement", "velocity"])
def test_state_that_is_not_finite_is_refused_between_steps(comm, refused, agree, name):
    stepper = nts.CentralDifference([Box(comm).body])
    stepper.advance()
    function = {"displacement": stepper.u, "velocity": stepper.v}[name]
    if comm.rank == comm.size - 1:
        function.x.array[0] = np.nan
    before = [stepper.u.x.array.copy(), stepper.v.x.array.copy()]
    with refused(ValueError, f"expected a finite {name}, given 1 dofs that are not"):
        stepper.advance()
    after = [stepper.u.x.array, stepper.v.x.array]
    same = [np.array_equal(a, b, equal_nan=True) for a, b in zip(before, after, strict=True)]
    assert agree(all(same))


@pytest.mark.serial
def test_body_without_motion_stays_where_it_is(comm):
    """Round-off is not taken for growing energy."""
    box = Box(comm)
    stepper = nts.CentralDifference([box.body])
    rng = np.random.default_rng(1)
    noise = rng.normal(scale=1e-16, size=box.positions(stepper).shape)
    for _ in range(3 * central_difference._CHECK_INTERVAL):
        stepper.u.x.array[:] += noise[input_ids(box.V)].ravel()
        stepper.advance()
    assert comm.allreduce(np.abs(stepper.u.x.array).max(initial=0.0), op=MPI.MAX) <= 1e-12


def test_cells_that_shrink_shorten_the_stable_step(comm, refused):
    box = Box(comm)
    stretch = fem.Function(box.V)
    everything = np.arange(len(stretch.x.array) // 3, dtype=np.int32)

    def update(t):
        stretch.interpolate(lambda X: np.array([0 * X[0], 0 * X[1], -2 * t * X[2]]))

    stepper = nts.CentralDifference(
        [box.body], bcs=[fem.dirichletbc(stretch, everything)], update=update
    )
    stepper.set_velocity(box.body, lambda X: np.array([0 * X[0], 0 * X[1], -2 * X[2]]))
    dt, stable = stepper.dt, stepper.stable_step
    with refused(
        nts.ConvergenceError, r"refused: cells have become too small.* StepControl\(\) uses"
    ):
        for _ in range(500):
            stepper.advance()
    assert stepper.stable_step < dt < stable


def test_multipliers_are_refused_with_a_hint(comm, refused):
    scene = scenes.blocks(comm)
    with refused(ValueError, r"given LagrangeMultiplier: use enforcement=Penalty\(\)"):
        nts.CentralDifference(scene.stepper.bodies, scene.stepper.pairs)


def test_stiff_penalty_shortens_the_step(comm):
    scene = scenes.blocks(comm)
    (pair,) = scene.stepper.pairs
    steps = []
    for eps_N in (1.0, 1e6):
        pair = nts.ContactPair(
            pair.nodes, pair.segments, nts.Penalty(eps_N), method="node-to-segment"
        )
        steps.append(nts.CentralDifference(scene.stepper.bodies, [pair]).stable_step)
    assert steps[1] < 0.1 * steps[0]


def test_default_penalty_leaves_the_stable_step_to_the_mesh(comm, refused):
    """Springs do not stiffen as the step falls, and their limit holds for later steps."""
    scene = scenes.blocks(comm)
    (pair,) = scene.stepper.pairs
    pair = nts.ContactPair(pair.nodes, pair.segments, nts.Penalty(), method="node-to-segment")
    bodies = scene.stepper.bodies
    stable = nts.CentralDifference(bodies, [pair]).stable_step
    assert stable == pytest.approx(0.9 * nts.CentralDifference(bodies, ()).stable_step)
    for part in (1e-3, 0.1, 0.5, 1.0):
        stepper = nts.CentralDifference(bodies, [pair], dt=part * stable)
        assert stepper.stable_step == pytest.approx(stable)
        stepper.advance()
        assert stepper.stable_step == pytest.approx(stable, rel=1e-2)
    stiffness = []
    for part in (0.1, 1e-3):
        stepper = nts.CentralDifference(bodies, [pair], dt=part * stable)
        stiffness.append(stepper.contacts[0].eps_N)
    np.testing.assert_array_equal(*stiffness)
    stepper.dt = 0.5 * stable
    with refused(ValueError, "largest stable one, .*; a new stepper with this dt has softer"):
        stepper.dt = 0.99 * stable
    with refused(ValueError, f"expected a step dt <= {stable:.4g} s"):
        nts.CentralDifference(bodies, [pair], dt=1.01 * stable)


def test_tangential_spring_follows_a_given_penalty(comm):
    scene = scenes.blocks(comm)
    (pair,) = scene.stepper.pairs
    pair = nts.ContactPair(
        pair.nodes, pair.segments, nts.Penalty(50.0), nts.Coulomb(0.2), method="node-to-segment"
    )
    stable = nts.CentralDifference(scene.stepper.bodies, [pair]).stable_step
    (contact,) = nts.CentralDifference(scene.stepper.bodies, [pair], dt=stable).contacts
    np.testing.assert_allclose(contact.eps_N, 50.0)
    np.testing.assert_allclose(contact.eps_T, 50.0)


# --- cost --------------------------------------------------------------


def test_step_assembles_the_internal_forces_once_and_searches_rarely(comm):
    stepper = blocks(comm).stepper
    num_steps = 100
    for _ in range(num_steps):
        stepper.advance()
    assert stepper.statistics.num_forces == num_steps + 1
    assert stepper.contacts[0].search.num_searches <= num_steps / 10


@pytest.mark.parametrize("cell", ["hexahedron", once("tetrahedron")])
def test_energies_of_the_cells_come_with_the_forces(comm, cell, monkeypatch, agree):
    stepper = blocks(comm, cell=cell).stepper
    diagnostics, forms = nts.Diagnostics(stepper), []
    for _ in range(30):
        stepper.advance()
    assemble = CellForm.assemble
    with monkeypatch.context() as patch:
        patch.setattr(CellForm, "assemble", lambda form, *args: forms.append(assemble(form, *args)))
        stepper.advance()
        known = diagnostics.strain_energy(), diagnostics.bulk_defect()
        assert len(forms) == 1
        stepper.set_velocity(stepper.bodies[0], (0.0, 0.0, 0.0))
        integrated = diagnostics.strain_energy(), diagnostics.bulk_defect()
        assert len(forms) == 3
    assert agree(known[0] > 0)
    np.testing.assert_allclose(known, integrated, rtol=0, atol=1e-13 * known[0])


def test_least_gap_of_nodes_inside_is_known_without_a_search(comm, monkeypatch):
    stepper = blocks(comm, friction=nts.Coulomb(0.4)).stepper
    diagnostics, found, known = nts.Diagnostics(stepper), [], []
    search = PairState.gap
    monkeypatch.setattr(PairState, "gap", lambda *args: found.append(search(*args)) or found[-1])
    for _ in range(100):
        active = stepper.advance().num_active
        found.clear()
        least = diagnostics.min_gap()
        assert bool(found) == (active == 0)
        gaps = search(stepper.contacts[0], stepper.x)
        np.testing.assert_allclose(
            least, comm.allreduce(np.nanmin(gaps, initial=np.inf), op=MPI.MIN), rtol=0, atol=1e-15
        )
        known.append(active > 0)
    assert any(known) and not all(known)
    stepper.set_displacement(stepper.bodies[0], (0.0, 0.0, 0.0))
    diagnostics.min_gap()
    assert found


def test_nodes_in_reach_are_looked_for_only_after_bodies_have_moved(comm, monkeypatch, agree):
    seldom, often = (blocks(comm, friction=nts.Coulomb(0.4)) for _ in range(2))
    few, many = seldom.stepper, often.stepper
    check, found = neighbour_list.NeighbourList._rebuild, []
    search, size = few.contacts[0].search, few.pairs[0].segment_size

    def watched(self, x):
        since = self._travelled if np.isinf(self._travelled) else search.approach(x, places)
        found.append(since / size)
        check(self, x)

    monkeypatch.setattr(neighbour_list.NeighbourList, "_rebuild", watched)
    for _ in range(100):
        few.advance()
        places = few._springs.pairs[0]._neighbours._positions
        assert search.approach(few.x, places) <= neighbour_list._MARGIN * size
    assert np.isinf(found[0]) and 2 <= len(found) <= 10
    assert agree(min(found[1:]) > neighbour_list._USED * neighbour_list._MARGIN)
    monkeypatch.undo()
    for _ in range(100):
        many._springs.pairs[0].forget()
        many.advance()
    np.testing.assert_allclose(often.positions(), seldom.positions(), atol=1e-12)


def test_nodes_keep_their_segments_among_other_candidates(comm, agree):
    stepper = scenes.ball_plate(comm, nts.CentralDifference, nts.Penalty(), dt=2e-3).stepper
    while stepper.advance().num_active < 5:
        pass
    seen = stepper._springs.pairs[0]._neighbours
    # The segments under the ball, with other numbers than among all.
    other = stepper.contacts[0].search._find(stepper.x, 0.3)
    found, paired = seen._current_in(other), seen.current >= 0
    assert comm.allreduce(np.count_nonzero(found != seen.current)) > 0
    assert comm.allreduce(np.count_nonzero(paired)) >= 5
    assert agree(np.array_equal(found >= 0, paired))
    keys = seen.candidates.key[seen.current[paired]]
    assert agree(np.array_equal(other.key[found[paired]], keys))


def test_report_and_ledger_agree_with_a_step_without_iterations(comm):
    report = nts.CentralDifference([Box(comm).body]).advance()
    assert (report.step, report.newton_iterations, report.residual_norms) == (1, 0, ())


def test_energy_of_a_swelling_body_is_unaccounted_and_no_instability(comm):
    block, stretch = swelling_box(comm, 0.02, 2)

    def swell(t):
        stretch.value = 1 + 0.05 * min(t / 0.1, 1)

    stepper = nts.CentralDifference([block], [], update=swell)
    errors, strain = [], []
    for _ in stepper.run(until=0.2):
        errors.append(stepper.cell_energies[1])
        strain.append(stepper.cell_energies[0])
    assert stepper.step > 100  # the energy was checked while it swelled, and afterwards
    assert max(strain) > 0  # it vibrates, as nothing damps the waves
    assert abs(sum(errors)) < 0.01 * max(strain)
