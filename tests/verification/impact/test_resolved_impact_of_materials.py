"""Resolved impact of dissipative bodies: order, dissipation and momenta."""

from functools import partial

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import CellType, create_rectangle, meshtags
from scipy.linalg import expm

import dolfinx_nts as nts
from helpers import scenes
from helpers.models.boxed import Ledger
from helpers.once import once
from helpers.order import observed_order

pytestmark = pytest.mark.at_most_two_ranks

# Tolerances of the unaccounted energy and of momenta, relative.
ENERGY_TOLERANCE, MOMENTUM_TOLERANCE = 1e-10, 1e-11
RESOLVED = nts.LagrangeMultiplier("resolved")
DRAG, elastic = 0.5, nts.SaintVenantKirchhoff
# Young's modulus 1, Poisson's ratio, density 1: waves have a speed of about 1.
UNIT = {
    "branches": partial(elastic, 1.0, 0.0, 1.0, branches=[(0.5, 1.0), (0.5, 0.1)]),
    "plastic": partial(nts.J2Plasticity, 1.0, 0.3, 1.0, yield_stress=0.03, hardening=0.1),
    "stiffness damping 0.3 s": partial(elastic, 1.0, 0.0, 1.0, stiffness_damping=0.3),
    "stiffness damping 0.003 s": partial(elastic, 1.0, 0.0, 1.0, stiffness_damping=0.003),
    "mass damping": partial(elastic, 1.0, 0.0, 1.0, mass_damping=DRAG),
}
# The bar arrives after 0.1 s, at the end of a step.
CELLS, SPEED, ARRIVAL, END = 10, 0.1, 0.1, 1.2


def bar(material, dt, speed=SPEED):
    """Let a bar in the plane strike a wall.

    Returns:
        Displacements and velocities of the nodes with mass, from the wall on and two in each
        section; and the part of the energy that is lost.
    """
    drag = material.mass_damping
    gap = speed * (-np.expm1(-drag * ARRIVAL) / drag if drag else ARRIVAL)
    corners = [(gap, 0), (gap + 1, 1 / CELLS)]
    mesh = create_rectangle(MPI.COMM_SELF, corners, [CELLS, 1], CellType.quadrilateral)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    body = nts.Body(V, meshtags(mesh, 2, cells, np.ones_like(cells)), 1, material)
    mesh.topology.create_connectivity(2, 2)
    across = fem.locate_dofs_topological(V.sub(1), 2, cells)
    rollers = fem.dirichletbc(0.0, across, V.sub(1))
    end = nts.boundary_of(body, where=lambda x: np.isclose(x[0], gap))
    pair = nts.ContactPair(end, nts.RigidPlane((0, 0), (1, 0)), RESOLVED, method="node-to-segment")
    stepper = nts.EnergyMomentum([body], [pair], dt=dt, bcs=[rollers])
    stepper.set_velocity(body, (-speed, 0))
    diagnostics = nts.Diagnostics(stepper)
    start, lost = diagnostics.balance().total_energy, 0.0
    for step in stepper.run(END):
        assert step.damping_work <= 0
        lost -= step.damping_work
        energy = diagnostics.balance().total_energy
        assert abs(energy + lost - start) <= ENERGY_TOLERANCE * start
        assert abs(diagnostics.bulk_defect()) <= ENERGY_TOLERANCE * start
    with_mass = np.argsort(V.tabulate_dof_coordinates()[:, 0])[2:]
    return [f.x.array.reshape(-1, 2)[with_mass] for f in (stepper.u, stepper.v)], lost / start


@pytest.mark.serial
@pytest.mark.parametrize("name", UNIT)
def test_error_is_of_second_order_in_the_step(name, table_row):
    # A wave takes 0.1 through a cell.
    steps = (0.01, 0.005, 0.0025)
    ends, lost = zip(*(bar(UNIT[name](), dt) for dt in steps), strict=True)
    orders = [observed_order(steps, results) for results in zip(*ends, strict=True)]
    table_row(
        f"bar on a wall by resolved, {name}",
        "second order of displacements and velocities in the step",
        f"{orders[0]:.2f}, {orders[1]:.2f}",
    )
    assert min(lost) > 0.01
    assert min(orders) >= 1.8


