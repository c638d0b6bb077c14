"""Steps are cut and grow again; a rejected attempt leaves no trace in the state."""

import csv
import logging
import re
from contextlib import nullcontext
from dataclasses import fields, replace

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.contact.history import ContactHistory
from dolfinx_nts.contact.implicit import contact_step
from dolfinx_nts.integrators import time_loop
from dolfinx_nts.integrators.implicit import implicit_stepper
from dolfinx_nts.integrators.stagnation import LimitPoint
from dolfinx_nts.solvers import newton
from dolfinx_nts.solvers.linear import krylov
from dolfinx_nts.solvers.precond import factor_age
from helpers.interrupted import SCHEMES, layers, scene
from helpers.once import once, once_except
from helpers.readers import read_grids
from helpers.scenes import BLOCK_STEP, blocks, of_material

pytestmark = pytest.mark.at_most_two_ranks

# Tolerance of the energy at the start.
ENERGY_TOLERANCE = 1e-11
UNTIL = 8 * BLOCK_STEP

IMPLICIT = {name: scheme for name, scheme in SCHEMES.items() if name not in ("explicit", "strong")}


def same_state(one, other):
    """Whether two steppers on this rank have the same state, bit for bit."""
    same = [np.array_equal(getattr(one, f).x.array, getattr(other, f).x.array) for f in "uv"]
    for a, b in zip(one.pairs, other.pairs, strict=True):
        same += [
            # NaN compares equal to NaN here.
            np.array_equal(*(np.nan_to_num(getattr(p.history, f.name), nan=9e9) for p in (a, b)))
            for f in fields(ContactHistory)
        ]
    return all(same)


def fail_at(monkeypatch, calls):
    """Make some calls of Newton's method fail after they have changed the state."""
    solve, count = implicit_stepper.newton.solve, [0]

    def failing(*arguments, **options):
        solution = solve(*arguments, **options)
        count[0] += 1
        if count[0] in calls:
            return replace(solution, report=replace(solution.report, reason="made to fail"))
        return solution

    monkeypatch.setattr(implicit_stepper.newton, "solve", failing)


@pytest.mark.parametrize("scheme", once_except(IMPLICIT, "stick", "resolved mortar"))
def test_a_cut_step_leaves_no_trace(comm, agree, monkeypatch, scheme):
    for control in (None, nts.StepControl()):
        cut, plain = (scene(comm, scheme, owner=layers).stepper for _ in range(2))
        with monkeypatch.context() as patch:
            # All starting guesses of the fourth step, and of its first half.
            fail_at(patch, range(4, 10))
            reports = list(cut.run(UNTIL, control))
        for report in reports:
            plain.dt = report.dt
            plain.advance()
        assert agree([report.rejected for report in reports[:5]] == [0, 0, 0, 2, 0])
        assert agree(max(report.num_active for report in reports) > 0)
        # Equal steps also store their end times.
        assert agree(np.array_equal(cut.x, plain.x))
        assert agree(np.array_equal(cut.v.x.array, plain.v.x.array))
        assert agree(control is None or same_state(cut, plain))


def test_a_step_that_was_solved_and_then_cut_leaves_no_trace(comm, agree, monkeypatch):
    monkeypatch.setattr(factor_age, "_REBUILD_COST", 2.0)
    cut = scene(comm, owner=layers).stepper
    reports = list(cut.run(UNTIL, nts.StepControl(gap_tol=0.005)))
    plain = scene(comm, owner=layers).stepper
    for report in reports:
        plain.dt = report.dt
        plain.advance()
    assert agree(sum(report.rejected for report in reports) > 5)
    assert agree(same_state(cut, plain))


