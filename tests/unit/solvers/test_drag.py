"""Resistance of the nodes against leaving a state, in addition to the forces of the bodies."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.solvers.statics.drag import Drag
from helpers.models.plane import blocks

PART = 0.25


def test_force_and_tangent_have_the_resistance_while_it_acts(rng):
    scene = blocks()
    low = fem.locate_dofs_geometrical(scene.V, lambda x: np.isclose(x[1], -0.5))
    held = fem.dirichletbc(np.zeros(2), low, scene.V)
    stepper = nts.QuasiStatic([scene.lower, scene.upper], [], dt=1.0, bcs=[held])
    bulk, tangent = stepper._bulk, stepper._tangent
    n = bulk.num_owned
    stiffness = tangent.nodal_stiffness().copy()[:, None]
    reference, x = 1e-3 * rng.standard_normal((2, n))
    x = x.reshape(-1, 2)
    drag, usual = Drag(bulk, tangent), bulk.action(x)
    free = np.ones(n, dtype=bool)
    free[bulk.is_prescribed] = False
    with drag.acting(PART, reference):
        moved = (bulk.u.x.array[:n] - reference).reshape(-1, 2)
        force = np.where(free, (PART * stiffness * moved).ravel(), 0.0)
        assert drag.force() == pytest.approx(force, rel=1e-12)
        added = np.where(free, (PART * stiffness * x).ravel(), 0.0)
        scale = np.abs(usual).max(initial=0.0)
        assert (bulk.action(x) - usual).ravel() == pytest.approx(added, abs=1e-12 * scale)
        assert tangent.drag == pytest.approx(PART * stiffness)
    assert bulk.action(x) == pytest.approx(usual, abs=1e-14 * scale)
    assert tangent.drag == 0.0
