"""Displacements of degree 2: contact of all nodes, conserved as at degree 1."""

from functools import partial

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.fem.node_numbering import input_ids
from dolfinx_nts.solvers.bulk import Bulk
from dolfinx_nts.solvers.precond.tangent import Tangent
from helpers import scenes
from helpers.interrupted import SCHEMES, with_law
from helpers.models import box_meshes
from helpers.models.boxed import Ledger
from helpers.once import once
from helpers.readers import read_grids
from helpers.step_parts import step_forms

pytestmark = pytest.mark.at_most_two_ranks

# Largest change, relative to the start.
ENERGY_TOLERANCE = 1e-10
MOMENTUM_TOLERANCE = 1e-11
# Tolerance of positions, lengths of about one: impacts amplify rounding.
POSITION_TOLERANCE = 1e-9

cells_ = pytest.mark.parametrize("cell", [once("hexahedron"), "tetrahedron"])


def blocks(comm, scheme=nts.EnergyMomentum, enforcement=None, **options):
    return scenes.blocks(comm, scheme, enforcement, degree=2, **options)


def positions(scene):
    """Positions of all nodes by number, on all ranks."""
    V = scene.stepper.u.function_space
    n = V.dofmap.index_map.size_local
    parts = scene.comm.allgather((input_ids(V)[:n], scene.stepper.x[:n]))
    ids, x = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return x[np.argsort(ids)]


@cells_
@pytest.mark.parametrize("num_bodies", [once(2), 3])
def test_impact_conserves_energy_and_momenta(comm, cell, num_bodies):
    history = blocks(comm, cell=cell, num_bodies=num_bodies).run(12)
    assert max(history.num_active) >= 3
    assert history.energy_error <= ENERGY_TOLERANCE
    assert history.linear_drift <= MOMENTUM_TOLERANCE
    assert history.angular_drift <= MOMENTUM_TOLERANCE


@cells_
@pytest.mark.parametrize(
    "scheme, enforcement",
    [
        once(nts.Midpoint, nts.LagrangeMultiplier("plastic")),
        once(nts.EnergyMomentum, nts.Penalty()),
        (nts.GeneralizedAlpha, nts.LagrangeMultiplier("plastic")),
        once(nts.CentralDifference, nts.Penalty()),
    ],
)
def test_every_scheme_accounts_for_its_energy(comm, cell, scheme, enforcement):
    dt = None if scheme is nts.CentralDifference else scenes.BLOCK_STEP / 2
    scene = blocks(comm, scheme, enforcement, cell=cell, dt=dt)
    ledger = Ledger(scene.stepper)
    ledger.run(int(0.2 / scene.stepper.dt))
    assert max(report.num_active for report in ledger.reports) >= 3
    after = ledger.diagnostics.balance()
    stored = after.contact_energy - ledger.start.contact_energy
    assert abs(ledger.gained - ledger.given) / ledger.scale <= ENERGY_TOLERANCE, stored
    # The generalised-alpha method turns the body by forces out of balance.
    for name in ("linear",) if scheme is nts.GeneralizedAlpha else ("linear", "angular"):
        a, b = (getattr(s, f"{name}_momentum") for s in (ledger.start, after))
        assert np.linalg.norm(b - a) <= MOMENTUM_TOLERANCE * np.linalg.norm(a)


@cells_
@pytest.mark.parametrize("friction", [nts.Coulomb(0.3), once(nts.Coulomb(0.3, eps_T=1e3))])
def test_friction_dissipates_the_energy_of_the_ledger(comm, cell, friction):
    scene = blocks(comm, cell=cell, friction=friction)
    ledger = Ledger(scene.stepper)
    ledger.run(12)
    assert ledger.error <= ENERGY_TOLERANCE
    taken = sum(report.contact_work.friction for report in ledger.reports)
    assert taken < -1e-4 * ledger.start.kinetic_energy
    after = ledger.diagnostics.balance()
    for name in ("linear", "angular"):
        a, b = (getattr(s, f"{name}_momentum") for s in (ledger.start, after))
        assert np.linalg.norm(b - a) <= MOMENTUM_TOLERANCE * np.linalg.norm(a)