@pytest.mark.parametrize("gap_tol", [once(0.01), 0.002])
def test_no_node_becomes_active_beyond_gap_tol(comm, folder, agree, gap_tol):
    stepper = scene(comm).stepper
    held, lengths = [], []
    with nts.Recorder(folder / "run", stepper) as recorder:
        for step in stepper.run(UNTIL, nts.StepControl(gap_tol=gap_tol)):
            recorder.write(step)
            lengths.append(step.dt)
            for pair in stepper.pairs:
                held += [*comm.allreduce(np.abs(pair.history.gap[pair.history.active]).tolist())]
    with open(folder / "run.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    energy = np.array([float(row["total_energy"]) for row in rows])
    rest = np.array([float(row["energy_unaccounted"]) for row in rows])
    assert agree(held and max(held) <= gap_tol)
    # Cut at the impact, and grown again.
    assert agree(min(lengths) < BLOCK_STEP / 4 and lengths[-1] > 2 * min(lengths))
    assert agree(sum(int(row["rejected"]) for row in rows) > 0)
    assert agree(np.abs(energy / energy[0] - 1).max() < ENERGY_TOLERANCE)
    assert agree(np.abs(rest).max() < ENERGY_TOLERANCE * energy[0])


@pytest.mark.serial
def test_nodes_become_active_at_larger_gaps_without_gap_tol(comm, agree):
    stepper = scene(comm).stepper
    held = []
    for _ in stepper.run(UNTIL):
        for pair in stepper.pairs:
            held += [*comm.allreduce(np.abs(pair.history.gap[pair.history.active]).tolist())]
    assert agree(max(held) > 0.01)


def fast(comm, law, factor):
    """Blocks that collide much faster than before. Collective."""
    # Strongly compressed cells are more robust with all quadrature points.
    old, material = blocks(comm).stepper, law(E=1e3, nu=0.3, rho=10.0, one_point=())
    bodies = [of_material(body, material) for body in old.bodies]
    stepper = nts.EnergyMomentum(bodies, old.pairs, dt=0.2 / factor)
    stepper.v.x.array[:] = factor * old.v.x.array
    stepper._state_was_set()
    return stepper


def test_an_impact_that_fails_in_long_steps_does_not_in_shorter_ones(comm, agree, refused):
    # Twice the wave speed; the first failure depends on round-off. At four times this speed nodes
    # may pass through a surface in any step, which is refused.
    reasons = "inverted|turned by more than 90 degrees|pass through a surface"
    with refused(nts.ConvergenceError, reasons):
        long = fast(comm, nts.NeoHookean, 14)
        list(long.run(2 / 14, nts.StepControl(smallest=long.dt)))
    stepper = fast(comm, nts.NeoHookean, 14)
    reports = list(stepper.run(2 / 14, nts.StepControl()))
    assert agree(stepper.t == 2 / 14)
    assert agree(sum(report.rejected for report in reports) > 0)
    assert agree(abs(sum(report.dt for report in reports) - 2 / 14) < 1e-15)


def test_steps_that_fail_are_halved_unless_refused(comm, agree, caplog):
    """Equal steps end at their times, with parts of one that fails in between."""
    with caplog.at_level(logging.WARNING, logger="dolfinx_nts"):
        stepper = fast(comm, nts.NeoHookean, 14)
        reports, dt = list(stepper.run(2 / 14)), stepper.dt
    ends = np.array([report.t for report in reports])
    number = round(2 / 14 / dt)
    assert agree(number < len(reports) and sum(report.rejected for report in reports) > 0)
    assert agree(ends[-1] == stepper.t == 2 / 14)
    for time in np.arange(1, number) * dt:
        assert agree(np.abs(ends - time).min() < 1e-15)
    cuts = comm.bcast(sum("is cut" in text for text in caplog.messages))
    assert agree(cuts == 1)


@pytest.mark.serial
def test_a_material_that_collapses_is_followed_until_it_does(comm, agree, refused):
    long, cut = (fast(comm, nts.SaintVenantKirchhoff, 6) for _ in range(2))
    long.dt = cut.dt = 0.1 / 6
    with refused(nts.ConvergenceError, "cell .* is inverted"):
        list(long.run(1.0, nts.StepControl(smallest=long.dt)))
    with refused(nts.ConvergenceError, "cell .* is inverted.*dt has been cut to"):
        list(cut.run(1.0, nts.StepControl(smallest=1e-4)))
    assert agree(cut.t > 1.5 * long.t > 0)


@pytest.mark.serial
def test_steps_end_exactly_at_the_given_times(comm, folder, agree):
    stepper, times = scene(comm).stepper, [0.03, 0.05, 0.05 + 1e-3, 0.11]
    with nts.Recorder(folder / "run", stepper, times=times) as recorder:
        ends = []
        for step in stepper.run(UNTIL, nts.StepControl(times=times)):
            recorder.write(step)
            ends.append(step.t)
    assert agree(set(times) < set(ends) and ends[-1] == UNTIL and ends == sorted(ends))
    lengths = np.diff([0, *ends])
    assert agree(lengths.max() <= BLOCK_STEP * (1 + 1e-6) and lengths.min() > 0.9e-3)
    assert agree(np.allclose(read_grids(folder / "run.vtkhdf")[0], [0, *times, UNTIL]))


def test_the_smallest_step_ends_the_run_in_the_last_good_state(comm, agree, refused, monkeypatch):
    stepper, plain = (scene(comm, owner=layers).stepper for _ in range(2))
    run = stepper.run(UNTIL, nts.StepControl(smallest=BLOCK_STEP / 5))
    reason = r"made to fail.*cut to 0.005 s.*step of 0.004 s; with dt = 0.02 s it failed first: "
    with monkeypatch.context() as patch, refused(nts.ConvergenceError, reason):
        fail_at(patch, range(4, 1000))
        list(run)
    for _ in range(3):
        plain.advance()
    assert agree(stepper.step == 3 and same_state(stepper, plain))
    assert agree(stepper.dt == BLOCK_STEP)


def test_nodes_that_keep_changing_are_named(comm, refused, monkeypatch):
    stepper = scene(comm, SCHEMES["stick"]).stepper
    monkeypatch.setattr(contact_step, "_UNSETTLED", 1)
    monkeypatch.setattr(newton, "_MAX_ITERATIONS", 2)
    # The lower faces of the upper blocks have the nodes 32 to 40, and 50 to 53.
    reason = (
        r"no convergence.*nodes that keep changing segment or state: (3[2-9]|40|5[0-3])(, \d+)*;"
    )
    with refused(nts.ConvergenceError, reason):
        list(stepper.run(UNTIL))


@pytest.mark.serial
def test_a_first_step_that_is_cut_logs_pairs_once(comm, caplog, monkeypatch):
    stepper = scene(comm, SCHEMES["stick"]).stepper
    with caplog.at_level(logging.INFO, logger="dolfinx_nts"):
        with monkeypatch.context() as patch:
            fail_at(patch, range(1, 7))  # all starting guesses of the step, and of its first half
            next(iter(stepper.run(UNTIL, nts.StepControl())))
    messages = [record.message for record in caplog.records]
    assert sum("is cut" in text for text in messages) == 2
    assert [text for text in messages if text.startswith("contact by")] == [
        str(contact) for contact in stepper.contacts
    ]


@pytest.mark.serial
def test_an_error_names_few_surfaces_of_many(comm, refused, monkeypatch):
    def build(model):
        for i in range(6):
            place = {"corner": (1.01 * i, 0.0, 0.0), "size": (1.0, 1.0, 1.0), "cells": (1, 1, 1)}
            parts.add_box(model, f"box {i}", **place)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    boxes = [nts.Body(V, cells, tag[f"box {i}"], nts.NeoHookean(1e5, 0.3, 1e3)) for i in range(6)]
    stepper = nts.EnergyMomentum(
        boxes,
        nts.all_pairs(boxes, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"),
        dt=0.01,
    )
    for i, box in enumerate(boxes):
        stepper.set_velocity(box, (-2.0 * i, 0.0, 0.0))
    monkeypatch.setattr(contact_step, "_UNSETTLED", 0)
    monkeypatch.setattr(newton, "_MAX_ITERATIONS", 1)
    reason = (
        r"if (the boundary of [^,]*? or ){3}one of \d+ more is curved, smooth=True.*"
        r"a smaller dt may help, which StepControl\(\) uses"
    )
    with refused(nts.ConvergenceError, reason):
        stepper.advance()


@pytest.mark.serial
@pytest.mark.parametrize("nodes", ["stiff", "soft"])
def test_an_error_names_pairs_with_nodes_on_the_stiffer_side(comm, monkeypatch, nodes):
    def build(model):
        for i, name in enumerate(("soft", "stiff")):
            place = {"corner": (0.0, 0.0, 1.01 * i), "size": (1.0, 1.0, 1.0), "cells": (2, 2, 2)}
            parts.add_box(model, name, **place)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber, steel = (nts.NeoHookean(E, 0.3, 1e3) for E in (1e5, 2e8))
    soft, stiff = nts.Body(V, cells, tag["soft"], rubber), nts.Body(V, cells, tag["stiff"], steel)
    sides = [nts.boundary_of(body) for body in (soft, stiff)]
    pair = nts.ContactPair(
        *(sides if nodes == "soft" else sides[::-1]),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    stepper = nts.EnergyMomentum([soft, stiff], [pair], dt=0.01)
    stepper.set_velocity(stiff, (0.0, 0.0, -2.0))
    monkeypatch.setattr(contact_step, "_UNSETTLED", 0)
    monkeypatch.setattr(newton, "_MAX_ITERATIONS", 1)
    with pytest.raises(nts.ConvergenceError) as failed:
        stepper.advance()
    hint = "the boundary of stiff provides the contact nodes and is 2000 times stiffer than"
    assert (hint in str(failed.value)) == (nodes == "stiff")
    assert ("smooth=True" in str(failed.value)) == (nodes == "soft")


@pytest.mark.serial
def test_an_error_names_nodes_on_the_coarser_side_and_its_advice_helps(comm):
    """A ball strikes a block, with facets that are 1.4 times as large."""

    def build(model):
        ball = {"centre": (0.013, 0.021, 0.505), "radius": 0.5, "cells_per_edge": 6, "layers": 2}
        parts.add_solid_ball(model, "ball", **ball)
        block = {"corner": (-1.0, -1.0, -0.5), "size": (2.0, 2.0, 0.5), "cells": (11, 11, 3)}
        parts.add_box(model, "block", **block)

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.NeoHookean(1e5, 0.3, 1e3)
    bodies = [nts.Body(V, cells, tag[name], rubber) for name in ("ball", "block")]
    sides = [nts.Surface(V, facets, tag[name]) for name in ("ball_outer", "block_top")]
    low = fem.locate_dofs_topological(V, 2, facets.find(tag["block_bottom"]))
    bcs = [fem.dirichletbc(np.zeros(3), low, V)]

    def steps(*sides):
        stepper = nts.EnergyMomentum(
            bodies,
            [
                nts.ContactPair(
                    *sides, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
                )
            ],
            dt=0.01,
            bcs=bcs,
        )
        stepper.set_velocity(bodies[0], (0.0, 0.0, -1.0))
        return stepper.run(0.2, nts.StepControl(smallest=stepper.dt))

    hint = r"block_top provides the contact nodes, and its facets are 1\.\d times as large as those"
    with pytest.raises(nts.ConvergenceError, match=hint):
        list(steps(*sides[::-1]))
    assert len(list(steps(*sides))) == 20


@pytest.mark.serial
@pytest.mark.parametrize("is_rigid", [True, False])
def test_an_error_advises_mortar_contact_only_with_nodes_of_deformable_bodies(
    comm, monkeypatch, is_rigid
):
    def build(model):
        for i, n in enumerate((4, 2)):
            place = {"corner": (0.0, 0.0, 1.01 * i), "size": (1.0, 1.0, 1.0), "cells": (n, n, n)}
            parts.add_box(model, f"box {i}", **place)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.NeoHookean(1e5, 0.3, 1e3)
    fine = nts.Body(V, cells, tag["box 0"], rubber)
    if is_rigid:
        coarse = nts.RigidBody(V, cells, tag["box 1"], rho=1e3)
    else:
        coarse = nts.Body(V, cells, tag["box 1"], rubber)
    pair = nts.ContactPair(
        *map(nts.boundary_of, (coarse, fine)),
        method=None if is_rigid else "node-to-segment",
    )
    stepper = nts.EnergyMomentum([fine, coarse], [pair], dt=0.01)
    stepper.set_velocity(coarse, (0.0, 0.0, -2.0))
    monkeypatch.setattr(contact_step, "_UNSETTLED", 0)
    monkeypatch.setattr(newton, "_MAX_ITERATIONS", 1)
    with pytest.raises(nts.ConvergenceError, match="so that the finer one provides") as failed:
        stepper.advance()
    assert ('or use method="mortar"' in str(failed.value)) != is_rigid


@pytest.mark.serial
def test_explicit_steps_stay_stable(comm, agree):
    stepper = scene(comm, SCHEMES["explicit"]).stepper
    ends = [report.t for report in stepper.run(0.013, nts.StepControl(times=[0.0031]))]
    assert agree(0.0031 in ends and ends[-1] == 0.013)


def test_a_resumed_run_continues_with_the_same_steps(comm, folder, agree):
    control = nts.StepControl(gap_tol=0.005)
    whole = scene(comm, owner=layers).stepper
    list(whole.run(UNTIL, control))
    first = scene(comm, owner=layers).stepper
    with nts.Recorder(folder / "run", first, checkpoint_every=1) as recorder:
        for step in first.run(UNTIL, control):
            recorder.write(step)
            if step.rejected:
                break
    stepper = scene(comm, owner=layers).stepper
    with nts.Recorder(folder / "run", stepper, resume=True) as recorder:
        for step in stepper.run(UNTIL, control):
            recorder.write(step)
    assert agree(0 < first.step < stepper.step == whole.step and same_state(stepper, whole))


def balloon(comm, pressure):
    """Statics of a hollow ball under an internal gas pressure that grows with time."""

    def fill(model):
        size = {"inner_radius": 0.4, "outer_radius": 0.5, "cells_per_edge": 2, "layers": 1}
        parts.add_hollow_ball(model, "balloon", centre=(0, 0, 0), **size)

    mesh, cells, facets, tag = nts.read_mesh(fill, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    body = nts.Body(V, cells, tag["balloon"], nts.NeoHookean(1e6, 0.45, 1e3))
    load = nts.Pressure(nts.Surface(V, facets, tag["balloon_inner"]), lambda t: pressure * t)
    bcs = []
    for i in range(3):  # planes of symmetry
        Vi = V.sub(i)
        dofs = fem.locate_dofs_geometrical((Vi, Vi.collapse()[0]), lambda x, i=i: abs(x[i]) < 1e-9)
        bcs.append(fem.dirichletbc(np.float64(0), dofs[0], Vi))
    return nts.QuasiStatic([body], [], dt=0.1, bcs=bcs, loads=[load])


@pytest.mark.serial
def test_a_limit_load_is_named_soon(comm, monkeypatch):
    """A rubber balloon bursts at about 0.1 MPa; neo-Hooke's law has a largest pressure there."""
    stepper, reports, solved = balloon(comm, 5e5), [], []
    solve = krylov.LinearSolver.solve
    monkeypatch.setattr(krylov.LinearSolver, "solve", lambda *a: solved.append(0) or solve(*a))
    with pytest.raises(nts.ConvergenceError) as raised:
        reports.extend(stepper.run(1.0, nts.StepControl()))
    # Each of the 20 cuts down to the smallest step may need 100.
    assert len(solved) < 1000
    text = r"no equilibrium beyond a time between t = (\S+) and (\S+), a limit load"
    below, above = map(float, re.search(text, str(raised.value)).groups())
    assert below == pytest.approx(stepper.t) and above - below < 0.1 / 16
    assert "relaxation with a viscous resistance has not found another one either" in str(
        raised.value
    )
    assert "use EnergyMomentum, with damping or plastic impact" in str(raised.value)
    # A length that the user sets is respected; it finds closer equilibria, but none beyond.
    smallest = 0.1 / 2**8
    with pytest.raises(nts.ConvergenceError, match=f"smallest step of {smallest:.3g} s"):
        list(stepper.run(1.0, nts.StepControl(smallest=smallest)))
    assert below < stepper.t < above
    assert 0.1e6 > 5e5 * stepper.t > 0.09e6


@pytest.mark.serial
@pytest.mark.parametrize(
    ("has_loads", "text"), [(True, "a limit load"), (False, "though no loads act")]
)
def test_a_limit_point_takes_more_than_one_fast_step(has_loads, text):
    """Surfaces that meet make bodies fast for one step; only loads have limit loads."""
    limit = LimitPoint()
    for rate, rejected, is_near in [(1.0, 0, False), (4.0, 5, False), (8.0, 1, True)]:
        limit.accept(rate, rejected)
        assert limit.is_near == is_near
    assert text in limit.message(0.1, 0.2, has_loads)


@pytest.mark.parametrize("part", [16, once(32)])
def test_stagnation_of_the_step_size_is_reported_once(comm, agree, caplog, monkeypatch, part):
    """The error of a step that is cut is logged below the level of warnings."""
    stepper = scene(comm).stepper
    whole, advance = stepper.dt, stepper.advance

    def fails_when_long():
        if stepper.dt > 1.01 * whole / part:
            raise nts.ConvergenceError("too long a step", [])
        return advance()

    monkeypatch.setattr(stepper, "advance", fails_when_long)
    with caplog.at_level(logging.WARNING, "dolfinx_nts"):
        list(stepper.run(70 * whole / part, nts.StepControl()))
    messages = [record.getMessage() for record in caplog.records]
    messages = [text for text in messages if "16 times shorter" in text]
    assert agree(len(messages) == (1 if comm.rank == 0 else 0))
    assert agree(all("too long a step" in text for text in messages))


@pytest.mark.serial
def test_wrong_numbers_are_refused(comm, refused):
    for name in ("smallest", "gap_tol"):
        for value in (0.0, -1.0, np.nan, np.inf):
            with refused(ValueError, f"expected {name} > 0"):
                nts.StepControl(**{name: value})
    with refused(ValueError, "finite times"):
        nts.StepControl(times=[1.0, np.nan])


class Bar(nullcontext):
    """Bar that keeps its messages."""

    def __init__(self, **options):
        """Begin."""
        super().__init__(self)
        self.options, self.done = options, options.get("initial", 0)

    def update(self, done=1):
        self.done += done


@pytest.mark.parametrize("control", [None, nts.StepControl()])
def test_the_bar_reaches_its_end_on_the_first_rank_only(comm, agree, monkeypatch, control):
    bars = []
    monkeypatch.setattr(
        time_loop, "tqdm", lambda **options: bars.append(Bar(**options)) or bars[-1]
    )
    stepper = scene(comm).stepper
    list(stepper.run(UNTIL / 2, control))
    list(stepper.run(UNTIL, control))
    assert agree([bar.options["total"] for bar in bars] == pytest.approx([bars[0].done, UNTIL]))
    assert agree(all(bar.done == pytest.approx(bar.options["total"]) for bar in bars))
    assert {bar.options["disable"] for bar in bars} == {None if comm.rank == 0 else True}
