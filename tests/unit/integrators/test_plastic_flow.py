"""J2 plasticity: ledger, momenta, tension, shear and cycles in closed form, rotated runs."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import (
    CellType,
    create_rectangle,
    create_unit_square,
    locate_entities_boundary,
    meshtags,
)
from scipy.optimize import brentq

import dolfinx_nts as nts
from dolfinx_nts.common.archive import Snapshot
from helpers.interrupted import SCHEMES, scene
from helpers.models.boxed import RHO, VOLUME, Box, Ledger, check_dissipation, swirl
from helpers.once import once
from helpers.readers import read_grids

pytestmark = pytest.mark.at_most_two_ranks

YOUNG, NU, YIELD = 1.0e3, 0.3, 5.0
SHEAR, BULK = YOUNG / (2 * (1 + NU)), YOUNG / (3 * (1 - 2 * NU))


def metal(rho=RHO, **numbers):
    return nts.J2Plasticity(YOUNG, NU, rho, **{"yield_stress": YIELD, "hardening": 20.0} | numbers)


def percent(error):
    return f"{100 * error:.2g} %" if error > 1e-4 else "below 0.01 %"


def alpha(bodies, **options):
    return nts.GeneralizedAlpha(bodies, rho_inf=0.5, **options)


@pytest.mark.parametrize(
    ("cell", "scheme"),
    [("hexahedron", nts.EnergyMomentum), once("tetrahedron", nts.Midpoint),
     once("tetrahedron", alpha)],
)  # fmt: skip
def test_flow_only_takes_energy_and_all_of_it_is_accounted_for(comm, cell, scheme):
    check_dissipation(comm, cell, metal(), scheme)


def test_impacts_of_plastic_blocks_lose_the_plastic_dissipation(comm, folder, agree):
    stepper = scene(comm, SCHEMES["plastic"]).stepper
    ledger = Ledger(stepper)
    ledger.run(12)
    lost, taken = -ledger.gained, -ledger.total("damping_work")
    assert max(report.num_active for report in ledger.reports) > 0
    assert taken > 1e-3 * ledger.scale
    assert abs(lost - taken) <= 1e-10 * ledger.scale
    with nts.Recorder(folder / "run", stepper, stress=True):
        pass
    _, (grid,) = read_grids(folder / "run.vtkhdf")
    written, own = grid.cell_data["plastic_strain"], nts.Fields(stepper).plastic_strain().x.array
    original = stepper.u.function_space.mesh.topology.original_cell_index[: len(own)]
    assert agree(np.array_equal(written[original], own) and written.max() > 0)


def face(box, axis, place):
    """Degrees of freedom normal to a face of a box."""
    facets = locate_entities_boundary(box.mesh, 2, lambda X: np.isclose(X[axis], place))
    return fem.locate_dofs_topological(box.V.sub(axis), 2, facets)


def pulled(box, scheme, stretch, dt):
    """Stepper of a box whose length along x is given by time, with free sides."""
    far = fem.Constant(box.mesh, 0.0)

    def update(t):
        far.value = stretch(t) - 1

    bcs = [fem.dirichletbc(0.0, face(box, axis, 0.0), box.V.sub(axis)) for axis in range(3)]
    bcs.append(fem.dirichletbc(far, face(box, 0, 1.0), box.V.sub(0)))
    return scheme([box.body], dt=dt, bcs=bcs, update=update)


def sheared(box, scheme, shear, dt):
    """Stepper of a box that is sheared by given displacements of all nodes, by time."""
    given, dofs = fem.Function(box.V), np.arange(len(box.V.tabulate_dof_coordinates()))

    def update(t):
        given.interpolate(lambda X: np.vstack([shear(t) * X[2], 0 * X[0], 0 * X[0]]))

    bcs = [fem.dirichletbc(given, dofs.astype(np.int32))]
    return scheme([box.body], dt=dt, bcs=bcs, update=update)


def exact_tension(stretch, yield_stress):
    """Force per reference area and plastic strain of a bar at a stretch.

    From the Kirchhoff stress q, the volume change by its pressure, and logarithmic strains.
    """
    sign = np.sign(stretch - 1)

    def of(q):
        J = np.sqrt(1 + 2 * sign * q / 3 / BULK)
        elastic = brentq(lambda a: SHEAR * (a**2 - 1 / a) - sign * q, 0.3, 3.0)
        return sign * (np.log(stretch) - np.log(J) / 3 - np.log(elastic))

    q = brentq(lambda q: q - yield_stress(of(q)), 1e-3, 10 * YIELD)
    return sign * q / stretch, of(q)


LAWS = {
    "linear": ({}, lambda a: YIELD + 20 * a),
    "saturating": (
        {"hardening": 4.0, "saturation": (3.0, 16.0)},
        lambda a: YIELD + 4 * a + 3 * (1 - np.exp(-16 * a)),
    ),
}


@pytest.mark.serial
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("end", [1.5, 0.6])
def test_tension_and_compression_agree_with_the_closed_form(comm, table_row, name, end):
    numbers, yield_stress = LAWS[name]
    box = Box(comm, material=metal(**numbers), shape=(1, 1, 1))
    num_steps = 50
    stepper = pulled(box, nts.QuasiStatic, lambda t: end**t, 1 / num_steps)
    errors = []
    for step in stepper.run(until=1.0):
        force, strain = exact_tension(end**step.t, yield_stress)
        reaction = sum(each.force[0] for each in step.reactions if each.force[0] * force > 0)
        errors.append(abs(reaction / force / 0.48 - 1))
    fields = nts.Fields(stepper)
    found = fields.plastic_strain().x.array
    errors.append(np.abs(found / strain - 1).max(initial=0))
    # Fields contain the Cauchy stress, for the compressed volume.
    q = abs(force) * end
    J = np.sqrt(1 + 2 * np.sign(end - 1) * q / 3 / BULK)
    errors.append(np.abs(fields.von_mises_stress().x.array * J / q - 1).max(initial=0))
    error = comm.allreduce(max(errors), MPI.MAX)
    kind = "tension" if end > 1 else "compression"
    table_row(f"{kind} to a stretch of {end}, {name} hardening", "closed form", percent(error))
    assert error <= 5e-3


@pytest.mark.serial
@pytest.mark.parametrize("scheme", [nts.QuasiStatic, nts.EnergyMomentum])
def test_cycles_of_shear_lose_the_area_of_their_loop(comm, table_row, scheme):
    # Perfectly plastic, to four strains of yield and back, by steps of an eighth of that strain.
    yields = YIELD / 100 / np.sqrt(3) / SHEAR
    amplitude, num_steps = 4 * yields, 128
    law = metal(1e-6, yield_stress=YIELD / 100, hardening=0.0)
    box = Box(comm, material=law, shape=(1, 1, 1))

    def shear(t):  # a triangle of period 1
        return amplitude * (1 - 4 * abs((t + 0.25) % 1 - 0.5))

    stepper = sheared(box, scheme, shear, 1 / num_steps)
    ledger = Ledger(stepper)
    ledger.run(2 * num_steps)
    steps = ledger.reports[num_steps:]
    loss, work = -sum(s.damping_work for s in steps), sum(s.support_work for s in steps)
    exact = 4 * (amplitude - yields) * YIELD / 100 / np.sqrt(3) * VOLUME
    table_row(
        f"{scheme.__name__}: dissipation in a cycle of shear",
        "area of the loop",
        percent(abs(loss / exact - 1)),
    )
    assert abs(loss / exact - 1) <= 5e-3
    assert abs(work / exact - 1) <= (5e-3 if scheme is nts.EnergyMomentum else 0.03)
    # Energies of such small strains are exact to the round-off of moduli, in each step.
    round_off = np.finfo(float).eps * SHEAR * VOLUME
    assert max(s.damping_work for s in ledger.reports) <= round_off
    assert ledger.error * ledger.scale <= len(ledger.reports) * round_off


@pytest.mark.serial
def test_large_shear_has_the_shear_stress_of_yield(comm, table_row):
    shear, law = 0.5, metal(yield_stress=YIELD / 10, hardening=0.5)
    box = Box(comm, material=law, shape=(1, 1, 1))
    stepper = sheared(box, nts.QuasiStatic, lambda t: shear * t, 0.01)
    list(stepper.run(until=1.0))
    stress = nts.Fields(stepper).cauchy_stress().x.array.reshape(-1, 3, 3)[:, 0, 2]
    # But for the elastic part of the shear.
    q = brentq(lambda q: q - law.hardening.yield_stress - 0.5 * (shear - q / SHEAR / 3**0.5)
               / 3**0.5, 0, YIELD)  # fmt: skip
    error = comm.allreduce(np.abs(stress * np.sqrt(3) / q - 1).max(initial=0), MPI.MAX)
    table_row("shear stress at a shear of 0.5", "closed form", percent(error))
    assert error <= 5e-3


@pytest.mark.serial
def test_plane_strain_yields_at_the_stress_of_the_plane(table_row):
    # Without hardening: sigma = -2/sqrt(3) sigma_0, as the middle stress is half of it.
    mesh = create_unit_square(MPI.COMM_SELF, 2, 2, CellType.quadrilateral)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    cells = np.arange(4, dtype=np.int32)
    law = metal(yield_stress=YIELD / 10, hardening=0.0)
    body = nts.Body(V, meshtags(mesh, 2, cells, np.ones_like(cells)), 1, law)
    far = fem.Constant(mesh, 0.0)
    bcs = []
    for axis, place, value in ((0, 0.0, 0.0), (1, 0.0, 0.0), (0, 1.0, far)):
        facets = locate_entities_boundary(mesh, 1, lambda X, a=axis, p=place: np.isclose(X[a], p))
        dofs = fem.locate_dofs_topological(V.sub(axis), 1, facets)
        bcs.append(fem.dirichletbc(value, dofs, V.sub(axis)))

    def update(t):
        far.value = -0.05 * t

    stepper = nts.QuasiStatic([body], dt=0.02, bcs=bcs, update=update)
    list(stepper.run(until=1.0))
    stress = nts.Fields(stepper).cauchy_stress().x.array.reshape(-1, 3, 3)
    error = np.abs(stress[:, 0, 0] / (-2 / np.sqrt(3) * YIELD / 10) - 1).max()
    table_row("compression in plane strain, no hardening", "closed form", percent(error))
    assert error <= 5e-3


@pytest.mark.serial
def test_a_turned_run_is_the_same_run_turned(comm):
    rng = np.random.default_rng(2)
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    Q *= np.sign(np.linalg.det(Q))
    ends = []
    for turn in (np.eye(3), Q):
        box = Box(comm, material=metal())
        stepper = nts.EnergyMomentum([box.body], dt=0.02)
        given = fem.Function(box.V)
        given.interpolate(lambda X, turn=turn: turn @ X - X)
        stepper.set_displacement(box.body, given)
        stepper.set_velocity(box.body, lambda X, turn=turn: turn @ swirl(X))
        works = [step.damping_work for step in stepper.run(until=0.2)]
        ends.append((box.positions(stepper), works))
    (x, works), (turned, same) = ends
    assert min(works) < -1e-2
    np.testing.assert_allclose(turned, x @ Q.T, atol=1e-9)
    np.testing.assert_allclose(same, works, rtol=1e-8)


@pytest.mark.parametrize("dt", [0.02, 0.04])
def test_metal_that_flows_to_and_fro_needs_few_iterations(comm, dt):
    # With full increments Newton's method alternates between both directions of flow.
    box = Box(comm, material=metal(1.0), shape=(4, 4, 4), size=(1.0, 1.0, 1.0))
    stepper = nts.EnergyMomentum([box.body], dt=dt)
    stepper.set_velocity(
        box.body, lambda X: np.array([1 - 2 * X[1] + 3 * X[0] * X[2], 2 * X[0], 2 * X[1] ** 2])
    )
    counts = [stepper.advance().newton_iterations for _ in range(6)]
    assert max(counts) <= 20
    assert sum(counts) <= 12 * len(counts)


@pytest.mark.parametrize(
    "law", [nts.LagrangeMultiplier(), once(nts.Penalty())], ids=["exact", "springs"]
)
@pytest.mark.parametrize("travel", [once(5e-5), 1.6e-4])
def test_the_first_step_bends_a_flat_sheet_with_friction(comm, law, travel):
    corners = [(-18e-3, 0.0), (18e-3, 2e-3)]
    mesh = create_rectangle(comm, corners, [36, 2], CellType.quadrilateral)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    steel = nts.J2Plasticity(210e9, 0.3, 7800.0, yield_stress=250e6, hardening=1e9)
    sheet = nts.Body(V, meshtags(mesh, 2, cells, np.ones_like(cells)), 1, steel)
    ends = nts.Surface.where(V, lambda X: (X[1] < 1e-6) & (np.abs(X[0]) > 9.9e-3))
    top = nts.Surface.where(V, lambda X: X[1] > 2e-3 - 1e-6)
    motion = nts.Motion(translation=lambda t: (0.0, -travel * t))
    tool = nts.RigidSphere((0.0, 4.001e-3), 2e-3).moving(motion)
    pairs = [
        nts.ContactPair(surface, obstacle, law, nts.Coulomb(0.1), method="node-to-segment")
        for surface, obstacle in ((ends, nts.RigidPlane((0, 0), (0, 1))), (top, tool))
    ]
    across = V.sub(0).collapse()[0]
    middle = fem.locate_dofs_geometrical(
        (V.sub(0), across), lambda X: (np.abs(X[0]) < 1e-6) & (X[1] > 2e-3 - 1e-6)
    )
    held = fem.dirichletbc(fem.Function(across), middle, V.sub(0))
    stepper = nts.QuasiStatic([sheet], pairs, dt=1.0, bcs=[held])
    counts = [stepper.advance().newton_iterations for _ in range(2)]
    assert max(counts) <= 20
    strain = nts.Fields(stepper).plastic_strain().x.array.max(initial=0)
    assert comm.allreduce(strain, MPI.MAX) > 1e-4


def test_products_know_whether_points_flow_that_are_just_at_yield(comm, rng):
    # Less than half of the resolved digits.
    stretch = np.array([1.0, -0.5, -0.5])

    def von_mises(amount):
        """Kirchhoff stress of a trial with a stretch at the end of a step."""
        C = (1 + (1 + amount * stretch) ** 2) / 2
        isochoric = C / C.prod() ** (1 / 3)
        return np.sqrt(1.5) * SHEAR * np.linalg.norm(isochoric - isochoric.mean())

    yields = brentq(lambda amount: von_mises(amount) - YIELD, 1e-3, 1e-1, xtol=1e-15)
    box = Box(comm, material=metal(1e-9))
    stepper = nts.EnergyMomentum([box.body], dt=0.02)
    bulk = stepper._bulk
    x = rng.standard_normal((bulk.num_owned // 3, 3))

    def products(beyond):
        """Products by the default kernels and by the kernels of least precision."""
        amount = (1 + beyond) * yields
        stepper.u.interpolate(lambda X: amount * stretch[:, None] * X)
        return bulk.action(x), bulk.rounded_action(x)

    below, above = products(-1e-7), products(1e-7)
    scale = comm.allreduce(np.abs(below[0]).max(initial=0), MPI.MAX)
    assert comm.allreduce(np.abs(above[0] - below[0]).max(initial=0), MPI.MAX) > 0.05 * scale
    for product, rounded in (below, above):
        np.testing.assert_allclose(rounded, product, atol=1e-9 * scale)


def test_a_cut_step_discards_its_attempt(comm):
    box = Box(comm, material=metal())
    stepper = nts.EnergyMomentum([box.body], dt=0.02)
    stepper.set_velocity(box.body, swirl)
    stepper.advance()
    before, fields = Snapshot(), nts.Fields(stepper)
    stepper.serialize(before)
    once = [stepper.advance().damping_work for _ in range(2)]
    strain = fields.plastic_strain().x.array.copy()
    stepper.serialize(before.rewind())
    # But for the order in which solvers of several ranks sum.
    again = [stepper.advance().damping_work for _ in range(2)]
    assert again == (once if comm.size == 1 else pytest.approx(once, rel=1e-12))
    np.testing.assert_allclose(fields.plastic_strain().x.array, strain, rtol=1e-11)


@pytest.mark.serial
def test_where_plasticity_is_refused(comm):
    box = Box(comm, material=metal())
    with pytest.raises(ValueError, match="without branches or plasticity with CentralDifference"):
        nts.CentralDifference([box.body])
    V = fem.functionspace(box.mesh, ("Lagrange", 2, (3,)))
    with pytest.raises(ValueError, match=r"J2Plasticity, .* degree 1, .* degree 2"):
        nts.Body(V, box.cells, box.tag["body 0"], metal())
