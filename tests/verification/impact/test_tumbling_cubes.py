"""Rigid cubes that tumble in a box: largest penetration at crossing edges."""

import numpy as np
import pytest

import dolfinx_nts as nts
from helpers.models.crossing import deepest, tumbling

pytestmark = pytest.mark.serial

NUM_STEPS = 95


def run(comm, edges):
    """Deepest overlap [m], error of the energy and largest speed of a node [m/s]."""
    stepper = tumbling(comm, edges)
    diagnostics = nts.Diagnostics(stepper)
    start, depth, given, speed = diagnostics.balance().total_energy, 0.0, 0.0, 0.0
    for _ in range(NUM_STEPS):
        x = stepper.x.copy()
        report = stepper.advance()
        given += report.load_work + sum(report.contact_work)
        depth = max(depth, deepest(diagnostics))
        speed = max(speed, np.linalg.norm(stepper.x - x, axis=1).max() / report.dt)
    error = (diagnostics.balance().total_energy - start - given) / start
    return depth, error, speed


def test_tumbling_cubes_overlap_by_half_a_step_at_most_where_edges_touch(comm, table_row):
    depth, _, _ = run(comm, edges=False)
    with_edges, error, speed = run(comm, edges=True)
    assert abs(error) < 1e-10
    assert depth > 0.1
    # Two nodes approach each other by at most twice the speed; half of that per step remains.
    assert with_edges < 0.008 * speed
    table_row(
        "five rigid cubes of 1 m tumble in a box, elastic impact",
        "no overlap",
        f"deepest {100 * with_edges:.1f} cm with edges that touch, {100 * depth:.0f} cm without",
    )
