"""Plane strain in two dimensions: the same scripts, with vectors of two components."""

from pathlib import Path

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.plane import blocks, throw

STEPS = 12


def run(scene, stepper, steps=STEPS):
    """Balances of all states of a run, and the reports of its steps."""
    throw(scene, stepper)
    diagnostics = nts.Diagnostics(stepper)
    balances, reports = [diagnostics.balance()], []
    for _ in range(steps):
        reports.append(stepper.advance())
        balances.append(diagnostics.balance())
    return balances, reports


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_oblique_impact_conserves_energy_and_momenta(cell):
    scene = blocks(cell, angle=0.4)
    pair = nts.ContactPair(scene.nodes, scene.segments)
    stepper = nts.EnergyMomentum([scene.lower, scene.upper], [pair], dt=0.01)
    (first, *others), reports = run(scene, stepper)
    assert max(report.num_active for report in reports) > 0
    assert first.linear_momentum.shape == (2,) and first.angular_momentum.shape == (1,)
    for balance in others:
        assert abs(balance.total_energy - first.total_energy) < 1e-10 * first.total_energy
        for name, scale in (("linear_momentum", 1e3), ("angular_momentum", 1e3)):
            change = getattr(balance, name) - getattr(first, name)
            assert np.abs(change).max() < 1e-10 * scale


def test_motion_is_that_of_one_layer_in_space_in_plane_strain():
    # The layer cannot move along z, and is so thin that its forces are a tenth.
    states = []
    for depth in (0.0, 0.1):
        scene = blocks(angle=0.3, depth=depth)
        bcs = []
        if depth:
            z, _ = scene.V.sub(2).collapse()
            dofs = fem.locate_dofs_geometrical(
                (scene.V.sub(2), z), lambda x: np.full(x.shape[1], True)
            )
            bcs = [fem.dirichletbc(fem.Function(z), dofs, scene.V.sub(2))]
        pair = nts.ContactPair(scene.nodes, scene.segments)
        stepper = nts.EnergyMomentum([scene.lower, scene.upper], [pair], dt=0.01, bcs=bcs)
        throw(scene, stepper)
        reports = [stepper.advance() for _ in range(STEPS)]
        assert max(report.num_active for report in reports) > 0
        diagnostics = nts.Diagnostics(stepper)
        balance = diagnostics.balance()
        per_thickness = 1 / (depth or 1.0)
        states.append(
            np.concatenate(
                [
                    diagnostics.centre_of_mass(scene.upper)[:2],
                    diagnostics.body_velocity(scene.lower)[:2],
                    per_thickness * balance.linear_momentum[:2],
                    per_thickness * balance.angular_momentum[-1:],
                    [per_thickness * balance.strain_energy],
                ]
            )
        )
    plane, layer = states
    assert np.abs(plane - layer).max() < 1e-7 * np.abs(plane).max()


@pytest.mark.parametrize(
    ("enforcement", "eps_T"),
    [
        (nts.LagrangeMultiplier(), None),
        (nts.LagrangeMultiplier("plastic"), 1e5),
        (nts.Penalty(), None),
    ],
    ids=["exact stick", "tangential springs", "penalty"],
)
def test_ledger_of_friction_closes(enforcement, eps_T):
    scene = blocks("triangle", angle=-0.7)
    friction = nts.Coulomb(mu=0.3, eps_T=eps_T)
    pair = nts.ContactPair(scene.nodes, scene.segments, enforcement, friction)
    stepper = nts.EnergyMomentum([scene.lower, scene.upper], [pair], dt=0.01)
    balances, reports = run(scene, stepper)
    first, last = balances[0], balances[-1]
    given = sum(sum(report.contact_work) for report in reports)
    size = 1e-10 * first.total_energy
    springs = sum(report.contact_work.springs for report in reports)
    change = last.total_energy - last.contact_energy - first.total_energy
    assert abs(change - given) < size
    assert abs(last.contact_energy + springs) < size
    assert all(report.contact_work.friction <= size for report in reports)
    assert sum(report.contact_work.friction for report in reports) < -1e-3 * first.total_energy
    for name in ("linear_momentum", "angular_momentum"):
        assert np.abs(getattr(last, name) - getattr(first, name)).max() < 1e-7


def held_below(scene):
    """Supports of the bottom of the lower block."""
    dofs = fem.locate_dofs_geometrical(scene.V, lambda x: np.isclose(x[1], -0.5))
    return fem.dirichletbc(np.zeros(2), dofs, scene.V)


