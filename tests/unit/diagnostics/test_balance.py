"""Energies, momenta and contact numbers against closed forms and NumPy."""

from collections import Counter

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import _kernels, parts
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.diagnostics.balance import Diagnostics
from dolfinx_nts.parallel import reductions
from helpers.models.box_meshes import boxes, distribute
from helpers.once import once
from helpers.scene import gathered, input_ids
from helpers.scenes import BLOCK_RUBBER, blocks
from reference.bulk import Bulk, rotation

pytestmark = pytest.mark.at_most_two_ranks

# Sums of some hundred products.
TOLERANCE = 1e-12

SIZES = [(1.2, 0.8, 0.5), (0.4, 0.6, 0.3)]
HEIGHT = 0.6  # of the bottom of the upper box, m


def two_boxes(comm, cell="hexahedron", shift=(0.0, 0.0, HEIGHT), pairs=True):
    """Return a stepper with two straight boxes, the upper one smaller."""
    data = boxes([(3, 2, 2), (2, 2, 1)], SIZES, cell)
    data.X[np.unique(data.cells[data.body == 1])] += shift
    mesh, cells, facets, tag = distribute(comm, data)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(*BLOCK_RUBBER)
    bodies = [nts.Body(V, cells, tag[f"body {number}"], rubber) for number in range(2)]
    surfaces = [nts.Surface(V, facets, tag[name]) for name in ("bottom 1", "top 0")]
    contact = (
        [nts.ContactPair(*surfaces, enforcement=nts.LagrangeMultiplier(), method="node-to-segment")]
        if pairs
        else []
    )
    return nts.EnergyMomentum(bodies, contact, dt=0.01)


def reference(V):
    """Reference program for the mesh of V, nodes by input number. Collective."""
    num = V.mesh.topology.index_map(3).size_local
    cells = np.concatenate(V.mesh.comm.allgather(input_ids(V)[V.dofmap.list[:num]]))
    E, nu, rho = BLOCK_RUBBER
    lmbda, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    X = gathered(V, V.tabulate_dof_coordinates())
    return X, Bulk(X, cells, lmbda=lmbda, mu=mu, rho=rho)


@pytest.mark.parametrize("cell", ["hexahedron", once("tetrahedron")])
def test_rigid_boxes_have_the_momenta_of_solid_boxes(comm, cell):
    stepper = two_boxes(comm, cell)
    Q = rotation([1, 2, 0.5], 0.7)
    p, L, K, means = np.zeros(3), np.zeros(3), 0.0, []
    of_each = Diagnostics(stepper).bodies
    for body, size, base, v_c, omega in zip(
        stepper.bodies, SIZES, ([0, 0, 0], [0, 0, HEIGHT]), ([1, 2, 3], [-2, 0, 1]),
        ([0.5, -1, 2], [3, 1, 0]), strict=True,
    ):  # fmt: skip
        centre = np.add(base, np.divide(size, 2))
        x_c = Q @ centre + [5, -3, 2]

        def displacement(X, x_c=x_c, centre=centre):
            return (x_c + (X.T - centre) @ Q.T - X.T).T

        def velocity(X, v_c=v_c, omega=omega, centre=centre):
            return (v_c + np.cross(omega, (X.T - centre) @ Q.T)).T

        stepper.set_displacement(body, displacement)
        stepper.set_velocity(body, velocity)
        a, b, c = size
        m = BLOCK_RUBBER[2] * a * b * c
        inertia = m / 12 * Q @ np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) @ Q.T
        p_body, L_body = m * np.array(v_c), np.cross(x_c, m * np.array(v_c)) + inertia @ omega
        K_body = m * np.dot(v_c, v_c) / 2 + omega @ inertia @ omega / 2
        p, L, K = p + p_body, L + L_body, K + K_body
        means.append((x_c, v_c))
        balance = of_each()[body.name.removeprefix("body ")]
        numbers = balance.mass, balance.kinetic_energy, *balance.linear_momentum
        numbers += (*balance.angular_momentum, *balance.centre_of_mass, *balance.velocity)
        expected = m, K_body, *p_body, *L_body, *x_c, *v_c
        assert np.allclose(numbers, expected, rtol=TOLERANCE, atol=TOLERANCE * m)
        assert abs(balance.strain_energy) < TOLERANCE * K_body
    diagnostics = Diagnostics(stepper)
    assert np.allclose(diagnostics.linear_momentum(), p, rtol=TOLERANCE, atol=TOLERANCE)
    assert np.allclose(diagnostics.angular_momentum(), L, rtol=TOLERANCE, atol=TOLERANCE)
    assert np.isclose(diagnostics.kinetic_energy(), K, rtol=TOLERANCE)
    assert abs(diagnostics.strain_energy()) < TOLERANCE * K
    for body, (x_c, v_c) in zip(stepper.bodies, means, strict=True):
        assert np.allclose(diagnostics.centre_of_mass(body), x_c, rtol=TOLERANCE)
        assert np.allclose(diagnostics.body_velocity(body), v_c, rtol=TOLERANCE, atol=TOLERANCE)


