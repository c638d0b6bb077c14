"""Generated contact cases, and their independent judge."""

import numpy as np
import pytest

from stress.generated import deep_starts, far_steps, leading_edges, sharp_tips
from stress.generated.case import Case, run
from stress.generated.cases import ALL_CASES
from stress.generated.judge import boundary_of_cells, column_force, nodal_mass
from stress.generated.scene import grid
from stress.generated.table import table

pytestmark = pytest.mark.serial

# Reproducible, and another choice with another seed.
SEED, NUMBER = 0, 6


@pytest.mark.parametrize("cases", [deep_starts.CASES, far_steps.CASES], ids=["deep", "far"])
def test_sample_of_cases_is_right_or_refused(cases):
    is_static = [case for case in cases if "dynamics" not in case.kind and "all" not in case.kind]
    chosen = np.random.default_rng(SEED).choice(len(is_static), NUMBER, replace=False)
    for case in (is_static[i] for i in chosen):
        verdict = run(case, SEED)
        assert verdict.end in ("right", "refused"), f"{case.name}: {verdict.message}"


@pytest.mark.parametrize("angle", [105, 150])
@pytest.mark.parametrize("mu", [0.0, 0.5])
def test_edge_that_sank_between_nodes_catches_none_of_them(angle, mu):
    name = f"edge-dynamics-2d-node-to-segment-{angle}-mu{mu}"
    (case,) = (case for case in leading_edges.CASES if case.name == name)
    assert run(case, SEED).message == ""


def test_springs_of_nodes_that_hardly_move_their_gap_do_not_stop_a_block():
    """One was 1e5 times too stiff: the step was refused."""
    (case,) = (c for c in leading_edges.CASES if c.name == "edge-dynamics-3d-default-105-mu0.0")
    assert run(case, SEED).message == ""


@pytest.mark.parametrize("kind", ["statics", "dynamics"])
@pytest.mark.parametrize("side", ["block", "tool"])
@pytest.mark.parametrize("flank", [45, 75])
def test_sharp_tip_is_held_whichever_side_gives_the_nodes(kind, side, flank):
    name = f"tip-{kind}-2d-default-nodes-of-{side}-flank{flank}-n4"
    (case,) = (case for case in sharp_tips.CASES if case.name == name)
    assert run(case, SEED).message == ""


def test_there_are_hundreds_of_cases_with_names_of_their_own():
    names = [case.name for case in ALL_CASES]
    assert len(set(names)) == len(names) >= 500


def test_errors_are_distinguished():
    def raises(rng):
        raise RuntimeError("no")

    assert run(Case("kind", "wrong", lambda rng: "too deep")).end == "silent"
    assert run(Case("kind", "raw", raises)).end == "raw error"
    assert "| kind | 2 | 1 | 0 | 1 | 0 | 0 |" in table([("kind", "right"), ("kind", "silent")])


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("is_cut", [False, True])
def test_depth_and_distance_of_points_in_a_box(dim, is_cut):
    box = grid((0,) * dim, (2, 3, 4)[:dim], (2,) * dim)
    cells = box.simplices() if is_cut else box.cells
    boundary = boundary_of_cells(box.X, cells, np.arange(len(box.X)), 1)
    points = np.random.default_rng(1).uniform(-1, 5, (200, dim))
    to_sides = np.minimum(points, np.array([2, 3, 4])[:dim] - points).min(axis=1)
    depth = boundary.depth(box.X, points)
    assert depth == pytest.approx(np.maximum(to_sides, 0), abs=1e-12)
    outside = np.maximum(np.maximum(-points, points - np.array([2, 3, 4])[:dim]), 0)
    distance = np.where(to_sides > 0, to_sides, np.linalg.norm(outside, axis=1))
    assert boundary.distance(box.X, points) == pytest.approx(distance, abs=1e-12)
    assert nodal_mass(box.X, cells).sum() == pytest.approx((6, 24)[dim - 2])


def test_force_in_a_column_agrees_with_its_energy():
    h, stretch = 1e-6, 1.3
    energy = [0.5 * (s**2 - 1 - 2 * np.log(s)) for s in (stretch + h, stretch - h)]
    assert column_force(stretch, 2.0, 3.0) == pytest.approx(3 * (energy[0] - energy[1]) / (2 * h))
