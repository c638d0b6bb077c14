"""Cells of second order: round geometry and conservation as with straight cells."""

from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.model.lumped_mass import lumped_mass
from helpers.laws import NODAL
from helpers.models.boxed import Ledger
from helpers.once import once
from helpers.readers import read_grids

pytest.importorskip("gmsh")
pytestmark = pytest.mark.at_most_two_ranks

ENERGY_TOLERANCE, MOMENTUM_TOLERANCE = 1e-10, 1e-11
RADIUS, VOLUME = 0.5, np.pi / 6
CENTRE = np.array([0.05, 0.02, 0.505])
RUBBER = nts.NeoHookean(E=1e5, nu=0.3, rho=1e3)
cells_ = pytest.mark.parametrize("cell", [once("hexahedron"), "tetrahedron"])


def ball(model: Any, order: int, cell: str, edge: int = 2) -> None:
    """Add a ball above z = 0, whose surface is round where cells are of second order."""
    if cell == "tetrahedron":
        volume = model.occ.addSphere(*CENTRE, RADIUS)
        model.occ.synchronize()
        model.addPhysicalGroup(3, [volume], name="ball")
        model.addPhysicalGroup(2, [1], name="ball_outer")
        model.mesh.setSize(model.getEntities(0), 0.5 / edge)
        model.mesh.generate(3)
        model.mesh.setOrder(order)
        return
    cells = {"cells_per_edge": edge, "layers": edge // 2, "cell": cell}
    parts.add_solid_ball(model, "ball", centre=CENTRE, radius=RADIUS, **cells)
    model.mesh.setOrder(order)
    if order == 2:
        _, outer = model.getEntitiesForPhysicalName("ball_outer")[0]
        for node in np.unique(model.mesh.getElements(2, outer)[2][0]):
            travel = model.mesh.getNode(node)[0] - CENTRE
            model.mesh.setNode(node, CENTRE + RADIUS * travel / np.linalg.norm(travel), [])


def disc(model: Any, cell: str) -> None:
    """Add a round disc of the plane above y = 0."""
    surface = model.occ.addDisk(0.05, RADIUS + 0.005, 0, RADIUS, RADIUS)
    model.occ.synchronize()
    model.addPhysicalGroup(2, [surface], name="ball")
    if cell == "quadrilateral":
        model.mesh.setRecombine(2, surface)
    model.mesh.setSize(model.getEntities(0), 0.25)
    model.mesh.generate(2)
    model.mesh.setOrder(2)


def thrown(comm: Any, build: Any, dim: int = 3, scheme: Any = nts.EnergyMomentum, **how: Any):
    """Ball or disc thrown obliquely at a rigid floor. Collective."""
    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 2, (dim,)))
    body = nts.Body(V, cells, tag["ball"], RUBBER)
    up = np.eye(dim)[-1]
    floor = nts.RigidPlane(0 * up, up)
    dt = {} if scheme is nts.CentralDifference else {"dt": 4e-3}
    stepper = scheme([body], [nts.ContactPair(nts.boundary_of(body), floor, **(NODAL | how))], **dt)
    stepper.set_velocity(body, 0.5 * np.eye(dim)[0] - 2 * up)
    return stepper