@pytest.mark.parametrize("scheme", [once(nts.Midpoint), nts.EnergyMomentum])
def test_energies_and_bulk_defect_match_the_reference_program(comm, scheme):
    stepper = blocks(comm, scheme).stepper
    V = stepper.u.function_space
    X, bulk = reference(V)
    diagnostics = Diagnostics(stepper)
    for _ in range(4):
        x_n = X + gathered(V, stepper.u.x.array.reshape(-1, 3))
        stepper.advance()
        x = X + gathered(V, stepper.u.x.array.reshape(-1, 3))
        v = gathered(V, stepper.v.x.array.reshape(-1, 3))
        K, energy = bulk.kinetic_energy(v), bulk.strain_energy(x)
        x_mid = (x_n + x) / 2
        states = (x_mid, x_mid) if scheme is nts.Midpoint else (x_n, x)
        force, _ = bulk.internal(*states)
        defect = energy - bulk.strain_energy(x_n) - force @ (x - x_n).ravel()
        momenta = np.append(diagnostics.linear_momentum(), diagnostics.angular_momentum())
        assert np.isclose(diagnostics.kinetic_energy(), K, rtol=TOLERANCE)
        assert np.isclose(diagnostics.strain_energy(), energy, atol=TOLERANCE * K)
        assert np.isclose(diagnostics.bulk_defect(), defect, rtol=0, atol=TOLERANCE * K)
        assert np.allclose(momenta, bulk.momenta(x, v), rtol=0, atol=TOLERANCE * K)
    assert energy > 0
    assert (abs(defect) > 1e-9 * K) == (scheme is nts.Midpoint)


def test_contact_force_is_the_rate_of_momentum_of_the_upper_body(comm):
    scene = blocks(comm)
    stepper, upper = scene.stepper, scene.bodies["body 1"]
    diagnostics = Diagnostics(stepper)
    _, bulk = reference(stepper.u.function_space)
    num_lower = 4 * 4 * 2  # nodes; the upper block follows
    m = bulk.mass[::3, ::3][num_lower:, num_lower:].sum()
    total = np.zeros(3)
    for _ in range(6):
        before = diagnostics.body_velocity(upper)
        step = stepper.advance()
        change = m * (diagnostics.body_velocity(upper) - before)
        force = diagnostics.contact_force()
        assert np.allclose(force * step.dt, change, rtol=0, atol=1e-10 * m)
        assert diagnostics.active_nodes() == step.num_active
        total += force
    assert total[2] > 0


def test_strain_energies_of_bodies_agree_with_single_bodies(comm):
    stepper = blocks(comm).stepper
    for _ in range(4):
        stepper.advance()
    diagnostics = Diagnostics(stepper)
    whole = diagnostics.strain_energy()
    parts = {name: body.strain_energy for name, body in diagnostics.bodies().items()}
    assert sum(parts.values()) == pytest.approx(whole, rel=TOLERANCE)
    stepper.set_displacement(stepper.bodies[0], (0.0, 0.0, 0.0))
    changed = [body.strain_energy for body in diagnostics.bodies().values()]
    assert abs(changed[0]) < TOLERANCE * whole < parts["1"] == changed[1]


