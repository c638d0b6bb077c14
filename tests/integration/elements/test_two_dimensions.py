"""Plane strain in two dimensions: the same scripts, with vectors of two components."""

from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.laws import NODAL
from helpers.models.plane import RUBBER, blocks, throw
from helpers.once import once
from helpers.readers import read_grids

pytestmark = pytest.mark.at_most_two_ranks

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


@pytest.mark.parametrize(
    # All pairs of the three parameters.
    ("cell", "degree", "method", "impact"),
    [
        once("quadrilateral", 1, "node-to-segment", "elastic"),
        ("triangle", 1, "mortar", "elastic"),
        once("quadrilateral", 2, "mortar", "elastic"),
        ("triangle", 2, "node-to-segment", "elastic"),
        ("triangle", 1, "node-to-segment", "resolved"),
        once("quadrilateral", 1, "mortar", "resolved"),
        once("triangle", 2, "mortar", "resolved"),
        once("quadrilateral", 2, "node-to-segment", "resolved"),
    ],
)
def test_oblique_impact_conserves_energy_and_momenta(cell, degree, method, impact):
    scene = blocks(cell, angle=0.4, degree=degree)
    law = nts.LagrangeMultiplier(impact)
    pair = nts.ContactPair(scene.nodes, scene.segments, law, method=method)
    stepper = nts.EnergyMomentum([scene.lower, scene.upper], [pair], dt=0.01)
    (first, *others), reports = run(scene, stepper)
    assert max(report.num_active for report in reports) > 0
    assert first.linear_momentum.shape == (2,) and first.angular_momentum.shape == (1,)
    for balance in others:
        assert abs(balance.total_energy - first.total_energy) < 1e-10 * first.total_energy
        for name, scale in (("linear_momentum", 1e3), ("angular_momentum", 1e3)):
            change = getattr(balance, name) - getattr(first, name)
            assert np.abs(change).max() < 1e-10 * scale


@pytest.mark.serial
@pytest.mark.parametrize("impact", ["elastic", "resolved"])
@pytest.mark.parametrize("method", ["node-to-segment", "mortar"])
def test_motion_agrees_with_one_layer_in_space_in_plane_strain(method, impact):
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
        law = nts.LagrangeMultiplier(impact)
        pair = nts.ContactPair(scene.nodes, scene.segments, law, method=method)
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
    ("enforcement", "eps_T", "method"),
    [
        (nts.LagrangeMultiplier(), None, "node-to-segment"),
        once(nts.LagrangeMultiplier("plastic"), 1e5, "node-to-segment"),
        once(nts.LagrangeMultiplier("restitution", e=0.5), None, "node-to-segment"),
        once(nts.LagrangeMultiplier("resolved"), None, "node-to-segment"),
        once(nts.Penalty(), None, "node-to-segment"),
        once(nts.LagrangeMultiplier(), None, "mortar"),
        (nts.LagrangeMultiplier("plastic"), 1e5, "mortar"),
        once(nts.Penalty(), None, "mortar"),
    ],
    ids=[
        *("exact stick", "tangential springs", "restitution", "resolved", "penalty"),
        *("mortar, exact stick", "mortar, tangential springs", "mortar, penalty"),
    ],
)
def test_ledger_of_friction_closes(enforcement, eps_T, method):
    scene = blocks("triangle", angle=-0.7)
    friction = nts.Coulomb(mu=0.3, eps_T=eps_T)
    pair = nts.ContactPair(scene.nodes, scene.segments, enforcement, friction, method)
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


