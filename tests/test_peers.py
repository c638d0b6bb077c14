"""The common evaluation of all codes, and its result for this code."""

import numpy as np
import pytest

from benchmarks.peers import __main__ as peers
from benchmarks.peers import calculix, ours, scene
from benchmarks.peers.hexahedra import LMBDA, MU, Hexahedra
from benchmarks.peers.judge import judge
from benchmarks.peers.scene import RHO, Run
from benchmarks.press import calculix as press_in_calculix
from benchmarks.press import ours as press_by_ours
from benchmarks.press import scene as press
from benchmarks.press.judge import judge as judge_press
from benchmarks.problems import PROBLEMS
from benchmarks.scenes import ELEMENTS, SCHEMES
from reference.bulk import rotation

pytestmark = pytest.mark.serial


@pytest.fixture(scope="module")
def mesh() -> scene.Scene:
    return scene.read()


def test_energy_of_a_turned_homogeneous_strain_agrees_with_the_law(mesh):
    bodies = Hexahedra.of(mesh.X, mesh.plate)
    F = rotation((1, 2, 0), 0.7) @ np.diag([1.1, 0.9, 1.2])
    strain = (F.T @ F - np.eye(3)) / 2
    psi = LMBDA / 2 * np.trace(strain) ** 2 + MU * np.sum(strain**2)
    volume = 4.0 * 4.0 * 0.4
    assert bodies.energy(mesh.X @ F.T) == pytest.approx(psi * volume, rel=1e-12)
    assert bodies.momentum(np.ones_like(mesh.X)).sum(axis=0) == pytest.approx(
        [RHO * volume] * 3, rel=1e-12
    )


def test_forces_and_stiffness_are_derivatives_of_the_energy(mesh, rng):
    bodies = Hexahedra.of(mesh.X, mesh.ball[:3])
    x = mesh.X + 0.02 * rng.normal(size=mesh.X.shape)
    direction = rng.normal(size=x.shape)
    ends = [x + s * 1e-6 * direction for s in (1, -1)]
    slope = (bodies.energy(ends[0]) - bodies.energy(ends[1])) / 2e-6
    assert np.vdot(bodies.forces(x), direction) == pytest.approx(slope, rel=1e-6)
    change = (bodies.forces(ends[0]) - bodies.forces(ends[1])) / 2e-6
    product = np.zeros_like(x)
    local = direction[bodies.cells].reshape(-1, 24, 1)
    np.add.at(product, bodies.cells, (bodies.stiffness(x) @ local).reshape(-1, 8, 3))
    assert np.abs(product - change).max() <= 1e-6 * np.abs(change).max()


def test_rigid_motion_is_judged_as_such_and_a_ball_in_the_plate_is_found(mesh):
    start = mesh.start
    x = np.array([mesh.X, mesh.X + 0.1 * start])
    verdict = judge(mesh, Run(x, np.array([start] * 2), 0.0, 0.0))
    assert abs(verdict.energy_change) <= 1e-14
    assert max(verdict.momentum_error, verdict.angular_momentum_error) <= 1e-14
    # The lowest node was 0.05 above the plate.
    assert verdict.overlap == pytest.approx(0.05, abs=1e-12)
    assert verdict.rebound == pytest.approx(-1.0, rel=1e-12)


@pytest.mark.parametrize("run", [ours.run_implicit, ours.run_full])
def test_impact_conserves_energy_and_momenta_as_judged_by_another_program(mesh, run):
    found = run(mesh)
    verdict = judge(mesh, found)
    assert abs(verdict.energy_change) <= 1e-12
    assert verdict.momentum_error <= 1e-12 and verdict.angular_momentum_error <= 1e-12
    # Active nodes keep the gap of their impact: at most half the approach of a step, also at the
    # speeds of vibrating nodes.
    assert verdict.overlap <= 0.5 * scene.H * np.ptp(found.v[..., 2], axis=1).max()


def test_input_for_calculix_has_all_nodes_cells_and_facets_in_contact(mesh):
    lines = calculix.deck(mesh).splitlines()
    of = {line: i for i, line in enumerate(lines) if line.startswith("*")}
    starts = sorted([*of.values(), len(lines)])

    def count(head: str) -> int:
        begin = next(i for line, i in of.items() if line.startswith(head))
        return starts[starts.index(begin) + 1] - begin - 1

    assert count("*NODE,") == len(mesh.X) and count("*ELEMENT,") == len(mesh.cells)
    assert count("*SURFACE, NAME=OUTER") == len(mesh.outer)
    assert count("*SURFACE, NAME=TOP") == len(mesh.top)


def test_forces_of_the_pressed_and_dragged_block_agree_with_theory(monkeypatch):
    """As judged by another program: Hertz, and Cattaneo and Mindlin in the first step aside."""
    monkeypatch.setattr(press_by_ours, "NUM_STEPS", press.NUM_DOWN + 1)
    pressed = press.read()
    x, _, newton = press_by_ours.run(pressed, "mortar", swapped=False)
    verdict = judge_press(pressed, x)
    assert newton <= 6 * (len(x) - 1)
    assert verdict.balance <= 1e-8
    assert verdict.pressure_error <= 0.01 and verdict.traction_error <= 0.03


def test_input_of_the_press_for_calculix_has_all_facets_in_contact():
    pressed = press.read()
    lines = press_in_calculix.deck(pressed, "MORTAR", swapped=False).splitlines()
    named = sum(", S" in line for line in lines if not line.startswith("*"))
    assert named == len(pressed.outer) + len(pressed.top) - 2
    assert lines.count("*END STEP") == press.NUM_STEPS


def test_the_fine_reference_is_a_problem_of_the_benchmark():
    assert peers.FINE.problem in PROBLEMS and peers.FINE.element in ELEMENTS
    assert peers.FINE.scheme in SCHEMES