def test_block_on_a_plane_presses_with_its_load_on_its_whole_face(comm):
    old = two_boxes(comm)
    lower, upper = old.bodies
    V, size = lower.V, SIZES[0]
    bottom = nts.Surface.where(V, lambda x: np.isclose(x[2], 0.0))
    pair = nts.ContactPair(
        bottom,
        nts.RigidPlane((0, 0, 0), (0, 0, 1)),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    load = nts.Traction(old.pairs[0].segments, (0.0, 0.0, -20.0))
    bcs = [fem.dirichletbc(np.zeros(3), upper.nodes, V)]
    for axis in (0, 1):
        dofs = fem.locate_dofs_geometrical(
            (V.sub(axis), V.sub(axis).collapse()[0]), lambda x: x[2] < HEIGHT
        )
        zero = fem.Function(V.sub(axis).collapse()[0])
        bcs.append(fem.dirichletbc(zero, dofs, V.sub(axis)))
    stepper = nts.QuasiStatic([lower, upper], [pair], dt=1.0, bcs=bcs, loads=[load])
    stepper.advance()
    (balance,) = Diagnostics(stepper).pairs().values()
    force = 20.0 * size[0] * size[1]
    centre = np.array([size[0] / 2, size[1] / 2, 0.0])
    assert balance.contact_area == pytest.approx(size[0] * size[1])
    assert balance.largest_pressure == pytest.approx(20.0)
    assert np.allclose(balance.force, [0, 0, force], atol=1e-9 * force)
    assert np.allclose(balance.torque, np.cross(centre, [0, 0, force]), atol=1e-9 * force)


@pytest.mark.parametrize("angle", [once(0.0), 0.3])
def test_min_gap_is_the_distance_of_parallel_faces(comm, angle):
    stepper = two_boxes(comm)
    Q = rotation([1, 0, 0], angle)
    for body in stepper.bodies:
        stepper.set_displacement(body, lambda X: Q @ X - X)
    gap = HEIGHT - SIZES[0][2]
    assert np.isclose(Diagnostics(stepper).min_gap(), gap, rtol=0, atol=TOLERANCE)


def test_min_gap_is_the_least_of_all_gaps_without_evaluating_far_pairs(comm, monkeypatch):
    def build(model):
        for i, x in enumerate((0.0, 1.3, 2.4, 6.0)):
            box = {"corner": (x, 0, 0), "size": (1, 1, 1), "cells": (2, 2, 2)}
            parts.add_box(model, f"box {i}", **box)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(E=1e5, nu=0.3, rho=1e3)
    bodies = [nts.Body(V, cells, tag[f"box {i}"], rubber) for i in range(4)]
    sides = [nts.boundary_of(body) for body in bodies]
    pairs = [
        nts.ContactPair(
            sides[i], sides[i + 1], enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        )
        for i in range(3)
    ]
    pairs.append(
        nts.ContactPair(
            sides[0],
            nts.RigidPlane((-5, 0, 0), (1, 0, 0)),
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
    )
    stepper = nts.EnergyMomentum(bodies, pairs, dt=0.01)
    stepper.set_velocity(bodies[0], (3.0, 0, 0))
    diagnostics = Diagnostics(stepper)
    assert diagnostics.min_gap() == pytest.approx(0.1)
    looked = []
    gap = PairState.gap

    def counted(contact, x, reach=np.inf):
        if pairs.index(contact.pair) not in looked:
            looked.append(pairs.index(contact.pair))
        return gap(contact, x, reach)

    monkeypatch.setattr(PairState, "gap", counted)
    for _ in range(12):
        least = min(
            comm.allgather(min(np.nanmin(gap(p, stepper.x), initial=9.9) for p in stepper.contacts))
        )
        assert diagnostics.min_gap() == pytest.approx(least, abs=1e-12)
        assert looked == [3, 1, 0] or looked == [3, 0, 1]
        with diagnostics.one_state() as now:
            now.gaps()
            looked.clear()
            assert diagnostics.min_gap() == least
            assert not looked
            stepper.advance()
            assert np.array_equal(diagnostics._now().x, stepper.x)  # not the state before
        looked.clear()
    # The facets around the nodes are found once.
    assert [c._far_search.num_searches for c in stepper.contacts[:3]] == [1, 1, 1]


def test_contact_of_one_state_is_summed_up_once(comm, monkeypatch, agree):
    """All numbers of all pairs take one pass, and one sum over ranks with the bulk."""
    stepper = blocks(comm).stepper
    for _ in range(3):
        stepper.advance()
    work = Counter()

    def counted(module, name):
        function = getattr(module, name)

        def call(*args):
            work[name] += 1
            return function(*args)

        monkeypatch.setattr(module, name, call)

    counted(_kernels, "contact_sums")
    counted(reductions, "total")
    diagnostics = Diagnostics(stepper)
    with diagnostics.one_state():
        balance, pairs = diagnostics.balance(), diagnostics.pairs()
        between = diagnostics.between()
        assert diagnostics.active_nodes() == balance.active_nodes > 0
        assert diagnostics.contact_energy() == balance.contact_energy
        assert not diagnostics.obstacles()
    assert agree(work == {"contact_sums": len(stepper.contacts), "total": 1})
    force = sum(pair.force for pair in pairs.values())
    np.testing.assert_allclose(force, balance.contact_force, rtol=TOLERANCE)
    (force,) = map(abs, between.values())
    np.testing.assert_allclose(force, abs(balance.contact_force), rtol=TOLERANCE)


def test_min_gap_is_nan_where_nothing_faces_and_without_pairs(comm):
    assert np.isnan(Diagnostics(two_boxes(comm, shift=(9.0, 0.0, HEIGHT))).min_gap())
    balance = Diagnostics(two_boxes(comm, pairs=False)).balance()
    assert np.isnan(balance.min_gap)
    assert balance.active_nodes == 0
    assert np.array_equal(balance.contact_force, np.zeros(3))


def test_balance_is_the_same_on_all_ranks_and_holds_every_number(comm):
    diagnostics = Diagnostics(two_boxes(comm))
    balance = diagnostics.balance()
    columns = balance.columns()
    assert all(other == columns for other in comm.allgather(columns))
    assert columns["total_energy"] == balance.kinetic_energy + balance.strain_energy
    assert [columns[f"linear_momentum_{axis}"] for axis in "xyz"] == [*balance.linear_momentum]


def test_wrong_arguments_are_refused(comm, refused):
    with refused(TypeError, "expected a stepper, given NoneType"):
        Diagnostics(None)
    body = two_boxes(MPI.COMM_WORLD).bodies[0]
    with refused(ValueError, "body of this stepper"):
        Diagnostics(two_boxes(comm)).centre_of_mass(body)


def test_diagnostics_print_their_stepper(comm):
    stepper = two_boxes(comm)
    assert repr(Diagnostics(stepper)) == f"Diagnostics(stepper={type(stepper).__name__})"
