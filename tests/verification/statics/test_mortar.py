"""Surface-to-surface contact: exact patch test, energy and momenta, both sides alike."""

from functools import cache, partial

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from helpers import scenes
from helpers.models import box_meshes
from helpers.models.compressed_blocks import compress
from helpers.models.homogeneous_blocks import deform
from helpers.scene import History, Scene
from reference.bulk import rotation

pytestmark = pytest.mark.serial

MORTAR = partial(nts.ContactPair, method="mortar", enforcement=nts.LagrangeMultiplier())
# Spread of stress and pressure that counts as zero, relative.
EXACT = 1e-9


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("cells", [(4, 6), (6, 4)])
def test_patch_test_is_passed_whichever_side_is_finer(cell, cells, degree, table_row):
    blocks = compress(*cells, MORTAR, cell=cell, degree=degree)
    pressure = blocks.stepper.contacts[0].pressure
    table_row(
        f"patch test, {cell}, {cells[0]}:{cells[1]} cells" + degree // 2 * ", degree 2",
        "uniform stress and pressure",
        f"spread {np.ptp(blocks.stress):.0e}, {np.ptp(pressure) / pressure.mean():.0e}",
    )
    assert np.ptp(blocks.stress) <= EXACT
    assert np.ptp(pressure) <= EXACT * pressure.mean()
    # The difference between the two stress measures is of the size of the strain.
    assert abs(blocks.stress.mean() - 1) <= 1e-4
    assert pressure.mean() == pytest.approx(blocks.mean_pressure, rel=1e-3)


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("cells", [(4, 6), (6, 4)])
def test_patch_test_is_passed_by_smooth_surfaces(cell, cells, table_row):
    """Patches have the mean of their facets, and therefore the same load."""
    blocks = compress(*cells, MORTAR, cell=cell, smooth=True)
    pressure = blocks.stepper.contacts[0].pressure
    table_row(
        f"patch test, {cell}, {cells[0]}:{cells[1]} cells, smooth surfaces",
        "uniform stress and pressure",
        f"spread {np.ptp(blocks.stress):.0e}, {np.ptp(pressure) / pressure.mean():.0e}",
    )
    assert np.ptp(blocks.stress) <= EXACT
    assert np.ptp(pressure) <= EXACT * pressure.mean()


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize(("cells", "degree"), [((8, 12), 1), ((5, 4), 1), ((3, 4), 2)])
def test_patch_test_is_passed_on_a_slope_in_any_position(cell, cells, degree):
    """All sides are pressed alike, so that nothing slides down."""
    Q = rotation([1.0, 2.0, -0.5], 0.7)
    stepper, error, _ = deform(cells, 0.99 * np.eye(3), cell=cell, slope=0.3, Q=Q, degree=degree)
    (contact,) = stepper.contacts
    pressure = contact.pressure
    assert error <= EXACT * 0.01
    assert np.ptp(pressure) <= EXACT * pressure.mean()


@pytest.mark.parametrize("smooth", [False, True])
def test_patch_test_is_nearly_passed_on_facets_that_are_no_parallelograms(smooth, table_row):
    blocks = compress(6, 4, MORTAR, swirl=0.5, smooth=smooth)
    error = np.abs(blocks.stress - blocks.stress.mean()).max()
    table_row(
        "the same, facets that are no parallelograms" + smooth * ", smooth surfaces",
        "uniform stress",
        f"largest error {error:.0e}",
    )
    assert error <= 2e-3


def test_blocks_that_are_compressed_in_large_steps_still_pass():
    """Contact points are updated until they belong to the equilibrium."""
    blocks = compress(4, 6, MORTAR, compression=0.05)
    assert np.ptp(blocks.stress) <= 1e-7


def test_patch_test_by_springs_is_passed_but_for_their_compliance():
    """Springs of nodes, not of areas: their differences vanish as they become stiff."""
    spreads = []
    for stiffness in (10.0, 1e3):
        pairs = partial(MORTAR, enforcement=nts.Penalty(stiffness))
        spreads.append(np.ptp(compress(4, 6, pairs, compression=0.01).stress))
    assert spreads[1] <= 1e-3
    assert spreads[0] == pytest.approx(100 * spreads[1], rel=0.2)


