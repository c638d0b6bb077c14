"""Pairs with the same laws are evaluated together, and nothing else changes."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.contact.joint_state import JointState, joint_states
from helpers.laws import NODAL
from helpers.once import once

# Three balls that touch each other, and one on top of them.
CENTRES = [(0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.1, 0.1735, 0.0), (0.1, 0.0578, 0.1640)]
FLOOR = nts.RigidPlane((0.0, 0.0, -0.101), (0.0, 0.0, 1.0))


def balls(comm, integrator, enforcement, friction=None, far=(), obstacles=(FLOOR,)):
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
    pairs = nts.all_pairs(bodies, obstacles=obstacles, **(NODAL | laws))
    return integrator(bodies, pairs, dt=0.004)


def box_in_corner(comm, integrator, enforcement, friction=None):
    """Stepper of a box above a floor and next to a wall, whose lower edge may touch both."""
    boxes = {
        "box": ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (2, 2, 2)),
        "floor": ((-0.5, -0.5, -0.52), (2.0, 2.0, 0.5), (3, 3, 1)),
        "wall": ((-0.518, -0.5, -0.015), (0.5, 2.0, 1.5), (1, 3, 3)),
    }

    def build(model):
        for name, (corner, size, cells) in boxes.items():
            parts.add_box(model, name, corner=corner, size=size, cells=cells)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(1e5, 0.3, 1e3)
    bodies = [nts.Body(V, cells, tag[name], rubber) for name in boxes]
    surfaces = [nts.boundary_of(body) for body in bodies]
    pairs = [
        nts.ContactPair(surfaces[0], other, enforcement, friction, method="node-to-segment")
        for other in surfaces[1:]
    ]
    return integrator(bodies, pairs, dt=0.01)


def states(stepper):
    """Contact history of the pairs, by the names of `ContactHistory`."""
    return [vars(contact.history) for contact in stepper.contacts]


@pytest.mark.parametrize(
    ("integrator", "enforcement"),
    [
        (nts.EnergyMomentum, nts.LagrangeMultiplier()),
        once(nts.EnergyMomentum, nts.Penalty()),
        once(nts.Midpoint, nts.LagrangeMultiplier("plastic")),
    ],
)
def test_joint_pairs_step_as_each_on_its_own(comm, integrator, enforcement, monkeypatch):
    stepper, touching = compare(
        monkeypatch, balls, comm, integrator, enforcement, nts.Coulomb(0.3), moves=(-1, 0)
    )
    kinds = [type(state).__name__ for state in joint_states(stepper.contacts)]
    assert kinds == ["JointState", "PairState"]
    assert touching > 3


@pytest.mark.at_most_two_ranks
def test_nodes_may_touch_in_several_joint_pairs(comm, monkeypatch):
    scene = nts.EnergyMomentum, nts.LagrangeMultiplier()
    stepper, touching = compare(monkeypatch, box_in_corner, comm, *scene, moves=(0,))
    assert [type(state).__name__ for state in joint_states(stepper.contacts)] == ["JointState"]
    assert touching > 9
    assert stepper.statistics.solver.num_direct > 0  # a node with two constraints


def compare(monkeypatch, make, *scene, moves):
    """Run a scene with joint and with single pairs; return the joint run and most active nodes."""
    together = make(*scene)
    with monkeypatch.context() as patch:
        patch.setattr("dolfinx_nts.integrators.implicit.step_solver.joint_states", list)
        alone = make(*scene)
    touching = 0
    for stepper in (together, alone):
        for number in moves:
            stepper.set_velocity(stepper.bodies[number], (-0.9, 0.1, -1.0))
    for _ in range(12):
        report, expected = together.advance(), alone.advance()
        assert report.num_active == expected.num_active
        assert report.newton_iterations == expected.newton_iterations
        assert report.num_segments == expected.num_segments
        np.testing.assert_allclose(report.contact_work, expected.contact_work, atol=1e-9)
        touching = max(touching, report.num_active)
    np.testing.assert_allclose(together.u.x.array, alone.u.x.array, rtol=0, atol=1e-11)
    for one, other in zip(states(together), states(alone), strict=True):
        for name, value in one.items():
            np.testing.assert_allclose(value, other[name], rtol=1e-6, atol=1e-8, err_msg=name)
    return together, touching


@pytest.mark.at_most_two_ranks
def test_bodies_out_of_reach_sleep_with_joint_pairs(comm):
    stepper = balls(comm, nts.EnergyMomentum, nts.LagrangeMultiplier(), far=(2, 3), obstacles=())
    stepper.set_velocity(stepper.bodies[0], (0.5, 0.0, 0.0))
    reports = [stepper.advance() for _ in range(4)]
    assert max(report.num_active for report in reports) > 0
    assert [report.num_sleeping for report in reports][1:] == [2, 2, 2]


@pytest.mark.serial
def test_pairs_with_other_laws_or_searches_are_not_joined(comm):
    stepper = balls(comm, nts.EnergyMomentum, nts.LagrangeMultiplier(), nts.Coulomb(0.3))
    contacts = stepper.contacts
    (joint, floor) = joint_states(contacts)
    assert isinstance(joint, JointState) and joint.members == contacts[:3]
    assert floor is contacts[3]
    rough = balls(comm, nts.EnergyMomentum, nts.LagrangeMultiplier(), nts.Coulomb(0.4)).contacts
    springs = balls(comm, nts.EnergyMomentum, nts.Penalty(), nts.Coulomb(0.3)).contacts
    ties = balls(comm, nts.EnergyMomentum, nts.Tied(), obstacles=()).contacts
    mixed = [contacts[0], rough[0], springs[0], contacts[1], *ties]
    kept = joint_states(mixed)
    assert isinstance(kept[0], JointState) and kept[0].members == (contacts[0], contacts[1])
    assert kept[1:] == [rough[0], springs[0], *ties]