@pytest.mark.parametrize(
    ("cell", "laws"),
    [
        once("hexahedron", (nts.EnergyMomentum, None, None)),
        ("tetrahedron", (nts.EnergyMomentum, None, nts.Coulomb(0.3))),
        once("hexahedron", (nts.EnergyMomentum, nts.Penalty(), nts.Coulomb(0.3))),
        once(
            "tetrahedron",
            (nts.Midpoint, nts.LagrangeMultiplier("plastic"), nts.Coulomb(0.3, eps_T=1e3)),
        ),
    ],
    ids=["elastic", "exact stick", "penalty", "plastic"],
)
def test_surfaces_of_degree_two_conserve_energy_and_momenta(comm, cell, laws):
    """Surface-to-surface contact, with multipliers at vertices."""
    scene = blocks(comm, partial(with_law, *laws, method="mortar"), cell=cell)
    ledger = Ledger(scene.stepper)
    ledger.run(12)
    assert max(report.num_active for report in ledger.reports) >= 6
    assert ledger.error <= ENERGY_TOLERANCE
    taken = sum(report.contact_work.friction for report in ledger.reports)
    assert laws[2] is None or taken < -1e-4 * ledger.start.kinetic_energy
    after = ledger.diagnostics.balance()
    for name in ("linear", "angular"):
        a, b = (getattr(s, f"{name}_momentum") for s in (ledger.start, after))
        assert np.linalg.norm(b - a) <= MOMENTUM_TOLERANCE * np.linalg.norm(a)


@cells_
@pytest.mark.parametrize("obstacle", ["plane", once("sphere")])
def test_obstacles_stop_all_nodes(comm, cell, obstacle):
    data = box_meshes.boxes([(2, 2, 2)], [(1.0, 0.8, 0.6)], cell)
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    body = nts.Body(V, cells, tag["body 0"], nts.SaintVenantKirchhoff(*scenes.BLOCK_RUBBER))
    below = {
        "plane": nts.RigidPlane((0.0, 0.0, -0.02), (0.0, 0.05, 1.0)),
        "sphere": nts.RigidSphere((0.52, 0.37, -2.03), 2.0),
    }
    stepper = nts.EnergyMomentum(
        [body],
        nts.all_pairs(
            [body],
            obstacles=[below[obstacle]],
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        ),
        dt=scenes.BLOCK_STEP,
    )
    stepper.set_velocity(body, (0.1, 0.0, -1.0))
    ledger = Ledger(stepper)
    ledger.run(20)
    assert ledger.error <= ENERGY_TOLERANCE
    # Frictionless and rigid: the energy is conserved.
    assert abs(ledger.gained) <= ENERGY_TOLERANCE * ledger.start.kinetic_energy
    assert max(report.num_active for report in ledger.reports) >= 2
    assert ledger.diagnostics.body_velocity(body)[2] > 0.3


def scattered(middle):
    """Neighbouring cells on different ranks."""
    return np.random.default_rng(3).integers(MPI.COMM_WORLD.size, size=len(middle))


@pytest.mark.several_ranks
@pytest.mark.parametrize(
    ("cell", "scheme", "owner"),
    [
        ("hexahedron", nts.EnergyMomentum, scattered),
        ("tetrahedron", nts.EnergyMomentum, None),
        ("tetrahedron", nts.CentralDifference, scattered),
        ("hexahedron", SCHEMES["mortar"], scattered),
        ("tetrahedron", SCHEMES["resolved"], scattered),
        ("hexahedron", SCHEMES["resolved mortar"], scattered),
    ],
)
def test_all_ranks_and_each_alone_agree(comm, cell, owner, scheme):
    explicit = scheme is nts.CentralDifference
    options = {"enforcement": nts.Penalty() if explicit else None, "cell": cell}
    if explicit:
        options["dt"] = None
    together = blocks(comm, scheme, owner=owner, **options)
    alone = blocks(MPI.COMM_SELF, scheme, **options)
    num_steps = int(0.15 / alone.stepper.dt) if explicit else 10
    num_steps = 5 if scheme in (SCHEMES["mortar"], SCHEMES["resolved mortar"]) else num_steps
    first, second = together.run(num_steps), alone.run(num_steps)
    assert max(first.num_active) >= 3
    difference = np.abs(positions(together) - positions(alone)).max()
    assert comm.allreduce(difference, op=MPI.MAX) <= POSITION_TOLERANCE
    assert comm.allreduce(first.num_active == second.num_active, op=MPI.LAND)