@cache
def impact(method: str) -> tuple[Scene, History]:
    """Throw the hollow ball against the plate."""
    scene = scenes.ball_plate(MPI.COMM_WORLD, method=method)
    return scene, scene.run(40)


def test_impact_conserves_energy_and_momenta_to_round_off(table_row):
    _, history = impact("mortar")
    table_row(
        "ball on plate",
        "energy and momenta are conserved",
        f"{history.energy_error:.0e}, {max(history.linear_drift, history.angular_drift):.0e}",
    )
    assert max(history.num_active) >= 9
    assert history.energy_error <= 1e-12
    assert max(history.linear_drift, history.angular_drift) <= 1e-12
    assert np.mean(history.iterations) <= 4.5
    assert max(history.iterations) <= 8


def test_impact_agrees_with_nodes_and_segments_but_for_the_mesh():
    (_, mortar), (_, nodes) = impact("mortar"), impact("node-to-segment")
    assert mortar.kinetic[-1] == pytest.approx(nodes.kinetic[-1], rel=5e-3)
    assert not np.allclose(mortar.kinetic, nodes.kinetic, rtol=1e-6)


def test_linear_solver_needs_no_whole_systems_and_few_more_iterations():
    (mortar, _), (nodes, _) = impact("mortar"), impact("node-to-segment")
    solvers = [scene.stepper.statistics.solver for scene in (mortar, nodes)]
    assert solvers[0].num_direct == 0
    assert solvers[0].num_iterations <= 1.3 * solvers[1].num_iterations


@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.GeneralizedAlpha])
def test_plastic_impact_loses_energy_only_where_nodes_arrive(scheme):
    scene = scenes.ball_plate(
        MPI.COMM_WORLD, scheme, nts.LagrangeMultiplier("plastic"), method="mortar"
    )
    history, works = scene.run(40), [0.0, 0.0]
    for report in history.reports:
        works[0] += report.contact_work.activation
        works[1] += report.contact_work.persistent
    assert history.linear_drift <= 1e-12
    if scheme is nts.EnergyMomentum:
        assert history.angular_drift <= 1e-12
        lost = history.energy[-1] - history.energy[0]
        assert -0.01 * history.energy[0] < works[0] < 0
        assert lost == pytest.approx(works[0], rel=1e-9)
        assert abs(works[1]) <= 1e-9 * history.energy[0]


