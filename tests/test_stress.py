"""Rows of the stress suite that take a second, and tests of its verdicts."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dolfinx_nts as nts
from dolfinx_nts.diagnostics.balance import CellEnergies
from helpers.once import once
from stress import endurance, meetings, rows, tumbling
from stress.boundaries import RANDOM
from stress.dents import below_the_next_facet
from stress.impact import impact
from stress.parts import box
from stress.rows import Case, run
from stress.run import CASES
from stress.table import read, summary, write_table
from stress.world import Touch, World

pytestmark = pytest.mark.at_most_two_ranks

# One case of each kind of scene on several ranks.
CHEAP = [
    "ball on plate: nu = 0.499",
    "cube on a plate: cells of plate : of cube = 24:1",
    "slivers, tetrahedron: angle = 0.1",
    "cubes on both sides: plate = 0.02",
    "cube on plate, degree 2, tetrahedron: stands on = edge",
    "flush slices: cells = 4",
    "small block on long facets: times as stiff = 200000.0",
    *map(
        once,
        [
            "ball on plate: wall = 0.025",
            "stiff ball on plate, h = 0.1: speed = 50.0",
            "stiff ball on plate, steps as they are, h = 0.1: speed = 50.0",
            "cube on a plate: cells of plate : of cube = 16:1",
            "cube in a plate: depth = 0.1",
            "cube in a plate, penalty: depth = 0.02",
            "slivers, hexahedron: angle = 1",
            "disconnected surface: slot = 0.0",
            "collapsed edge: rest = 0.0",
            "bar twisted: degrees = 720",
            "ball on plate, turned: rotation = 1 rad about (1, 2, 3)",
            "ball on plate: all lengths times = 1e-06",
            "cube on plate, two half passes: cells of plate : of cube = 16:1",
            "hard punch on a soft block: depth = 0.5",
            "neo-Hookean cube: height left = 0.1",
            "ball on plate, central differences: h = 0.05",
        ],
    ),
]


@pytest.mark.parametrize("name", CHEAP)
def test_row_ends_as_it_has_to(comm, name):
    (case,) = (case for case in CASES if case.name == name)
    assert run(case, comm).wrong == ""


@pytest.mark.parametrize("seed", [3, *map(once, [24, 29, 46])])
def test_random_bodies_bounce_or_stop_with_an_error(comm, seed):
    assert run(RANDOM[seed], comm).wrong == ""


@pytest.mark.serial
def test_suite_has_sixty_rows_with_names_of_their_own():
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names) >= 60


def midpoint(comm):
    """Scene whose energy is not constant."""
    parts = {"upper": meetings.cube(0.5, 2).at(0, 0, 0.02).flying(0, 0, -1)}
    parts["lower"] = meetings.plate()
    touch = Touch("upper.all", "lower.top", {"enforcement": nts.LagrangeMultiplier("plastic")})
    return meetings.Setup(World(comm, parts).stepper([touch], 0.01), 0.1)


def test_energy_that_is_not_constant_is_found(comm):
    case = Case("plastic", "", "", midpoint)
    assert "energy_error" in run(case, comm).wrong
    # The ledger shows the cause of the loss.
    ledger = Case("plastic", "", "", lambda comm: replace(midpoint(comm), ledger=True))
    assert run(ledger, comm).wrong == ""


@pytest.mark.serial
def test_wrong_endings_are_found(comm):
    def fast(comm):
        return impact(comm, E=1e9, h=0.1, speed=20.0, num_steps=2)

    refused = Case("", "", "", fast, cuts=0)
    assert "pass through" in run(refused, comm).wrong
    assert "expected 'inverted'" in run(replace(refused, stops="inverted"), comm).wrong
    slow = Case("", "", "", lambda comm: impact(comm, num_steps=2), stops="inverted")
    assert "finished, expected to stop" in run(slow, comm).wrong
    quiet = replace(slow, stops=None, warns="sharp")
    assert "expected the warning 'sharp'" in run(quiet, comm).wrong


@pytest.mark.serial
def test_step_that_is_cut_is_counted(comm):
    case = Case("", "", "", lambda comm: impact(comm, E=1e7, h=0.1, speed=40.0, num_steps=1))
    outcome = run(case, comm)
    assert outcome.wrong == "" and outcome.row["rejected_steps"] > 0


@pytest.mark.serial
def test_node_that_is_too_deep_is_found(comm, monkeypatch):
    monkeypatch.setattr(rows, "_approach", lambda stepper: 0.0)
    (case,) = (case for case in CASES if case.name == "slivers, hexahedron: angle = 1")
    assert "gap -0" in run(case, comm).wrong


@pytest.mark.parametrize("slope", [0.2, -0.2])
def test_nodes_may_be_below_the_next_facet_in_a_dent_only(comm, slope):
    fold = box((2, 1, 0.1), (2, 1, 1)).moved(lambda x: (x[0], x[1], x[2] + slope * abs(x[0] - 1)))
    world = World(comm, {"fold": fold, "cube": meetings.cube(0.5, 1).at(0.5, 0.2, 1)})
    stepper = world.stepper([Touch("cube.all", "fold.top")], 1.0, nts.QuasiStatic)
    # Beyond the edge by 6 % of the diameter of a facet, which turns by twice the slope.
    deepest = 0.06 * np.sqrt(1 + 1 + slope**2) * np.sin(2 * np.arctan(slope))
    assert below_the_next_facet(stepper) == pytest.approx(max(deepest, 0.0), rel=1e-12)


@pytest.mark.serial
def test_nan_in_a_run_is_found(comm, monkeypatch):
    monkeypatch.setattr(CellEnergies, "total", lambda self: np.array([np.nan, 0.0]))
    wrong = run(Case("", "", "", lambda comm: impact(comm, num_steps=2)), comm).wrong
    assert wrong.startswith("not finite: strain_energy")


@pytest.mark.serial
def test_table_has_a_line_for_each_sweep():
    table = [
        {"scene": "s", "parameter": "p", "value": value, "outcome": outcome, "message": message}
        | {"energy_error": 1e-14 * value, "momentum_error": "", "angular_momentum_error": ""}
        | {"rejected_steps": value, "min_gap": -0.01 * value, "least_allowed_gap": -0.1}
        for value, outcome, message in (
            (1, "finished", ""),
            (2, "finished", ""),
            (3, "stopped", "cell 7 is inverted, det F = -1"),
        )
    ]
    assert summary(table).splitlines()[2:] == [
        "| s | p | 1, 2 | 3: an element inverts | 3e-14 | - | 0.30 | 6 |"
    ]


@pytest.mark.serial
def test_table_is_written_again_from_the_rows_in_a_file(comm, tmp_path):
    (case,) = (case for case in CASES if case.name == "cubes on both sides: plate = 0.02")
    outcome = run(case, comm).row
    with (tmp_path / "stress.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows.COLUMNS)
        writer.writeheader()
        writer.writerow(outcome)
    assert summary(read(tmp_path / "stress.csv")) == summary([outcome])
    (tmp_path / "docs" / "tables").mkdir(parents=True)
    write_table([outcome], tmp_path)
    written = (tmp_path / "docs" / "tables" / "stress.md").read_text()
    assert written == summary([outcome]) + "\n"


@pytest.mark.serial
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
@pytest.mark.parametrize("scheme", endurance.SCHEMES)
def test_a_run_needs_no_more_memory_and_objects_the_longer_it_is(comm, scheme):
    taken = list(endurance.samples(scheme, 250))
    assert endurance.growth(taken) == ""
    steps, _, objects, _ = np.array(taken).T
    assert steps.tolist() == list(range(25, 251, 25)) and objects[0] > 0


@pytest.mark.serial
def test_growth_is_found():
    flat = [(100 * i, i, 7, 10**8) for i in range(1, 11)]
    assert endurance.growth(flat) == ""
    assert "objects" in endurance.growth([(s, t, 7 + s // 100, m) for s, t, _, m in flat])
    assert "memory" in endurance.growth([(s, t, o, m + 65 * s) for s, t, o, m in flat])
    assert "no contact" in endurance.growth([(s, 0, o, m) for s, _, o, m in flat])


@pytest.mark.serial
def test_a_body_that_tumbles_drifts_by_a_tenth_in_a_tenth_of_the_steps():
    drift = tumbling.tumble(*tumbling.SPINS[-1], num_steps=1000)
    assert drift.num_turns >= 30
    assert drift.energy < tumbling.ENERGY / 10
    assert drift.angular_momentum < tumbling.ANGULAR_MOMENTUM / 10
    assert drift.stretch < tumbling.STRETCH / 10
    assert tumbling.wrong(drift) == ""
    worse = drift._replace(energy=1e-9, stretch=np.nan)
    assert tumbling.wrong(worse) == "energy 1.0e-09 > 1e-10; stretch nan > 1e-11"


@pytest.mark.serial
def test_table_of_bodies_that_tumble_is_one_of_small_drifts():
    printed = (Path(__file__).parents[1] / "docs/tables/tumbling.md").read_text(encoding="utf-8")
    drifts = []
    for line in printed.splitlines()[2:]:
        turns, *values = line.strip("| ").split(" | ")[3:]
        drifts.append(tumbling.Drift(int(turns.removesuffix(" times")), *map(float, values)))
        assert tumbling.wrong(drifts[-1]) == "" and drifts[-1].num_turns > 50
    assert tumbling.table(drifts, 10_000) + "\n" == printed
