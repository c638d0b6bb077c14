"""The smallest benchmark runs, and its files have the documented contents."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dolfinx_nts as nts
from benchmarks import __main__ as driver
from benchmarks import publish
from benchmarks.defaults.regret import Result, regrets
from benchmarks.scenes import ball_on_plate
from benchmarks.targets import Target

ROOT = Path(__file__).parents[1]

STEPS = {
    "scene",
    "scheme",
    "dofs",
    "ranks",
    "steps",
    "cpu_seconds",
    "cpu_seconds_per_step",
    "residual_seconds",
    "residuals_per_step",
    "contact_share",
    "newton_iterations",
    "krylov_iterations",
    "peak_mb",
}
ERRORS = {
    "problem",
    "scheme",
    "element",
    "h",
    "dofs",
    "cpu_seconds",
    "quantity",
    "value",
    "reference",
    "error",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    for module in ("gmsh", "matplotlib"):
        pytest.importorskip(module)
    folder = tmp_path_factory.mktemp("bench")
    command = [sys.executable, "-m", "benchmarks", "--size", "tiny", "--folder", str(folder)]
    done = subprocess.run(command, cwd=ROOT, env=os.environ, capture_output=True, text=True)
    assert not done.returncode, done.stderr
    assert (folder / "tables.md").read_text() in done.stdout
    return folder


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.serial
def test_processes_that_are_compared_take_turns_and_the_median_counts(monkeypatch):
    calls, seconds = [], iter([3.0, 5.0, 10.0, 1.0, 6.0, 30.0, 2.0, 4.0, 20.0])

    def child(module, argument, ranks=1):
        calls.append(([case["n"] for case in argument], ranks))
        return [{**case, "wall_seconds": next(seconds)} for case in argument]

    monkeypatch.setattr(driver, "child", child)
    monkeypatch.setattr(driver, "progress", lambda text: None)
    processes = [[{"n": 6, "runs": 3}, {"n": 8}], [{"n": 12, "ranks": 2, "runs": 3}]]
    rows = driver.taken_in_turns(processes, 3)
    assert calls == [([6, 8], 1), ([12], 2)] * 3
    assert rows == [
        {"n": 6, "wall_seconds": 2.0},
        {"n": 8, "wall_seconds": 5.0},
        {"n": 12, "wall_seconds": 20.0},
    ]


@pytest.mark.serial
def test_each_scheme_and_rank_count_has_a_row_of_costs(folder):
    table = rows(folder / "steps.csv")
    assert set(table[0]) >= STEPS
    assert {(row["scheme"], row["ranks"]) for row in table} == {
        ("EM elastic", "1"),
        ("EM elastic", "2"),
        ("central differences", "1"),
    }
    for row in table:
        shares = [float(value) for name, value in row.items() if name[:6] == "share:" and value]
        assert sum(shares) == pytest.approx(1)
        assert 0 < float(row["contact_share"]) < 1
        assert float(row["residuals_per_step"]) > 1
    one, two = (row for row in table if row["scheme"] == "EM elastic")
    assert float(one["v_z"]) == pytest.approx(float(two["v_z"]), rel=1e-9)


@pytest.mark.serial
@pytest.mark.parametrize(("scheme", "h"), [("EM elastic", 0.01), ("central differences", None)])
def test_measuring_leaves_the_steps_as_they_are(comm, folder, scheme, h):
    scene = ball_on_plate(comm, scheme, h, n=3, element="full")
    stepper = scene.stepper
    for _ in range(round(0.14 / stepper.dt)):
        report = stepper.advance()
    (row,) = (r for r in rows(folder / "steps.csv") if (r["scheme"], r["ranks"]) == (scheme, "1"))
    velocity = nts.Diagnostics(stepper).body_velocity(scene.body)
    assert (float(row["v_y"]), float(row["v_z"])) == tuple(velocity[1:])
    assert float(row["strain_energy"]) == nts.Diagnostics(stepper).strain_energy() > 0
    assert int(row["active"]) == report.num_active > 0


@pytest.mark.serial
def test_errors_fall_with_the_square_of_the_step_while_contact_persists(folder):
    table = rows(folder / "errors.csv")
    assert set(table[0]) >= ERRORS
    for scheme in ("EM elastic", "EM plastic"):
        coarse, fine = (float(row["error"]) for row in table if row["scheme"] == scheme)
        assert coarse / fine == pytest.approx(4, rel=0.1)


@pytest.mark.serial
def test_the_first_step_and_files_have_their_cost(folder):
    cold, warm = rows(folder / "start.csv")
    # Kernels are compiled in the first process only.
    assert float(cold["cpu_seconds"]) > 2 * float(warm["cpu_seconds"]) > 0
    (row,) = rows(folder / "output.csv")
    # On so small a mesh the difference is less than the noise of a busy machine.
    assert float(row["row_seconds"]) > 0
    assert float(row["row_and_fields_seconds"]) > 0


@pytest.mark.serial
def test_a_target_has_an_aim_and_a_gate():
    target = Target("speed-up", lambda results: 1.65, aim=1.7, gate=1.6, is_least=True)
    verdicts = [target.verdict(value) for value in (1.7, 1.65, 1.5)]
    assert verdicts == ["met", "within the gate", "**missed**"]


@pytest.mark.serial
def test_messages_are_counted(folder):
    (row,) = rows(folder / "messages.csv")
    # Two for each residual: its vector to the owners, displacements to ghosts.
    assert float(row["messages_per_step"]) > 2 * float(row["newton_per_step"])
    assert float(row["contact_messages_per_step"]) < float(row["messages_per_step"])
    # Elimination and contact Schwarz, which have no phase in the stepper, are included.
    assert float(row["contact_collectives_per_step"]) > 5 * float(row["newton_per_step"])


@pytest.mark.serial
def test_there_is_a_figure_of_each_kind(folder):
    names = {path.stem for path in folder.glob("*.png")}
    assert names == {"bench_errors", "bench_order", "bench_phases", "bench_scaling"}


@pytest.mark.serial
def test_figures_and_tables_get_into_the_documents(folder, tmp_path):
    for name in ("figures", "tables"):
        (tmp_path / "docs" / name).mkdir(parents=True)
    (tmp_path / "peers.md").write_text("| code |")
    publish.publish(tmp_path, tmp_path)
    publish.publish(folder, tmp_path)
    assert (tmp_path / "docs" / "tables" / "peers.md").read_text() == "| code |"
    assert "Order of accuracy" in (tmp_path / "docs" / "tables" / "benchmarks.md").read_text()
    assert len(list((tmp_path / "docs" / "figures").iterdir())) == 4


def test_regret_compares_with_the_best_setting_and_the_cheapest_one_as_right():
    rows = [
        ("best", 0.5, 4.0),  # below the tolerance, which counts as equal to it
        ("cheap", 1.04, 1.0),
        ("wrong", 3.0, 0.5),
    ]
    results = [
        Result("scene", name, "surfaces", {}, error, cost=cost) for name, error, cost in rows
    ]
    results.append(Result("scene", "none", "surfaces", {}, failure="refused"))
    found = {setting: regret for (_, setting), regret in regrets(results).items()}
    assert found["best"] == (1.0, 4.0)
    assert found["cheap"] == (pytest.approx(1.04), 1.0)
    assert found["wrong"] == (3.0, 1.0)
    assert found["none"] == (np.inf, np.inf)