@cache
def tilted_impact(method: str, swapped: bool, tilt: float) -> tuple[float, float]:
    """Change of the velocity of a tilted block that falls on another; error of the energy."""
    data = box_meshes.boxes([(4, 4, 2), (6, 6, 3)], [(1, 1, 0.5), (0.8, 0.8, 0.6)])
    upper = np.unique(data.cells[data.body == 1])
    middle = np.array([0.4, 0.4, 0.3])
    turned = (data.X[upper] - middle) @ rotation([1, 0.3, 0], tilt).T
    data.X[upper] = turned + middle + [0.1, 0.05, 0.0]
    data.X[upper, 2] += 0.51 - data.X[upper, 2].min()
    mesh, cells, facets, tag = box_meshes.distribute(MPI.COMM_WORLD, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.SaintVenantKirchhoff(1e5, 0.3, 1000.0, one_point=())
    bodies = [nts.Body(V, cells, tag[f"body {number}"], material) for number in (0, 1)]
    sides = [nts.Surface(V, facets, tag[name]) for name in ("bottom 1", "top 0")]
    pair = nts.ContactPair(
        *(sides[::-1] if swapped else sides), method=method, enforcement=nts.LagrangeMultiplier()
    )
    stepper = nts.EnergyMomentum(bodies, [pair], dt=0.005)
    stepper.set_velocity(bodies[1], (0.3, 0.1, -1.0))
    diagnostics = nts.Diagnostics(stepper)
    before, energy = diagnostics.body_velocity(bodies[1])[2], diagnostics.balance().total_energy
    for _ in range(80):
        assert stepper.advance().newton_iterations <= 8 or method != "mortar"
    assert stepper.statistics.solver.num_direct == 0
    error = abs(diagnostics.balance().total_energy / energy - 1)
    return diagnostics.body_velocity(bodies[1])[2] - before, error


def test_impulse_hardly_depends_on_which_side_has_the_nodes(table_row):
    """In steps that resolve a cell; in longer ones chance decides which nodes touch first."""
    changes = []
    for method, tilt in (("mortar", 0.12), ("mortar", 0.2), ("node-to-segment", 0.12)):
        one, other = (tilted_impact(method, swapped, tilt) for swapped in (False, True))
        assert max(one[1], other[1]) <= 1e-11 or method != "mortar"
        changes.append(100 * abs(other[0] / one[0] - 1))
    assert max(changes[:2]) <= 1
    assert changes[2] >= 2
    table_row(
        "impact of a tilted block, sides exchanged",
        "the same impulse",
        f"{changes[0]:.1f} and {changes[1]:.1f} %, by nodes and segments {changes[2]:.1f} %",
    )


def test_facets_passing_through_a_surface_in_one_step_are_reported():
    scene = scenes.ball_plate(MPI.COMM_WORLD, method="mortar", dt=0.05)
    scene.stepper.set_velocity(scene.bodies["ball"], (0.0, 0.0, -200.0))
    with pytest.raises(nts.ConvergenceError):
        for _ in range(4):
            scene.stepper.advance()


def test_rubber_of_tetrahedra_that_collides_and_parts_conserves_everything():
    """Bodies of neo-Hooke's material, until long after their release."""
    old = scenes.blocks(MPI.COMM_WORLD, cell="tetrahedron").stepper
    material = nts.NeoHookean(*scenes.BLOCK_RUBBER)
    bodies = [scenes.of_material(body, material) for body in old.bodies]
    (pair,) = old.pairs
    stepper = nts.EnergyMomentum(bodies, [MORTAR(pair.nodes, pair.segments)], dt=old.dt)
    stepper.v.x.array[:] = old.v.x.array
    diagnostics = nts.Diagnostics(stepper)
    start, active = diagnostics.balance(), []
    for report in stepper.run(2.0):
        now = diagnostics.balance()
        assert now.total_energy == pytest.approx(start.total_energy, rel=1e-10)
        for name in ("linear_momentum", "angular_momentum"):
            before = getattr(start, name)
            change = np.linalg.norm(getattr(now, name) - before)
            assert change <= 1e-11 * np.linalg.norm(before)
        active.append(report.num_active)
    assert max(active) >= 5
    assert max(active[len(active) // 2 :]) == 0


def test_steps_that_are_too_long_are_cut_and_the_run_goes_on():
    """Nearly as fast as waves: facets turn so far that points lie outside oblique segments."""
    scene = scenes.ball_plate(MPI.COMM_WORLD, method="mortar", dt=0.02)
    scene.stepper.set_velocity(scene.bodies["ball"], (0.0, 8.0, -8.0))
    diagnostics = nts.Diagnostics(scene.stepper)
    energy = diagnostics.balance().total_energy
    reports = list(scene.stepper.run(0.032, nts.StepControl()))
    assert sum(report.rejected for report in reports) >= 1
    assert max(report.num_active for report in reports) >= 9
    assert diagnostics.balance().total_energy == pytest.approx(energy, rel=1e-11)


def sliding_bulge(comm: MPI.Comm) -> tuple[nts.EnergyMomentum, nts.Diagnostics]:
    """Throw a coarse block with a bulging bottom on a plate, and let it slide over the rim.

    The node in the middle touches first; the facets around it rise, so that their outer nodes
    pass the rim high above it.
    """
    data = box_meshes.boxes([(4, 4, 2), (2, 2, 2)], [(1, 1, 0.5), (0.8, 0.8, 0.4)])
    upper = np.unique(data.cells[data.body == 1])
    X = data.X[upper]
    X[:, 2] += 0.5 * ((X[:, :2] - 0.4) ** 2).sum(axis=1) * (1 - X[:, 2] / 0.4)
    data.X[upper] = X + np.array([0.15, 0.1, 0.503])
    mesh, cells, facets, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    material = nts.SaintVenantKirchhoff(1e5, 0.3, 1000.0, one_point=())
    bodies = [nts.Body(V, cells, tag[f"body {number}"], material) for number in (0, 1)]
    pair = MORTAR(*(nts.Surface(V, facets, tag[name]) for name in ("bottom 1", "top 0")))
    stepper = nts.EnergyMomentum(bodies, [pair], dt=0.005)
    stepper.set_velocity(bodies[1], (2.0, 0.0, -0.5))
    return stepper, nts.Diagnostics(stepper)


def test_a_touching_node_does_not_sink_in_as_its_facets_slide_over_a_rim(table_row):
    """By overlaps of the bodies, independent of the contact pairs."""
    stepper, diagnostics = sliding_bulge(MPI.COMM_WORLD)
    energy, depth, active = diagnostics.balance().total_energy, 0.0, 0
    for _ in range(30):
        active += stepper.advance().num_active > 0
        depths = [max(found.depth, found.reverse_depth) for found in diagnostics.overlaps()]
        depth = max(depth, *depths, 0.0)
    travel = 0.5 * stepper.dt
    table_row(
        "coarse bulge that slides over the rim of a plate",
        "penetrates by a few increments of a step, 2.5 mm",
        f"{1e3 * depth:.1f} mm, energy {abs(diagnostics.balance().total_energy / energy - 1):.0e}",
    )
    assert active >= 15
    assert depth <= 3 * travel
    assert diagnostics.balance().total_energy == pytest.approx(energy, rel=1e-10)


@pytest.mark.parametrize("exchange", [True, False])
def test_walls_beside_a_roller_across_a_plate_carry_no_pressure(exchange):
    comm = MPI.COMM_WORLD

    def build(model):
        plate = model.occ.addBox(0, 0, 0, 2, 1, 0.5)
        roller = model.occ.addCylinder(0.5, -0.1, 0.81, 0, 1.2, 0, 0.3)
        model.occ.synchronize()
        model.addPhysicalGroup(3, [plate], name="plate")
        model.addPhysicalGroup(3, [roller], name="roller")
        model.mesh.setSize(model.getEntities(0), 0.2)
        model.mesh.generate(3)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber, steel = nts.NeoHookean(1e6, 0.4, 1e3), nts.NeoHookean(1e8, 0.3, 1e3)
    bodies = [nts.Body(V, cells, tag["plate"], rubber), nts.Body(V, cells, tag["roller"], steel)]
    down = fem.Constant(mesh, np.zeros(3))
    bottom, top = (
        fem.locate_dofs_geometrical(V, lambda x, part=part: part(x[2]))
        for part in (lambda z: np.isclose(z, 0.0), lambda z: z > 0.95)
    )
    bcs = [fem.dirichletbc(np.zeros(3), bottom, V), fem.dirichletbc(down, top, V)]

    def update(t):
        down.value[2] = -0.08 * t

    plate, roller = map(nts.boundary_of, bodies)
    pairs = [nts.ContactPair(plate, roller, exchange=exchange)]
    stepper = nts.QuasiStatic(bodies, pairs, dt=0.25, bcs=bcs, update=update)
    most = max(report.newton_iterations for report in stepper.run(until=1.0))
    pressure = nts.Fields(stepper).contact_pressure()
    force = -nts.Diagnostics(stepper).contact_force()[2]
    traction = -nts.Fields(stepper).contact_traction()[2]
    assert fem.assemble_scalar(fem.form(traction * ufl.ds)) == pytest.approx(force, rel=1e-9)
    # The walls bulge below the roller, whose facets are turned from theirs by about 80 degrees.
    _, y, z = V.tabulate_dof_coordinates().T
    is_wall = (np.isclose(y, 0) | np.isclose(y, 1)) & (z < 0.45)
    assert not pressure.x.array[is_wall].any()
    # Forces of vertices have no area of their own, which raises the pressure on facets partly in
    # contact.
    if not exchange:
        assert fem.assemble_scalar(fem.form(pressure * ufl.ds)) == pytest.approx(force, rel=0.1)
    assert most <= 15
