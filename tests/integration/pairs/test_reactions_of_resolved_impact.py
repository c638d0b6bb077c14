"""Supports of struck bodies with resolved impact: balances of momenta, force and energy."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models import plane
from helpers.once import once

# Tolerance relative to the largest impulse, moment or work of a step.
BALANCE = 1e-10
DT, STEPS = 0.01, 25


def ends(scene, held):
    """Supports of the sides x = -1 or 1 of the lower block, and a function that moves them."""
    V, back = scene.V, scene.turn.T
    d = len(back)
    bcs, travels = [], []
    for side in held:

        def is_there(x, side=side):
            at = back @ x[:d]
            return np.isclose(at[0], side) & (at[1] < 0.01)

        travel = fem.Function(V)
        bcs.append(fem.dirichletbc(travel, fem.locate_dofs_geometrical(V, is_there)))
        travels.append(travel)

    def drive(t):
        for travel, direction in zip(travels, np.eye(d), strict=False):
            travel.x.array.reshape(-1, d)[:] = 0.1 * np.sin(5 * t) * (direction + 0.5)

    return bcs, drive


def struck(scene, bcs, update, method, mu):
    """Stepper of the lower block with supports, which the upper one strikes."""
    friction = nts.Coulomb(mu) if mu else None
    law = nts.LagrangeMultiplier("resolved")
    pair = nts.ContactPair(scene.nodes, scene.segments, law, friction, method)
    bodies = [scene.lower, scene.upper]
    return nts.EnergyMomentum(bodies, [pair], dt=DT, bcs=bcs, update=update)


def momenta(scene, stepper):
    """Momentum of each block, and its moment about the origin, shape ``(2, 3 + 3)``. Collective."""
    n = len(stepper.node_ids)
    p = np.zeros((n, 3))
    p[:, : len(scene.turn)] = stepper.nodal_momentum()[:, : len(scene.turn)]
    both = np.hstack([p, np.cross(stepper.x[:n], p)])
    sums = [both[body.nodes[body.nodes < n]].sum(axis=0) for body in (scene.lower, scene.upper)]
    return scene.V.mesh.comm.allreduce(np.array(sums))


def in_space(reaction, d):
    """Force and moment of a reaction, shape ``(6,)``."""
    all_ = np.zeros(6)
    all_[:d] = reaction.force
    all_[-len(reaction.moment) :] = reaction.moment
    return all_


@pytest.mark.parametrize(
    ("method", "mu", "held", "depth", "moves"),
    [
        ("node-to-segment", 0.0, (-1,), 0.0, False),
        once("mortar", 0.3, (-1, 1), 0.0, False),
        ("mortar", 0.3, (-1, 1), 0.0, True),
        once("node-to-segment", 0.3, (-1,), 0.0, True),
        once("node-to-segment", 0.3, (-1, 1), 0.4, True),
    ],
)
def test_reactions_and_contact_change_the_momenta(comm, agree, method, mu, held, depth, moves):
    scene = plane.blocks(angle=0.3, width=6, depth=depth, comm=comm)
    bcs, drive = ends(scene, held)
    stepper = struck(scene, bcs, drive if moves else None, method, mu)
    plane.throw(scene, stepper)
    diagnostics, d = nts.Diagnostics(stepper), len(scene.turn)
    before, energy = momenta(scene, stepper), diagnostics.balance().total_energy
    changes, reactions, forces, unaccounted, works, refund = [], [], [], [], [], 0.0
    travels = [bc.g for bc in bcs]
    last = [travel.x.array[:d].copy() for travel in travels]
    for _ in range(STEPS):
        step = stepper.advance()
        after, total = momenta(scene, stepper), diagnostics.balance().total_energy
        force = np.zeros(3)
        force[:d] = diagnostics.contact_force()
        changes.append((after - before) / DT)
        reactions.append(sum(in_space(reaction, d) for reaction in step.reactions))
        forces.append(force)
        given = sum(reaction.work for reaction in step.reactions)
        unaccounted.append(total - energy - sum(step.contact_work) - given)
        now = [travel.x.array[:d].copy() for travel in travels]
        for reaction, a, b in zip(step.reactions, last, now, strict=True):
            works.append((reaction.work, np.array(reaction.force) @ (b - a)))
        refund += abs(step.contact_work.refund)
        before, energy, last = after, total, now
    lower, upper = np.array(changes).transpose(1, 0, 2)
    reactions, forces = np.array(reactions), np.array(forces)
    size = np.abs(reactions).max(axis=0).reshape(2, 3).max(axis=1)
    assert agree(np.abs(forces).max() > 10 and refund > 1e-3)
    assert agree(np.abs(upper[:, :3] - forces).max() <= BALANCE * size[0])
    assert agree(np.abs(lower[:, :3] + forces - reactions[:, :3]).max() <= BALANCE * size[0])
    # Contact has no moment on both together.
    assert agree(np.abs((lower + upper - reactions)[:, 3:]).max() <= BALANCE * size[1])
    assert agree(np.abs(unaccounted).max() <= BALANCE * energy)
    reported, product = np.transpose(works)
    assert agree(np.abs(reported - product).max() <= BALANCE * max(np.abs(reported).max(), energy))
    assert agree((np.abs(reported).max() > 1e-2) == moves)


@pytest.mark.serial
@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
def test_motion_is_galilei_invariant_with_moving_supports(comm, method):
    ends_of_runs = []
    for velocity in np.array([[0.0, 0.0], [3.0, -2.0]]):
        scene = plane.blocks(angle=0.3, width=6, comm=comm)
        bcs, _ = ends(scene, (-1, 1))

        def drive(t, bcs=bcs, velocity=velocity):
            for bc in bcs:
                bc.g.x.array.reshape(-1, 2)[:] = t * velocity

        stepper = struck(scene, bcs, drive, method, 0.3)
        falls = scene.turn @ [0.8, -1.2]
        for body, own in ((scene.lower, 0.0), (scene.upper, falls)):
            stepper.set_velocity(body, velocity + own)
        steps = [stepper.advance() for _ in range(STEPS)]
        assert sum(step.num_active > 0 for step in steps) > 5
        u, v = (f.x.array.reshape(-1, 2) for f in (stepper.u, stepper.v))
        ends_of_runs.append((u - stepper.t * velocity, v - velocity))
    for resting, moving in zip(*ends_of_runs, strict=True):
        assert np.abs(moving - resting).max() <= 1e-8 * np.abs(resting).max()