@cells_
def test_tangent_is_the_derivative_of_the_residual(comm, cell):
    scene = blocks(comm, cell=cell)
    scene.run(3)
    s = scene.stepper
    s.u_n.x.array[:] = s.u.x.array
    bulk = Bulk(step_forms(s).residual(), s.u, [])
    V, n = s.u.function_space, bulk.num_owned
    X = V.tabulate_dof_coordinates()[: n // 3]
    d = np.sin(3 * X[:, [1, 2, 0]] + np.arange(3))
    u = s.u.x.array[:n].copy() + 0.05 * d[:, [2, 0, 1]].ravel()

    def at(displacement):
        s.u.x.array[:n] = displacement
        s.u.x.scatter_forward()

    def norm(values):
        return np.sqrt(comm.allreduce(np.vdot(values, values)))

    at(u)
    R, slope = bulk.forces(), bulk.action(d).ravel()
    remainders = []
    for step in (1e-2, 5e-3):
        at(u + step * d.ravel())
        remainders.append(norm(bulk.forces() - R - step * slope))
    assert np.log2(remainders[0] / remainders[1]) >= 1.9
    at(u)
    tangent = Tangent(step_forms(s).residual(), s.u, [])
    tangent.assemble_exact()
    matrix = tangent.matrix(scalar=False)
    x, y = matrix.createVecs()
    x.array[:] = d.ravel()
    matrix.mult(x, y)
    assert norm(y.array - slope) <= 1e-11 * norm(slope)


@cells_
def test_energy_of_bending_is_exact(comm, cell):
    """Pure bending u = (xz, 0, -x^2/2) k: the energy of the exact field."""
    data = box_meshes.boxes([(2, 1, 1)], [(2.0, 0.5, 0.2)], cell)
    mesh, cells, _, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    E, k = 1e3, 1e-5
    body = nts.Body(V, cells, tag["body 0"], nts.SaintVenantKirchhoff(E, 0.0, 1.0))
    stepper = nts.EnergyMomentum([body], dt=1.0)

    def bent(X):
        x, z = X[0], X[2] - 0.1
        return k * np.array([x * z, 0 * x, -(x**2) / 2])

    stepper.set_displacement(body, bent)
    inertia = 0.5 * 0.2**3 / 12
    energy = nts.Diagnostics(stepper).strain_energy()
    assert energy == pytest.approx(E * inertia * k**2 * 2.0 / 2, rel=1e-3)


@pytest.mark.parametrize(
    ("cell", "scheme"),
    [
        once("hexahedron", nts.EnergyMomentum),
        once("tetrahedron", nts.EnergyMomentum),
        ("tetrahedron", SCHEMES["mortar"]),
    ],
)
def test_files_show_all_nodes_and_checkpoints_continue(comm, tmp_path, cell, scheme):
    folder = comm.bcast(tmp_path)

    def record(num_steps, name):
        scene = blocks(comm, scheme, cell=cell, friction=nts.Coulomb(0.3))
        with nts.Recorder(folder / name, scene.stepper, checkpoint_every=3, resume=True) as file:
            for step in scene.stepper.run(until=num_steps * scenes.BLOCK_STEP):
                file.write(step)
        return scene

    whole = record(6, "whole")
    record(3, "parts")
    parts = record(6, "parts")
    difference = np.abs(positions(whole) - positions(parts)).max()
    assert comm.allreduce(difference, op=MPI.MAX) <= POSITION_TOLERANCE
    x, v = positions(whole), whole.stepper
    comm.barrier()
    grid = read_grids(folder / "whole.vtkhdf")[1][-1]
    num_cells = v.u.function_space.mesh.topology.index_map(3).size_global
    assert grid.n_cells == 8 * num_cells and grid.n_points == len(x)
    np.testing.assert_allclose(grid.points + grid["displacement"], x, rtol=0, atol=1e-12)
    sizes = grid.compute_cell_sizes()["Volume"]
    assert np.all(np.abs(sizes) > 0)  # cells may be mirrored, as in the mesh
    for name in ("gap", "contact_pressure", "active", "slip_state", "friction_traction"):
        assert name in grid.point_data
    assert set(grid.cell_data["body"]) == {0, 1}


@cells_
def test_pressure_of_a_uniform_load_is_uniform(comm, cell):
    """Nodal forces of a pressure, which are zero at vertices of triangles."""
    data = box_meshes.boxes([(3, 2, 1)], [(1.2, 1.0, 0.5)], cell)
    mesh, _, facets, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    top = nts.Surface(V, facets, tag["top 0"])
    force = np.column_stack([3 * top.area, 0 * top.area, -2 * top.area])
    np.testing.assert_allclose(top.per_area(force), np.broadcast_to([3, 0, -2], force.shape))
    np.testing.assert_allclose(top.per_area(force[:, 0]), 3)
    assert comm.allreduce(top.area.sum()) == pytest.approx(1.2)


@cells_
def test_free_faces_next_to_a_contact_have_no_pressure(comm, cell):
    """A uniformly pressed block on a wider one, both with their whole boundaries as surfaces."""
    data = box_meshes.boxes([(4, 4, 1), (2, 2, 2)], [(2.0, 2.0, 0.5), (1.0, 1.0, 1.0)], cell)
    second = data.X[:, 2] >= 0
    lower = np.arange(len(data.X)) < len(data.X) - 27
    data.X[lower & second] -= (0.5, 0.5, 0.5)
    mesh, cells, facets, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    rubber = nts.NeoHookean(1e6, 0.0, 1e3)
    bodies = [nts.Body(V, cells, tag[f"body {i}"], rubber) for i in (1, 0)]
    floor = fem.locate_dofs_geometrical(V, lambda x: x[2] < -0.49)
    bcs = [fem.dirichletbc(np.zeros(3), floor, V)]
    load = nts.Pressure(nts.Surface(V, facets, tag["top 1"]), 1e3)
    pair = nts.ContactPair(*(nts.boundary_of(body) for body in bodies))
    assert pair.with_defaults(nts.Penalty()).method == "mortar"
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, loads=[load])
    stepper.advance()
    field = nts.Fields(stepper).contact_pressure()
    x, p = field.function_space.tabulate_dof_coordinates(), field.x.array
    above = (x[:, 2] > 0.01) & (x[:, 0] > -0.01)
    assert np.abs(p[: len(x)][above]).max(initial=0.0) < 1e-9
    below = (np.abs(x[:, 2]) < 1e-9) & (np.abs(x[:, :2] - 0.5) <= 0.501).all(axis=1)
    assert comm.allreduce(float(p[: len(x)][below].max(initial=0.0)), op=MPI.MAX) > 500