@cells_
def test_bodies_are_as_round_as_their_geometry(comm, cell):
    bodies = {}
    for order in (1, 2):
        mesh, cells, _, tag = nts.read_mesh(partial(ball, order=order, cell=cell), comm)
        V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
        bodies[order] = nts.Body(V, cells, tag["ball"], RUBBER)
    surface = nts.boundary_of(bodies[2])
    X = bodies[2].V.tabulate_dof_coordinates()[surface.nodes]
    assert np.abs(np.linalg.norm(X - CENTRE, axis=1) / RADIUS - 1).max(initial=0) <= 1e-9
    assert comm.allreduce(surface.area.sum()) == pytest.approx(4 * np.pi * RADIUS**2, rel=0.02)
    # Energy of a uniform strain: the volume of the cells.
    stretch = 1e-3
    volume = {}
    for order, body in bodies.items():
        stepper = nts.EnergyMomentum([body], dt=1.0)
        stepper.set_displacement(body, lambda X: stretch * (X.T - CENTRE).T)
        bulk = 1e5 / (3 * (1 - 0.6))
        density = 4.5 * bulk * stretch**2
        volume[order] = nts.Diagnostics(stepper).strain_energy() / density
    assert abs(volume[2] / VOLUME - 1) <= 0.005
    assert abs(volume[1] / VOLUME - 1) >= 5 * abs(volume[2] / VOLUME - 1)
    mass = lumped_mass([bodies[2]])
    assert comm.allreduce(mass.min()) > 0
    assert comm.allreduce(mass.sum()) == pytest.approx(1e3 * volume[2], rel=1e-3)


def bounce(build: Any) -> np.ndarray:
    """Impulse [N s] and mean time [s] of the force of a ball that bounces."""
    stepper = thrown(MPI.COMM_SELF, build)
    diagnostics = nts.Diagnostics(stepper)
    t, force = np.array(
        [(step.t, diagnostics.balance().contact_force[2]) for step in stepper.run(0.312)]
    ).T
    assert force[force.argmax() :].min() == 0  # It has rebounded.
    return np.array([force.sum() * stepper.dt, force @ t / force.sum()])


@pytest.mark.serial
@cells_
def test_rebound_of_a_ball_of_curved_cells_is_at_least_four_times_closer(cell, table_row):
    straight, curved, fine = (
        bounce(partial(ball, order=order, cell=cell, edge=edge))
        for order, edge in ((1, 2), (2, 2), (2, 4))
    )
    errors = np.abs([straight, curved] / fine - 1)
    table_row(
        f"ball of {cell[:-2]}a of degree 2, two along a quarter of a circle",
        "finer curved cells: impulse of the rebound, and its mean time",
        ", ".join(
            f"{name} cells {100 * error[0]:.1f}, {100 * error[1]:.1f} %"
            for name, error in zip(("straight", "curved"), errors, strict=True)
        ),
    )
    assert (errors[0] >= np.array([4, 2]) * errors[1]).all()


@cells_
@pytest.mark.parametrize(
    ("friction", "method"),
    [
        once(None, "node-to-segment"),
        (nts.Coulomb(0.3), "node-to-segment"),
        (nts.Coulomb(0.3), "mortar"),
    ],
)
def test_impact_conserves_energy_and_momenta(comm, cell, friction, method):
    """A ball strikes a free plate, also with friction."""

    def build(model: Any) -> None:
        plate = {"corner": (-0.7, -0.7, -0.2), "size": (1.4, 1.4, 0.2), "cells": (3, 3, 1)}
        if cell == "hexahedron":
            parts.add_box(model, "plate", **plate)
            ball(model, 2, cell)
            return
        volume = model.occ.addCylinder(0, 0, -0.2, 0, 0, 0.2, 0.7)
        model.occ.synchronize()
        model.addPhysicalGroup(3, [volume], name="plate")
        ball(model, 2, cell)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    bodies = [nts.Body(V, cells, tag[name], RUBBER) for name in ("ball", "plate")]
    pairs = nts.all_pairs(
        bodies, friction=friction, method=method, enforcement=nts.LagrangeMultiplier()
    )
    stepper = nts.EnergyMomentum(bodies, pairs, dt=5e-3)
    stepper.set_velocity(bodies[0], (2.0, 0.0, -2.0))
    ledger = Ledger(stepper)
    ledger.run(10)
    # With mortar contact vertices alone are counted: the lowest one, as facets open next to it.
    least = 1 if method == "mortar" else 3
    assert max(report.num_active for report in ledger.reports) >= least
    assert ledger.error <= ENERGY_TOLERANCE
    taken = sum(report.contact_work.friction for report in ledger.reports)
    assert (taken < -1e-4 * ledger.start.kinetic_energy) if friction else taken == 0
    after = ledger.diagnostics.balance()
    for name in ("linear", "angular"):
        a, b = (getattr(s, f"{name}_momentum") for s in (ledger.start, after))
        assert np.linalg.norm(b - a) <= MOMENTUM_TOLERANCE * np.linalg.norm(a)


