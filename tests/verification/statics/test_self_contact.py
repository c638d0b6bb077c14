"""Self-contact: energy and momenta are conserved as in contact of two bodies."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import meshtags

import dolfinx_nts as nts
from dolfinx_nts.io import checkpoint
from helpers.laws import NODAL
from helpers.once import once, once_except
from helpers.scenes import part

CONSERVED = 1e-11
RUBBER = nts.SaintVenantKirchhoff(E=1e5, nu=0.3, rho=1e3)
LAWS = {
    "elastic": {"enforcement": nts.LagrangeMultiplier()},
    "plastic": {"enforcement": nts.LagrangeMultiplier("plastic")},
    "penalty": {"enforcement": nts.Penalty()},
    "sticking": {"enforcement": nts.LagrangeMultiplier(), "friction": nts.Coulomb(0.3)},
    "rubbing springs": {"enforcement": nts.Penalty(), "friction": nts.Coulomb(0.3)},
}


def ring(comm, cell="hexahedron"):
    """A soft ring, its inner surface."""
    shape = {"inner_radius": 0.94, "outer_radius": 1.0, "width": 0.2, "cells": (48, 2, 1)}
    V, cells, facets, tag = part(comm, "ring", cell, centre=(0, 0, 0), **shape)
    return nts.Body(V, cells, tag["ring"], RUBBER), nts.Surface(V, facets, tag["ring_inner"])


def ball(comm):
    """A hollow ball, its inner surface."""
    shape = {"inner_radius": 0.95, "outer_radius": 1.0, "cells_per_edge": 6, "layers": 1}
    V, cells, facets, tag = part(comm, "hollow_ball", centre=(0, 0, 0), **shape)
    inner = nts.Surface(V, facets, tag["hollow_ball_inner"])
    return nts.Body(V, cells, tag["hollow_ball"], RUBBER), inner


def squeezed(body, pair, speed, dt, scheme=nts.EnergyMomentum):
    """Body whose top and bottom fly towards each other."""
    stepper = scheme([body], [pair], dt=dt)
    x, y, z = body.V.tabulate_dof_coordinates()[body.nodes].T
    stepper.set_velocity(body, np.array([0.7 - 0.1 * z, 0.3 * x - speed * y, 0.2 + 0 * x]))
    return stepper


def check(stepper, pair, until, comm):
    """Run; returns the most active nodes and the final balance."""
    diagnostics = nts.Diagnostics(stepper)
    before, lost, most = diagnostics.balance(), 0.0, 0
    scale = np.abs(stepper.nodal_momentum()).sum()
    for report in stepper.run(until):
        lost += comm.allreduce(pair.history.dissipation.sum())
        most = max(most, report.num_active)
        works = report.contact_work
        # A loaded spring that slides over a free edge releases its energy.
        lost -= works.facet_change
        if isinstance(pair.enforcement, nts.LagrangeMultiplier):
            lost -= works.persistent + works.activation
    after = diagnostics.balance()
    scale = comm.allreduce(scale)
    error = abs(after.total_energy + lost - before.total_energy) / before.total_energy
    assert error < CONSERVED
    for name in ("linear_momentum", "angular_momentum"):
        change = np.abs(getattr(after, name) - getattr(before, name)).max()
        assert change < CONSERVED * scale, name
    return most, lost / before.total_energy


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("law", once_except(list(LAWS), "sticking"))
def test_ring_squeezed_until_its_walls_meet_keeps_energy_and_momenta(comm, law):
    body, inner = ring(comm)
    pair = nts.ContactPair(inner, inner, **(NODAL | LAWS[law]))
    stepper = squeezed(body, pair, 2.2, 0.005)
    most, lost = check(stepper, pair, 0.85, comm)
    assert most > 1
    assert abs(lost) < CONSERVED if law in ("elastic", "penalty") else 0 < lost < 0.1
    # Its walls have not passed each other.
    assert nts.Diagnostics(stepper).min_gap() > -0.02


@pytest.mark.serial
@pytest.mark.at_most_two_ranks
def test_whole_boundary_of_a_ring_touches_itself_as_its_inside_does(comm):
    body, inner = ring(comm)
    found = []
    for pair in (
        nts.ContactPair(
            inner, inner, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        ),
        *nts.all_pairs(
            [body],
            self_contact=[body],
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        ),
    ):
        stepper = squeezed(body, pair, 2.2, 0.005)
        most, _ = check(stepper, pair, 0.66, comm)
        assert most > 0
        found.append(stepper.u.x.array.copy())
    assert np.abs(found[1] - found[0]).max(initial=0.0) < 1e-9


def bars(comm):
    """Two bars of one body, the upper one shifted to the left by 0.3 m; the surface of both."""

    def build(model):
        nts.parts.add_rectangle(model, "low", corner=(0, 0), size=(3, 1), cells=(3, 1))
        nts.parts.add_rectangle(model, "up", corner=(-0.3, 1.1), size=(3, 1), cells=(3, 1))

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    whole = meshtags(mesh, 2, cells.indices, np.ones_like(cells.values))
    inner = np.sort(np.concatenate([facets.find(tag[name]) for name in ("low_top", "up_bottom")]))
    surface = nts.Surface(V, meshtags(mesh, 1, inner, np.ones_like(inner)), 1)
    outer = np.concatenate([facets.find(tag[name]) for name in ("low_bottom", "up_top")])
    return nts.Body(V, whole, 1, RUBBER), surface, outer


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("side", [1, once(-1)])
def test_corner_is_held_where_the_other_wall_ends_before_it(comm, side):
    body, surface, outer = bars(comm)
    V, given = body.V, fem.Function(body.V)

    def move(t):
        """Lower the upper bar by 0.12 m in the first step, tilt it by 0.1 in the second one."""
        tilt = 0.1 * side * (t - 1)

        def at(x):
            above = x[1] > 2
            return np.stack([0 * x[0], above * (-0.12 - tilt * (x[0] - 1.35))])

        given.interpolate(at)

    bc = fem.dirichletbc(given, fem.locate_dofs_topological(V, 1, outer))
    pair = nts.ContactPair(
        surface, surface, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    stepper = nts.QuasiStatic([body], [pair], dt=1, bcs=[bc], update=move)
    for _ in stepper.run(2):
        pass
    X, x = (
        np.concatenate(comm.allgather(each[body.nodes]))
        for each in (V.tabulate_dof_coordinates(), stepper.x)
    )
    low, up = (
        np.unique(np.column_stack([X[:, 0], x])[np.isclose(X[:, 1], y)], axis=0) for y in (1.0, 1.1)
    )
    depths = [np.interp(low[:, 1], up[:, 1], -up[:, 2], left=-np.inf, right=-np.inf) + low[:, 2]]
    depths += [np.interp(up[:, 1], low[:, 1], low[:, 2], left=-np.inf, right=-np.inf) - up[:, 2]]
    assert max(map(np.max, depths)) < 0.02


@pytest.mark.serial
@pytest.mark.at_most_two_ranks
def test_ring_of_tetrahedra_keeps_energy_and_momenta(comm):
    body, inner = ring(comm, "tetrahedron")
    pair = nts.ContactPair(
        inner, inner, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    most, lost = check(squeezed(body, pair, 3.2, 0.0025), pair, 0.47, comm)
    assert most > 0
    assert abs(lost) < CONSERVED


@pytest.mark.at_most_two_ranks
def test_failed_steps_are_cut_and_leave_no_trace(comm):
    body, inner = ring(comm)
    pair = nts.ContactPair(
        inner, inner, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    stepper = squeezed(body, pair, 2.2, 0.02)
    diagnostics = nts.Diagnostics(stepper)
    energy, rejected = diagnostics.balance().total_energy, 0
    for report in stepper.run(0.7, control=nts.StepControl()):
        rejected += report.rejected
    assert rejected > 0
    assert diagnostics.balance().total_energy == pytest.approx(energy, rel=CONSERVED)


def test_run_goes_on_from_a_checkpoint_on_any_number_of_ranks(comm, tmp_path):
    path = comm.bcast(tmp_path) / "run.h5"

    def start(of):
        body, inner = ring(of)
        return squeezed(
            body,
            nts.ContactPair(
                inner, inner, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
            ),
            2.2,
            0.005,
        )

    whole, again, alone = start(comm), start(comm), start(MPI.COMM_SELF)
    active = [report.num_active for report in whole.run(0.65)]
    checkpoint.save(path, whole)
    balances = []
    for stepper in (whole, again, alone):
        if stepper is not whole:
            checkpoint.load(path, stepper)
        active += [report.num_active for report in stepper.run(0.68)]
        balances.append(np.array(list(nts.Diagnostics(stepper).balance().columns().values())))
    assert max(active) > 0
    for other in balances[1:]:
        assert np.allclose(other, balances[0], rtol=1e-9, atol=1e-9, equal_nan=True)


@pytest.mark.at_most_two_ranks
def test_crushed_ball_keeps_energy_and_momenta(comm):
    body, inner = ball(comm)
    pair = nts.ContactPair(
        inner, inner, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    most, lost = check(squeezed(body, pair, 4.0, 0.005), pair, 0.45, comm)
    assert most > 0
    assert abs(lost) < CONSERVED


@pytest.mark.at_most_two_ranks
def test_explicit_ring_keeps_its_momenta_and_its_energy_to_one_per_cent(comm):
    body, inner = ring(comm)
    pair = nts.ContactPair(inner, inner, nts.Penalty(), method="node-to-segment")
    stepper = squeezed(body, pair, 2.2, 5e-4, nts.CentralDifference)
    diagnostics = nts.Diagnostics(stepper)
    before = diagnostics.balance()
    scale = comm.allreduce(np.abs(stepper.nodal_momentum()).sum())
    assert max(report.num_active for report in stepper.run(0.9)) > 1
    after = diagnostics.balance()
    assert after.total_energy == pytest.approx(before.total_energy, rel=1e-2)
    for name in ("linear_momentum", "angular_momentum"):
        change = np.abs(getattr(after, name) - getattr(before, name)).max()
        assert change < CONSERVED * scale, name


def cracked_block(comm):
    """A block of 1 m x 1 m in the plane with a closed crack from its middle to its right side."""
    n = 8

    def build(model):
        t = np.linspace(0.0, 1.0, n + 1)
        x, y = np.meshgrid(t, t, indexing="ij")
        points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
        below = np.arange(x.size).reshape(x.shape)
        above = below.copy()
        opened = t > 0.5
        above[opened, n // 2] = x.size + np.arange(np.count_nonzero(opened))
        points = np.vstack([points, points[below[opened, n // 2]]])
        quads = []
        for i, j in np.ndindex(n, n):
            number = above if j >= n // 2 else below
            corners = ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))
            quads += [number[corner] + 1 for corner in corners]
        entity = model.addDiscreteEntity(2)
        model.mesh.addNodes(2, entity, range(1, len(points) + 1), points.ravel())
        model.mesh.addElementsByType(entity, 3, range(1, n * n + 1), quads)
        model.addPhysicalGroup(2, [entity], name="block")

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    return nts.Body(V, cells, tag["block"], RUBBER)


@pytest.mark.parametrize("law", ["elastic", once("penalty"), once("rubbing springs")])
def test_walls_of_a_crack_that_starts_closed_are_kept_apart(comm, law):
    body = cracked_block(comm)
    whole = nts.boundary_of(body)
    pair = nts.ContactPair(whole, whole, **(NODAL | LAWS[law]))
    stepper = nts.EnergyMomentum([body], [pair], dt=2e-3)
    X = body.V.tabulate_dof_coordinates()[body.nodes]
    cells = body.V.dofmap.list
    middle = body.V.tabulate_dof_coordinates()[cells].mean(axis=1)
    upper = np.isin(body.nodes, cells[middle[:, 1] > 0.5])
    is_right = np.maximum(X[:, 0] - 0.5, 0)
    stepper.set_velocity(body, np.array([0 * is_right, np.where(upper, -8, 0) * is_right]))
    most, _ = check(stepper, pair, 0.04, comm)
    assert most >= 3
    assert all(overlap.depth < 0.02 for overlap in nts.Diagnostics(stepper).overlaps())
