"""Pairs with the same laws are evaluated together, and nothing else changes."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.contact.joint_state import JointState, joined

# Three balls that touch each other, and one on top of them.
CENTRES = [(0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.1, 0.1735, 0.0), (0.1, 0.0578, 0.1640)]
FLOOR = nts.RigidPlane((0.0, 0.0, -0.101), (0.0, 0.0, 1.0))


def balls(comm, integrator, enforcement, friction=None, far=(), obstacles=(FLOOR,), ball_bcs=()):
    """Stepper of the pile, some balls far away."""

    def build(model):
        for i, (x, y, z) in enumerate(CENTRES):
            shape = {"radius": 0.1, "cells_per_edge": 2, "layers": 1}
            away = 5.0 * i if i in far else 0.0
            parts.add_solid_ball(model, f"ball {i}", centre=(x + away, y, z), **shape)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.NeoHookean(1e5, 0.3, 1e3)
    bodies = [nts.Body(V, cells, tag[f"ball {i}"], rubber) for i in range(len(CENTRES))]
    laws = {"enforcement": enforcement, "friction": friction}
    pairs = nts.all_pairs(bodies, obstacles=obstacles, **laws)
    return integrator(bodies, pairs, dt=0.004)


def states(stepper):
    """What pairs remember, by the names of `ContactHistory`."""
    return [vars(contact.history) for contact in stepper.contacts]


@pytest.mark.parametrize(
    ("integrator", "enforcement"),
    [
        (nts.EnergyMomentum, nts.LagrangeMultiplier()),
        (nts.EnergyMomentum, nts.Penalty()),
        (nts.Midpoint, nts.LagrangeMultiplier("plastic")),
    ],
)
def test_joint_pairs_step_as_each_on_its_own(comm, integrator, enforcement, monkeypatch):
    scene = comm, integrator, enforcement, nts.Coulomb(0.3)
    together = balls(*scene)
    with monkeypatch.context() as patch:
        patch.setattr("dolfinx_nts.integrators.implicit.joined", list)
        alone = balls(*scene)
    kinds = [type(state).__name__ for state in joined(together.contacts)]
    assert kinds == ["JointState", "PairState"]
    touching = 0
    for stepper in (together, alone):
        stepper.set_velocity(stepper.bodies[-1], (0.3, 0.1, -2.0))
        stepper.set_velocity(stepper.bodies[0], (0.5, 0.2, -0.5))
    for _ in range(12):
        report, expected = together.advance(), alone.advance()
        assert report.num_active == expected.num_active
        assert report.newton_iterations == expected.newton_iterations
        assert report.num_segments == expected.num_segments
        np.testing.assert_allclose(report.contact_work, expected.contact_work, atol=1e-10)
        touching = max(touching, report.num_active)
    assert touching > 8
    np.testing.assert_allclose(together.u.x.array, alone.u.x.array, rtol=0, atol=1e-11)
    for one, other in zip(states(together), states(alone), strict=True):
        for name, value in one.items():
            np.testing.assert_allclose(value, other[name], rtol=1e-6, atol=1e-8, err_msg=name)


def test_bodies_out_of_reach_sleep_beside_joint_pairs(comm):
    stepper = balls(comm, nts.EnergyMomentum, nts.LagrangeMultiplier(), far=(2, 3), obstacles=())
    stepper.set_velocity(stepper.bodies[0], (0.5, 0.0, 0.0))
    reports = [stepper.advance() for _ in range(4)]
    assert max(report.num_active for report in reports) > 0
    assert [report.num_sleeping for report in reports][1:] == [2, 2, 2]


@pytest.mark.serial
def test_pairs_with_other_laws_or_ways_to_find_segments_stay_alone(comm):
    stepper = balls(comm, nts.EnergyMomentum, nts.LagrangeMultiplier(), nts.Coulomb(0.3))
    contacts = stepper.contacts
    (joint, floor) = joined(contacts)
    assert isinstance(joint, JointState) and joint.members == contacts[:3]
    assert floor is contacts[3]
    rough = balls(comm, nts.EnergyMomentum, nts.LagrangeMultiplier(), nts.Coulomb(0.4)).contacts
    springs = balls(comm, nts.EnergyMomentum, nts.Penalty(), nts.Coulomb(0.3)).contacts
    ties = balls(comm, nts.EnergyMomentum, nts.Tied(), obstacles=()).contacts
    mixed = [contacts[0], rough[0], springs[0], contacts[1], *ties]
    kept = joined(mixed)
    assert isinstance(kept[0], JointState) and kept[0].members == (contacts[0], contacts[1])
    assert kept[1:] == [rough[0], springs[0], *ties]
