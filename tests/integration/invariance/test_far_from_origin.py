"""Scenes far from the origin have the results of those near it, up to digits of positions."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models.plane import blocks
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

DEPTH, TRAVEL, NUM_STEPS, DURATION = 0.08, 0.1, 8, 1.0  # m, m, -, s


def press_and_slide(place, scheme, law, method):
    """Press the upper block down and slide it along.

    Returns displacements ``(n, 2)`` [m], and the contact force of each step [N].
    """
    scene = blocks(place=place)
    V = scene.V
    driven = fem.Constant(V.mesh, np.zeros(2))

    def at(height, value):
        dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], place[1] + height))
        return fem.dirichletbc(value, dofs, V)

    def update(t):
        driven.value[:] = TRAVEL * max(t - 0.5, 0.0), -(0.02 + DEPTH) * min(2 * t, 1.0)

    bcs = [at(-0.5, np.zeros(2)), at(1.02, driven)]
    pair = nts.ContactPair(scene.nodes, scene.segments, law, nts.Coulomb(0.3), method)
    bodies, dt = [scene.lower, scene.upper], DURATION / NUM_STEPS
    stepper = scheme(bodies, [pair], dt=dt, bcs=bcs, update=update)
    diagnostics, forces = nts.Diagnostics(stepper), []
    for _ in stepper.run(until=DURATION):
        forces.append(diagnostics.contact_force())
    return stepper.u.x.array.copy(), np.array(forces)


@pytest.mark.parametrize("size", [once(1e2), 1e4])
@pytest.mark.parametrize("law", [nts.LagrangeMultiplier("plastic"), once(nts.Penalty())], ids=repr)
@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
@pytest.mark.parametrize("scheme", [once(nts.QuasiStatic), nts.EnergyMomentum])
def test_far_scenes_have_the_results_of_near_ones(scheme, method, law, size):
    near, far = (
        press_and_slide(place, scheme, law, method) for place in ((0.0, 0.0), (size, -2 * size))
    )
    assert np.abs(near[1]).max() > 100.0
    # About 50 units of the last digit of positions, amplified by contact.
    digits = 50 * np.finfo(np.float64).eps * 2 * size
    assert np.abs(far[0] - near[0]).max() < digits
    np.testing.assert_allclose(far[1], near[1], rtol=0, atol=100 * digits * np.abs(near[1]).max())