@pytest.mark.parametrize(
    ("kind", "degree", "method"),
    [
        once("Midpoint", 1, "node-to-segment"),
        once("Midpoint", 1, "mortar"),
        once("GeneralizedAlpha", 1, "node-to-segment"),
        ("GeneralizedAlpha", 1, "mortar"),
        once("CentralDifference", 1, "node-to-segment"),
        ("CentralDifference", 2, "node-to-segment"),
    ],
)
def test_other_schemes_conserve_the_linear_momentum_and_close_their_ledgers(kind, degree, method):
    scene = blocks("triangle", angle=0.9, degree=degree)
    law = nts.Penalty() if kind == "CentralDifference" else nts.LagrangeMultiplier("plastic")
    pair = nts.ContactPair(scene.nodes, scene.segments, law, method=method)
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
    pair = nts.ContactPair(
        scene.nodes,
        scene.segments,
        friction=nts.Coulomb(mu=0.5),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    weight = nts.Gravity([scene.upper], (0.0, -9.81))
    stepper = nts.QuasiStatic(
        [scene.lower, scene.upper], [pair], dt=1.0, bcs=[held_below(scene)], loads=[weight]
    )
    stepper.set_displacement(scene.upper, (0.0, -0.02))
    (reaction,) = stepper.advance().reactions
    diagnostics, weight = nts.Diagnostics(stepper), [0.0, 9.81e3]  # 1 m^2 of 1e3 kg/m^3
    moment = weight[1] * diagnostics.centre_of_mass(scene.upper)[0]
    (of_pair,) = diagnostics.pairs().values()
    for force, turning in (
        (of_pair.force, of_pair.torque),
        (reaction.force, reaction.moment),
    ):
        assert np.abs(np.subtract(force, weight)).max() < 1e-4
        assert np.abs(np.subtract(turning, [moment])).max() < 1e-4


def test_a_moving_circle_balances_energy_and_momenta():
    velocity, spin, centre = np.array([0.3, -0.7]), 4.0, np.array([0.1, 1.53])
    scene = blocks("triangle")
    motion = nts.Motion(lambda t: velocity * t, lambda t: spin * t, centre=centre)
    circle = nts.RigidSphere(centre, 0.5).moving(motion)
    top = nts.boundary_of(scene.upper, where=lambda x: x[1] > 0.9)
    pair = nts.ContactPair(
        top,
        circle,
        friction=nts.Coulomb(mu=0.3),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    stepper = nts.EnergyMomentum([scene.lower, scene.upper], [pair], dt=0.01)
    diagnostics = nts.Diagnostics(stepper)
    first, work, reported, lost, impulses = diagnostics.balance(), 0.0, 0.0, 0.0, np.zeros(3)
    for step in stepper.run(until=0.2):
        (on,) = diagnostics.obstacles().values()
        (torque,) = on.torque
        middle = centre + (step.t - step.dt / 2) * velocity
        about_origin = torque + middle[0] * on.force[1] - middle[1] * on.force[0]
        impulses += step.dt * np.array([*on.force, about_origin])
        # About a fixed axis the torque does its work on twice the tangent of half the angle.
        work -= step.dt * on.force @ velocity + torque * 2 * np.tan(spin * step.dt / 2)
        reported += step.contact_work.obstacles
        lost += sum(step.contact_work) - step.contact_work.obstacles
    last = diagnostics.balance()
    assert work > 10 and lost < -1
    assert abs(reported - work) < 1e-9 * work
    assert abs(last.total_energy - first.total_energy - work - lost) < 1e-9 * work
    for name, impulse in zip(
        ("linear_momentum", "angular_momentum"), (impulses[:2], impulses[2:]), strict=True
    ):
        gained = getattr(last, name) - getattr(first, name)
        assert np.abs(gained + impulse).max() < 1e-9 * np.abs(impulses).max()


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        once(nts.Motion(lambda t: (0.0, 0.0, t)), "two finite numbers for a translation"),
        once(nts.Motion(rotation=lambda t: (t, 0.0, 0.0)), "an angle, or a rotation about z"),
        (nts.Motion(rotation=lambda t: np.diag([1.0, -1.0, -1.0])), "a rotation about z"),
    ],
    ids=["translation", "vector", "matrix"],
)
def test_motions_out_of_the_plane_are_refused(motion, message):
    scene = blocks()
    line = nts.RigidPlane((0.0, 1.5), (0.0, -1.0)).moving(motion)
    pair = nts.ContactPair(
        nts.boundary_of(scene.upper),
        line,
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    stepper = nts.EnergyMomentum([scene.lower, scene.upper], [pair], dt=0.01)
    with pytest.raises(ValueError, match=message):
        stepper.advance()
    assert stepper.step == 0


@pytest.mark.parametrize(
    ("cell", "degree"), [once("quadrilateral", 1), ("triangle", 1), once("quadrilateral", 2)]
)
def test_stress_agrees_with_plane_strain(cell, degree):
    scene, stretch = blocks(cell, degree=degree), 1.2
    bodies = [scene.lower, scene.upper]
    stepper = nts.EnergyMomentum(bodies, dt=0.01)
    for body in bodies:
        stepper.set_displacement(body, lambda x: np.array([(stretch - 1) * x[0], 0 * x[0]]))
    E, nu = RUBBER["E"], RUBBER["nu"]
    lmbda, mu = E * nu / (1 + nu) / (1 - 2 * nu), E / 2 / (1 + nu)
    strain = (stretch**2 - 1) / 2
    expected = np.diag([stretch**2 * (lmbda + 2 * mu), lmbda, lmbda]) * strain / stretch
    fields = nts.Fields(stepper)
    stress = fields.cauchy_stress().x.array.reshape(-1, 3, 3)
    assert np.abs(stress - expected).max() < 1e-10 * expected.max()
    density = fields.strain_energy_density().x.array
    assert np.abs(density - (lmbda / 2 + mu) * strain**2).max() < 1e-10 * E


@pytest.mark.parametrize(("degree", "method"), [(1, "mortar"), (2, "node-to-segment")])
def test_circle_and_line_hold_a_block_and_files_record_it(tmp_path, degree, method):
    scene = blocks("triangle", degree=degree)
    rising = nts.Motion(lambda t: (0.0, 0.05 * t))
    line = nts.RigidPlane((0.0, -0.51), (0.0, 1.0)).moving(rising)
    circle = nts.RigidSphere((1.3, 0.3), 0.72)
    bottom = nts.boundary_of(scene.lower)
    side = nts.boundary_of(scene.upper, where=lambda x: x[0] > 0.5)
    pairs = [
        nts.ContactPair(
            bottom, line, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        ),
        nts.ContactPair(side, circle, nts.Penalty(), method="node-to-segment"),
        nts.ContactPair(scene.nodes, scene.segments, None, nts.Coulomb(mu=0.2), method),
    ]
    bodies = [scene.lower, scene.upper]
    end = fem.locate_dofs_geometrical(scene.V, lambda x: np.isclose(x[0], -1.0))
    supports = {"bcs": [fem.dirichletbc(np.zeros(2), end, scene.V)]}
    loads = {"loads": [nts.Gravity(bodies, (0.0, -9.81))]}
    stepper = nts.EnergyMomentum(bodies, pairs, dt=0.01, **supports, **loads)
    throw(scene, stepper)
    stepper.set_velocity(scene.lower, lambda x: np.array([0 * x[0], -0.5 * (x[0] > -0.99)]))
    comm = scene.V.mesh.comm
    name = comm.bcast(str(tmp_path / "blocks"))
    active = np.zeros(3, dtype=int)
    options = {
        "every": 6,
        "checkpoint_every": 6,
        "columns_of": ("pairs", "obstacles", "supports", "loads", "bodies"),
        "stress": True,
        "own_columns": {"tip": lambda stepper: (1.0, 2.0)},
        "own_fields": {
            "twice": lambda stepper: 2 * stepper.x[: len(stepper.node_ids), :2],
            "place": lambda stepper: stepper.x[: len(stepper.node_ids)],
        },
    }
    with nts.Recorder(name, stepper, **options) as record:
        for step in stepper.run(until=0.12):
            record.write(step)
            active += [comm.allreduce(int(c.history.active.sum())) for c in stepper.contacts]
    assert (active > 0).all()
    if comm.rank == 0:
        table = np.genfromtxt(f"{name}.csv", delimiter=",", names=True)
        names = table.dtype.names
        assert {"linear_momentum_x", "linear_momentum_y", "angular_momentum_z"} <= set(names)
        vectors = {part for part in names if part.endswith(("_x", "_y", "_z"))}
        turning = {part for part in vectors if part.endswith("_z")}
        assert all(part[:-2].endswith(("angular_momentum", "torque", "moment")) for part in turning)
        # The whole, two bodies, three pairs, two obstacles and a support.
        assert len(turning) == 1 + 2 + 3 + 2 + 1 and "tip_y" in vectors
        size = table["total_energy"][0]
        assert np.abs(table["energy_unaccounted"]).max() < 1e-10 * size
        _, grids = read_grids(Path(f"{name}.vtkhdf"))
        assert set(grids[-1].celltypes) == {5} and "displacement" in grids[-1].point_data
    again = nts.EnergyMomentum(bodies, pairs, dt=0.01, **supports, **loads)
    with nts.Recorder(name, again, **options, resume=True):
        pass
    assert np.array_equal(again.u.x.array, stepper.u.x.array)
    static = nts.QuasiStatic(bodies, pairs, dt=0.01, **supports)
    dropped = nts.load_state(f"{name}.checkpoint.h5", static)
    assert "velocities, which QuasiStatic does not have" in dropped
    assert np.array_equal(static.u.x.array, stepper.u.x.array) and not static.v.x.array.any()
    for one in (stepper, again):
        one.advance()
    assert np.array_equal(again.u.x.array, stepper.u.x.array)


def ring():
    """A soft ring of triangles, outer radius 1 m, wall 0.06 m."""

    def build(model):
        whole, hole = (model.occ.addDisk(0, 0, 0, r, r) for r in (1.0, 0.94))
        model.occ.cut([(2, whole)], [(2, hole)])
        model.occ.synchronize()
        model.addPhysicalGroup(2, [whole], name="ring")
        model.mesh.setSize(model.getEntities(0), 0.06)
        model.mesh.generate(2)

    data = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(data.mesh, ("Lagrange", 1, (2,)))
    return nts.Body(V, data.cells, data.tag["ring"], nts.NeoHookean(**RUBBER))


@pytest.mark.parametrize(
    ("enforcement", "friction"),
    [
        once(nts.LagrangeMultiplier(), None),
        (nts.LagrangeMultiplier("plastic"), nts.Coulomb(mu=0.3)),
        once(nts.Penalty(), nts.Coulomb(mu=0.3)),
    ],
    ids=["elastic", "plastic, friction", "penalty, friction"],
)
def test_a_ring_in_self_contact_conserves_its_invariants(enforcement, friction):
    body = ring()
    pairs = nts.all_pairs(
        [body],
        self_contact=[body],
        enforcement=enforcement,
        friction=friction,
        method="node-to-segment",
    )
    stepper = nts.EnergyMomentum([body], pairs, dt=0.005)
    # Top and bottom fly towards each other.
    stepper.set_velocity(body, lambda x: np.array([0.7 + 0.4 * x[1], 0.3 * x[0] - 2.2 * x[1]]))
    diagnostics = nts.Diagnostics(stepper)
    first, given, most = diagnostics.balance(), 0.0, 0
    for step in stepper.run(until=0.7):
        given += sum(step.contact_work) - step.contact_work.springs
        most = max(most, step.num_active)
    last, size = diagnostics.balance(), 1e-10 * first.total_energy
    assert most > 3 and diagnostics.min_gap() > -0.01
    assert abs(last.total_energy - first.total_energy - given) < size
    assert abs(given) < size if friction is None else given < -1e-3 * first.total_energy
    for name in ("linear_momentum", "angular_momentum"):
        change = getattr(last, name) - getattr(first, name)
        assert np.abs(change).max() < 1e-10 * 1e3


def test_bodies_inside_each_other_are_found():
    scene = blocks(angle=0.2)
    stepper = nts.EnergyMomentum([scene.lower, scene.upper], dt=0.01)
    stepper.set_displacement(scene.upper, scene.turn @ [0.013, -0.07])
    (overlap,) = nts.Diagnostics(stepper).overlaps()
    assert abs(overlap.depth - 0.05) < 1e-9
    assert overlap.nodes == 8  # four of either
    walls = stepper.watch.overlaps.search.thickness
    assert np.abs(walls - [0.5, 1.0]).max() < 1e-5


@pytest.mark.serial
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"segments": nts.RigidPlane((0, 0, 0), (0, 0, 1))}, "points of 2 coordinates"),
        (
            {"enforcement": nts.Penalty(), "friction": nts.Coulomb(mu=0.1, law="convective")},
            "law 'objective'",
        ),
    ],
    ids=["obstacle in space", "convective friction"],
)
def test_unsupported_plane_features_are_refused(changes, message):
    scene = blocks()
    arguments = {"nodes": scene.nodes, "segments": scene.segments} | changes
    with pytest.raises(ValueError, match=message):
        nts.ContactPair(**(NODAL | arguments))