@cells_
def test_matching_blocks_pass_the_patch_test(comm, cell):
    data = box_meshes.boxes([(4, 4, 1), (4, 4, 1)], [(1.0, 1.0, 0.5)] * 2, cell)
    data.X[len(data.X) // 2 :, 2] += 0.5
    mesh, cells, facets, tag = box_meshes.distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    E = 1.0
    material = nts.SaintVenantKirchhoff(E, 0.3, 1.0)
    bodies = [nts.Body(V, cells, tag[f"body {i}"], material) for i in (0, 1)]
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["bottom 1"]),
        nts.Surface(V, facets, tag["top 0"]),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    travel = fem.Constant(mesh, 0.0)

    def held(axis, value, where):
        dofs = fem.locate_dofs_geometrical((V.sub(axis), V.sub(axis).collapse()[0]), where)
        return fem.dirichletbc(value, dofs[0], V.sub(axis))

    zero = np.float64(0.0)
    bcs = [
        held(0, zero, lambda X: np.isclose(X[0], 0)),
        held(1, zero, lambda X: np.isclose(X[1], 0)),
        held(2, zero, lambda X: np.isclose(X[2], 0)),
        held(2, travel, lambda X: np.isclose(X[2], 1)),
    ]
    compression = 1e-4

    def update(t):
        travel.value = -compression * t

    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, update=update)
    stepper.advance()
    F = ufl.Identity(3) + ufl.grad(stepper.u)
    S = material.stress(F.T * F, **material.parameters)
    points = np.full((1, 3), 0.25)
    owned = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    stress = fem.Expression(S[2, 2], points).eval(mesh, owned).ravel()
    mean = comm.allreduce(stress.sum()) / mesh.topology.index_map(3).size_global
    assert comm.allreduce(np.abs(stress / mean - 1).max(initial=0), op=MPI.MAX) <= 1e-3
    assert mean == pytest.approx(-E * compression, rel=1e-3)
    pressure = pair.pressure / (E * compression)
    assert comm.allreduce(np.abs(pressure - 1).max(initial=0), op=MPI.MAX) <= 1e-3
