"""Impacts with the default of contact, whose references are closed forms or finer meshes."""

import pytest

import dolfinx_nts as nts
from benchmarks.defaults import impacts
from benchmarks.defaults.scenes import PEAK, REBOUND
from benchmarks.defaults.settings import SETTINGS

pytestmark = pytest.mark.serial

DEFAULT = SETTINGS["default"]


def run(scene):
    """Run a scene without cuts of its step; relative error of its energy [-], and its results."""
    diagnostics = nts.Diagnostics(scene.stepper)
    start, work = diagnostics.balance().total_energy, 0.0
    control = nts.StepControl(smallest=scene.stepper.dt)
    for report in scene.stepper.run(until=scene.t_end, control=control):
        work += report.load_work
        scene.record()
    error = (diagnostics.balance().total_energy - work) / start - 1
    return error, scene.judge()


def test_ball_rebounds_from_a_held_block_as_on_fine_meshes():
    error, measured = run(impacts.ball_on_block(DEFAULT))
    assert abs(error) < 1e-10
    assert measured["rebound"] == pytest.approx(REBOUND, abs=0.006)
    assert measured["peak force"] == pytest.approx(PEAK, rel=0.02)
    assert measured["sideways"] < 0.003
    assert measured["roughness of the pressure"] < 0.05


def test_balls_of_revolution_exert_the_force_of_hertz():
    error, measured = run(impacts.balls_of_revolution(DEFAULT, plane=False))
    assert abs(error) < 1e-10
    assert measured["largest force"] < 0.02
    assert measured["impulse"] < 0.02


def test_pile_of_balls_runs_without_cuts_and_conserves_energy():
    error, _ = run(impacts.pile(DEFAULT))
    assert abs(error) < 1e-10
