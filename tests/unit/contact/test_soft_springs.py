"""Springs into which nodes sink deep are told once, others are not."""

import pytest

import dolfinx_nts as nts
from helpers import scenes

pytestmark = pytest.mark.at_most_two_ranks


# Explicit steppers look at them every 50 steps.
@pytest.mark.parametrize(
    ("scheme", "dt"),
    [(nts.EnergyMomentum, scenes.BLOCK_STEP), (nts.CentralDifference, scenes.BLOCK_STEP / 50)],
)
@pytest.mark.parametrize(("eps_N", "warns"), [(None, False), (1e-9, True)])
def test_springs_that_do_not_stop_nodes_are_told_once(comm, caplog, scheme, dt, eps_N, warns):
    old = scenes.blocks(comm).stepper
    pair = nts.ContactPair(old.pairs[0].nodes, old.pairs[0].segments, nts.Penalty(eps_N))
    stepper = scheme(old.bodies, [pair], dt=dt)
    for body in old.bodies:
        stepper.set_velocity(body, old.v)
    depth, limit = 0.0, 0.25 * pair.segment_size
    while stepper.t < 10 * scenes.BLOCK_STEP and depth < 1.4 * limit:
        stepper.advance()
        depth = max(depth, comm.allreduce(-pair.gap(stepper.x).min(initial=0.0), op=scenes.MPI.MAX))
    assert (depth > limit) == warns
    told = [text for text in caplog.messages if "let nodes sink in by" in text]
    assert len(told) == (warns and comm.rank == 0)
    text = "take a stiffer Penalty (contact by Penalty, eps_N = 1e-09 N/m) or a LagrangeMultiplier"
    assert all(text in message for message in told)
