"""Bodies that touch at the start: round-off of positions decides nothing."""

from dataclasses import replace

import numpy as np
import pytest

import dolfinx_nts as nts
from stress.parts import box
from stress.world import Touch, World

pytestmark = pytest.mark.at_most_two_ranks

STONE = nts.SaintVenantKirchhoff(E=1e7, nu=0.2, rho=2e3)
FLOOR = nts.RigidPlane((0, 0, 0), (0, 0, 1))
HOW = {"friction": nts.Coulomb(0.5)}
# Round-off of positions [m], and no motion, where a free body falls 4e-5 m in a step.
ROUNDING, NONE = 1e-14, 1e-9


def test_blocks_laid_upon_each_other_stay_upright_from_the_first_step(comm, rng):
    parts = {}
    for name, width, height in (("lower", 0.4, 0.0), ("upper", 0.37, 0.2)):
        block = box((width, width, 0.2), (2, 2, 1)).at(-width / 2, -width / 2, height)
        # Gaps of either sign, as positions computed elsewhere have.
        X = block.X + rng.uniform(-ROUNDING, ROUNDING, block.X.shape)
        parts[name] = replace(block.made(STONE), X=X)
    touches = [Touch("lower.bottom", FLOOR, HOW), Touch("upper.bottom", "lower.top", HOW)]
    stepper = World(comm, parts).stepper(touches, 0.02, gravity=(0, 0, -9.81))
    diagnostics = nts.Diagnostics(stepper)

    def centres():
        return np.array([diagnostics.centre_of_mass(body) for body in stepper.bodies])

    start = centres()
    for _ in range(3):
        stepper.advance()
        assert diagnostics.min_gap() > -NONE
        assert np.abs((centres() - start)[:, :2]).max() < NONE


def pressed(comm):
    """Return a stepper of a block that starts 5 mm inside another one, pressed by springs."""
    upper = box((0.3, 0.3, 0.2), (2, 2, 1)).at(-0.15, -0.15, 0.195).made(STONE, (0, 0, -0.1))
    lower = box((0.4, 0.4, 0.2), (2, 2, 1)).at(-0.2, -0.2, 0.0).made(STONE)
    touch = Touch("upper.bottom", "lower.top", {"enforcement": nts.Penalty()})
    return World(comm, {"upper": upper, "lower": lower}).stepper([touch], 1e-4)


def test_springs_of_nodes_without_earlier_segment_have_no_energy(comm):
    stepper = pressed(comm)
    # As for nodes that slide around an edge: they start inside, without a segment before.
    stepper.contacts[0].history.key[:] = -1
    diagnostics = nts.Diagnostics(stepper)

    def energy():
        stored = diagnostics.strain_energy() + diagnostics.contact_energy()
        return diagnostics.kinetic_energy() + stored

    start = energy()
    for _ in range(10):
        stepper.advance()
    assert diagnostics.active_nodes() > 0
    # Springs without offset would store 74 J there.
    assert abs(energy() - start) < 1e-10 * start


def test_springs_separate_bodies_that_were_set_to_overlap(comm):
    """At the start and between steps, as the log says."""
    for number in range(2):
        stepper = pressed(comm)
        upper = stepper.bodies[0]
        if number:
            stepper.set_displacement(upper, (0.0, 0.0, 0.5))
            stepper.advance()
            stepper.set_displacement(upper, (0.0, 0.0, 0.0))
            stepper.set_velocity(upper, (0.0, 0.0, -0.1))
        for _ in range(10):
            stepper.advance()
        diagnostics = nts.Diagnostics(stepper)
        assert diagnostics.active_nodes() > 0
        assert diagnostics.contact_force()[2] > 1e3
        assert diagnostics.body_velocity(upper)[2] > 0.1