def exact_in_time(beta, t):
    """Displacements and velocities of a damped bar whose massless end rests at a wall, ``(n,)``.

    It arrives at t = 0 with the velocity -1.
    """
    n, side = CELLS, 1 / CELLS
    K, M = np.zeros((2, n + 1, n + 1))
    for e in range(n):
        K[e : e + 2, e : e + 2] += np.array([[1, -1], [-1, 1]]) / side
        M[e : e + 2, e : e + 2] += np.array([[2, 1], [1, 2]]) * side / 6
    P = np.eye(n + 1)
    P[0, :3] = 0, 2, -1
    A = np.linalg.solve((P.T @ M @ P)[1:, 1:], K[1:, 1:])
    system = np.block([[np.zeros((n, n)), np.eye(n)], [-A, -beta * A]])
    return np.split(expm(t * system) @ np.repeat([0.0, -1.0], n), 2)


@pytest.mark.serial
@pytest.mark.parametrize("beta", [0.003, 0.03, 0.3])
def test_damped_bar_moves_as_its_mesh_does_exactly_in_time(beta):
    speed = 1e-5  # so that strains are small
    (u, v), _ = bar(elastic(1.0, 0.0, 1.0, stiffness_damping=beta), 0.005, speed)
    exact_u, exact_v = exact_in_time(beta, END - ARRIVAL)
    assert np.abs(u[:, 0] / speed + ARRIVAL - np.repeat(exact_u, 2)).max() <= 1e-4
    assert np.abs(v[:, 0] / speed - np.repeat(exact_v, 2)).max() <= 1e-3


BLOCKS = {
    "branches": elastic(
        *scenes.BLOCK_RUBBER, branches=[(0.5, 0.5 * scenes.BLOCK_STEP), (0.8, 0.2)]
    ),
    "damped": elastic(*scenes.BLOCK_RUBBER, mass_damping=0.5, stiffness_damping=0.01),
    "stiffly damped": elastic(*scenes.BLOCK_RUBBER, stiffness_damping=0.02),
    "plastic": nts.J2Plasticity(*scenes.BLOCK_RUBBER, yield_stress=20.0, hardening=100.0),
}


@pytest.mark.parametrize(
    ("name", "method", "mu"),
    [
        ("branches", "node-to-segment", 0.0),
        once("branches", "mortar", 0.3),
        once("plastic", "node-to-segment", 0.3),
        ("plastic", "mortar", 0.0),
        ("stiffly damped", "node-to-segment", 0.0),
        once("stiffly damped", "mortar", 0.3),
        ("damped", "node-to-segment", 0.3),
    ],
)
def test_blocks_lose_the_dissipation_of_materials_and_friction(comm, agree, name, method, mu):
    friction = nts.Coulomb(mu) if mu else None

    def make(bodies, pairs, dt):
        for body in bodies:
            vars(body)["material"] = BLOCKS[name]
        pairs = [nts.ContactPair(p.nodes, p.segments, RESOLVED, friction, method) for p in pairs]
        return nts.EnergyMomentum(bodies, pairs, dt=dt)

    ledger = Ledger(scenes.blocks(comm, make, layers=2).stepper)
    ledger.run(12)
    works = [report.damping_work for report in ledger.reports]
    rubbed = sum(report.contact_work.friction for report in ledger.reports)
    assert agree(max(report.num_active for report in ledger.reports) >= 3)
    assert agree(max(works) <= 0)
    assert agree(sum(works) < -1e-2 * ledger.scale)
    assert agree((rubbed < -1e-5 * ledger.scale) == (mu > 0))
    assert agree(abs(ledger.gained - sum(works) - rubbed) <= ENERGY_TOLERANCE * ledger.scale)
    # Mass damping reduces all velocities by (1 - a dt/2)/(1 + a dt/2) a step, and conserves no
    # momentum.
    drag = BLOCKS[name].mass_damping * scenes.BLOCK_STEP / 2
    left = ((1 - drag) / (1 + drag)) ** 12
    start, end = ledger.start, ledger.diagnostics.balance()
    for quantity in ("linear_momentum", "angular_momentum")[: 1 if drag else 2]:
        before, after = left * getattr(start, quantity), getattr(end, quantity)
        scale = MOMENTUM_TOLERANCE * np.linalg.norm(before)
        assert agree(np.abs(after - before).max() <= scale)