@pytest.mark.parametrize("kind", ["Midpoint", "GeneralizedAlpha", "CentralDifference"])
def test_other_schemes_conserve_the_linear_momentum_and_close_their_ledgers(kind):
    scene = blocks("triangle", angle=0.9)
    law = nts.Penalty() if kind == "CentralDifference" else nts.LagrangeMultiplier("plastic")
    pair = nts.ContactPair(scene.nodes, scene.segments, law)
    options = {} if kind == "CentralDifference" else {"dt": 0.01}
    stepper = getattr(nts, kind)([scene.lower, scene.upper], [pair], **options)
    throw(scene, stepper)
    diagnostics = nts.Diagnostics(stepper)
    first, gained, touched = diagnostics.balance(), 0.0, 0
    for report in stepper.run(until=0.1):
        gained += diagnostics.bulk_defect() + sum(report.contact_work) - report.contact_work.springs
        touched = max(touched, report.num_active)
    last = diagnostics.balance()
    change = last.kinetic_energy + last.strain_energy + last.contact_energy - first.total_energy
    assert touched
    assert abs(change - gained) < 1e-9 * first.total_energy
    assert np.abs(last.linear_momentum - first.linear_momentum).max() < 1e-9 * 1e3
    if kind != "GeneralizedAlpha":
        assert np.abs(last.angular_momentum - first.angular_momentum).max() < 1e-9 * 1e3


def test_weight_of_a_block_rests_on_one_that_is_held():
    scene = blocks()
    pair = nts.ContactPair(scene.nodes, scene.segments, friction=nts.Coulomb(mu=0.5))
    weight = nts.Gravity([scene.upper], (0.0, -9.81))
    stepper = nts.QuasiStatic(
        [scene.lower, scene.upper], [pair], dt=1.0, bcs=[held_below(scene)], loads=[weight]
    )
    stepper.set_displacement(scene.upper, (0.0, -0.02))
    stepper.advance()
    force = nts.Diagnostics(stepper).contact_force()
    assert np.abs(force - [0.0, 9.81e3]).max() < 1e-4  # 1 m^2 of 1e3 kg/m^3, a metre thick


def test_circle_and_line_hold_a_block_and_files_tell_of_it(tmp_path):
    scene = blocks("triangle")
    line = nts.RigidPlane((0.0, -0.51), (0.0, 1.0))
    circle = nts.RigidSphere((1.3, 0.3), 0.72)
    bottom = nts.boundary_of(scene.lower)
    side = nts.boundary_of(scene.upper, where=lambda x: x[0] > 0.5)
    pairs = [
        nts.ContactPair(bottom, line),
        nts.ContactPair(side, circle, nts.Penalty()),
        nts.ContactPair(scene.nodes, scene.segments, friction=nts.Coulomb(mu=0.2)),
    ]
    stepper = nts.EnergyMomentum([scene.lower, scene.upper], pairs, dt=0.01)
    throw(scene, stepper)
    stepper.set_velocity(scene.lower, (0.0, -0.5))
    comm = scene.V.mesh.comm
    name = comm.bcast(str(tmp_path / "blocks"))
    active = np.zeros(3, dtype=int)
    with nts.Recorder(name, stepper, every=6, checkpoint_every=6) as record:
        for step in stepper.run(until=0.12):
            record.write(step)
            active += [comm.allreduce(int(c.history.active.sum())) for c in stepper.contacts]
    assert (active > 0).all()
    if comm.rank == 0:
        table = np.genfromtxt(f"{name}.csv", delimiter=",", names=True)
        names = table.dtype.names
        assert {"linear_momentum_x", "linear_momentum_y", "angular_momentum_z"} <= set(names)
        assert "pair_1_torque_z" in names and not any(n.endswith("momentum_z") for n in names[:9])
        size = table["total_energy"][0]
        assert np.abs(table["energy_unaccounted"]).max() < 1e-10 * size
        assert 'TopologyType="Triangle"' in Path(f"{name}.xdmf").read_text()
    again = nts.EnergyMomentum([scene.lower, scene.upper], pairs, dt=0.01)
    with nts.Recorder(name, again, every=6, checkpoint_every=6, resume=True):
        pass
    assert np.array_equal(again.u.x.array, stepper.u.x.array)


def test_bodies_inside_each_other_are_found():
    scene = blocks(angle=0.2)
    stepper = nts.EnergyMomentum([scene.lower, scene.upper], dt=0.01)
    stepper.set_displacement(scene.upper, scene.turn @ [0.013, -0.07])
    (overlap,) = nts.Diagnostics(stepper).overlaps()
    assert abs(overlap.depth - 0.05) < 1e-9
    assert overlap.nodes == 8  # four of either


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"method": "mortar"}, "method 'node-to-segment'"),
        ({"enforcement": nts.LagrangeMultiplier("resolved")}, "'elastic' or 'plastic'"),
        ({"segments": nts.RigidPlane((0, 0, 0), (0, 0, 1))}, "points of 2 coordinates"),
        (
            {"enforcement": nts.Penalty(), "friction": nts.Coulomb(mu=0.1, law="convective")},
            "law 'objective'",
        ),
    ],
    ids=["mortar", "resolved impact", "obstacle in space", "convective friction"],
)
def test_what_two_dimensions_cannot_do_is_refused(changes, message):
    scene = blocks()
    arguments = {"nodes": scene.nodes, "segments": scene.segments} | changes
    with pytest.raises(ValueError, match=message):
        nts.ContactPair(**arguments)