@pytest.mark.serial
@pytest.mark.parametrize(
    "kind, scheme, enforcement",
    [
        ("triangle", nts.EnergyMomentum, nts.LagrangeMultiplier()),
        ("quadrilateral", nts.Midpoint, nts.LagrangeMultiplier("plastic")),
        ("quadrilateral", nts.CentralDifference, nts.Penalty()),
        ("tetrahedron", nts.GeneralizedAlpha, nts.Penalty()),
        ("tetrahedron", nts.CentralDifference, nts.Penalty()),
    ],
)
def test_every_scheme_accounts_for_its_energy(comm, kind, scheme, enforcement):
    dim = 3 if kind == "tetrahedron" else 2
    stepper = thrown(
        comm,
        (lambda model: ball(model, 2, kind)) if dim == 3 else (lambda model: disc(model, kind)),
        dim,
        scheme,
        enforcement=enforcement,
    )
    ledger = Ledger(stepper)
    ledger.run(int(0.06 / stepper.dt))
    assert max(report.num_active for report in ledger.reports) >= 2
    stored = ledger.diagnostics.balance().contact_energy
    assert abs(ledger.gained - ledger.given) / ledger.scale <= ENERGY_TOLERANCE, stored


@pytest.mark.serial
def test_files_show_the_round_surface(comm, tmp_path):
    stepper = thrown(comm, lambda model: ball(model, 2, "tetrahedron"))
    with nts.Recorder(tmp_path / "round", stepper) as record:
        record.write(stepper.advance())
    grid = read_grids(tmp_path / "round.vtkhdf")[1][0]
    distance = np.linalg.norm(
        grid.extract_surface(algorithm="dataset_surface").points - CENTRE, axis=1
    )
    assert np.abs(distance / RADIUS - 1).max() <= 1e-6


def pulley_and_ring(model: Any, order: int) -> None:
    """Add a ring that fits a disc of radius 0.5 m, with its nodes on the circle."""
    outer, inner = ([(2, model.occ.addDisk(0, 0, 0, r, r))] for r in (0.7, RADIUS))
    (ring,), _ = model.occ.cut(outer, inner)
    model.occ.synchronize()
    model.addPhysicalGroup(2, [ring[1]], name="ring")
    model.mesh.setSize(model.getEntities(0), 0.2)
    model.mesh.generate(2)
    model.mesh.setOrder(order)


def test_midpoints_of_straight_edges_inside_a_round_obstacle_have_a_message(comm, refused):
    def stepper(order):
        mesh, cells, _, tag = nts.read_mesh(partial(pulley_and_ring, order=order), comm)
        V = fem.functionspace(mesh, ("Lagrange", 2, (2,)))
        body = nts.Body(V, cells, tag["ring"], RUBBER)
        pulley = nts.RigidSphere(centre=(0.0, 0.0), radius=RADIUS)
        return nts.EnergyMomentum([body], nts.all_pairs([body], obstacles=[pulley]), dt=1e-3)

    stepper(2).advance()
    with refused(ValueError, r"inside .*midpoints of straight edges.*setOrder\(2\)"):
        stepper(1).advance()


def test_displacements_of_degree_one_on_curved_cells_have_a_message(comm, refused):
    mesh, cells, _, tag = nts.read_mesh(partial(pulley_and_ring, order=2), comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    with refused(ValueError, r"straight ones, for .* degree 1, given a mesh of degree 2"):
        nts.Body(V, cells, tag["ring"], RUBBER)
