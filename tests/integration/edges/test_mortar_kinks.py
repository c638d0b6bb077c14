"""Surface-to-surface contact above kinks of the segments: chamfers inside facets."""

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.compat import geometry_nodes
from helpers.once import once, once_except

E = 1.0e6  # Pa


def chamfered(
    slope: float, kink: float, *, cell="quadrilateral", degree=1, height=0.0, stiff=1, refined=1
):
    """A block with chamfered ends above a base with facets of 1 m: space, bodies, sides, held.

    The sole reaches from ``2 + kink`` to ``5 + kink`` in x, and the chamfers rise from there.
    """
    in_space = cell in ("hexahedron", "tetrahedron")

    def build(model: Any) -> None:
        make = nts.parts.add_box if in_space else nts.parts.add_rectangle
        up, across = (1,) * in_space, (0.3,) * in_space
        low = {"corner": (0, *(0,) * in_space, -2), "size": (8, *up, 2)}
        upper = {"corner": (1 + kink, *across, 0), "size": (5, *up, 2)}
        make(model, "base", cell=cell, cells=(8 * refined, *up, 4 * refined), **low)
        make(model, "block", cell=cell, cells=(10 * refined, *up, 4 * refined), **upper)

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    X = mesh.geometry.x
    above = np.unique(geometry_nodes(mesh)[cells.find(tag["block"])])
    x, z = X[above, 0], mesh.geometry.dim - 1
    beyond = np.maximum(np.abs(x - kink - 3.5) - 1.5, 0.0)
    X[above, z] += slope * beyond * (1 - X[above, z] / 2) + height
    V = fem.functionspace(mesh, ("Lagrange", degree, (mesh.geometry.dim,)))
    names = {"base": E, "block": stiff * E}
    base, block = (
        nts.Body(V, cells, tag[name], nts.NeoHookean(modulus, 0.3, 1e3))
        for name, modulus in names.items()
    )
    sides = [nts.Surface(V, facets, tag[name]) for name in ("base_top", "block_bottom")]

    def held(name: str, value: Any) -> fem.DirichletBC:
        dofs = fem.locate_dofs_topological(V, mesh.topology.dim - 1, facets.find(tag[name]))
        return fem.dirichletbc(np.array(value, dtype=float), dofs, V)

    return V, [base, block], sides, held


@pytest.mark.parametrize("kink", once_except([0.02, 0.25, 0.5, 0.75, 0.98], 0.25))
@pytest.mark.parametrize("slope", once_except([0.02, 0.2, 1.0], 0.2))
def test_a_chamfer_above_a_facet_does_not_press(slope, kink):
    """The sole touches the base without overlap, so that all gaps are zero or open."""
    _, bodies, sides, held = chamfered(slope, kink)
    pair = nts.ContactPair(*sides, method="mortar")
    bcs = [held("base_bottom", (0, 0)), held("block_top", (0, 0))]
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs)
    stepper.advance()
    assert np.abs(stepper.contacts[0].history.lambda_N).max(initial=0.0) <= 1e-9 * E


@pytest.mark.parametrize(
    "kind",
    once_except(
        {f"{c}-{d}": (c, d) for c in ("hexahedron", "tetrahedron", "triangle") for d in (1, 2)},
        *["tetrahedron-1", "hexahedron-2"],
    ),
)
def test_a_chamfer_does_not_press_in_all_cells(kind):
    cell, degree = kind
    V, bodies, sides, held = chamfered(0.2, 0.4, cell=cell, degree=degree)
    zero = np.zeros(V.mesh.geometry.dim)
    pair = nts.ContactPair(*sides, method="mortar")
    bcs = [held("base_bottom", zero), held("block_top", zero)]
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs)
    stepper.advance()
    assert np.abs(stepper.contacts[0].history.lambda_N).max(initial=0.0) <= 1e-9 * E


def force_below_loaded(method: str, refined: int) -> float:
    """Force on the base below a stiff block with chamfers that is pressed 5 mm into it [N/m]."""
    _, bodies, sides, held = chamfered(0.5, 0.5, stiff=100, refined=refined)
    pair = nts.ContactPair(*sides, method=method)
    bcs = [held("base_bottom", (0, 0)), held("block_top", (0, -0.005))]
    report = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs).advance()
    return report.reactions[0].force[1]


@pytest.mark.serial
def test_force_below_a_loaded_sole_with_chamfers_converges_to_that_of_a_fine_mesh(table_row):
    """Dual functions alone give four times the force on facets as long as the chamfer."""
    right, meshes = force_below_loaded("node-to-segment", 8), (1, 2, 4)
    errors, of_nodes = (
        [force_below_loaded(method, refined) / right - 1 for refined in meshes]
        for method in ("mortar", "node-to-segment")
    )
    texts = (", ".join(f"{100 * error:+.1f}" for error in each) for each in (errors, of_nodes))
    table_row(
        "force on a stiff block with chamfers, 1, 1/2 and 1/4 m facets",
        "node to segment with facets of 1/8 m",
        "mortar {} %; node to segment {} %".format(*texts),
    )
    coarse, middle, fine = np.abs(errors)
    assert fine < middle < coarse
    assert coarse <= 0.1
    assert middle <= 0.04


@pytest.mark.serial
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kink", [0.3, 0.5, 0.7])
def test_a_loaded_sole_stays_in_touch_next_to_its_chamfers(kink, degree):
    """Nodes of the base under the sole, which openings beyond the kink would press away from it."""
    V, bodies, sides, held = chamfered(0.3, kink, degree=degree)
    pair, down = nts.ContactPair(*sides, method="mortar"), 0.02
    bcs = [held("base_bottom", (0, 0)), held("block_top", (0, -down))]
    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs)
    stepper.advance()
    X, x = V.tabulate_dof_coordinates(), stepper.x
    base, sole = (side.nodes for side in sides)
    under = base[np.abs(X[base, 0] - 3.5 - kink) < 1.4]
    sole = sole[np.argsort(x[sole, 0])]
    opening = np.interp(x[under, 0], x[sole, 0], x[sole, 1]) - x[under, 1]
    assert opening.max() <= down / 4


@pytest.mark.serial
@pytest.mark.parametrize("angle", [105, 135])
@pytest.mark.parametrize("mu", [0.0, 0.5])
def test_a_leading_edge_that_leans_forward_does_not_push_the_floor(angle, mu):
    """A block is pressed on a floor and slides: the force along it is that of friction."""
    size = 0.25

    def build(model: Any) -> None:
        low = {"corner": (0, -0.5), "size": (3, 0.5), "cells": (12, 2)}
        nts.parts.add_rectangle(model, "floor", **low)
        upper = {"corner": (0.63, 0), "size": (0.75, 0.5), "cells": (3, 2)}
        nts.parts.add_rectangle(model, "block", **upper)

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_WORLD)
    X = mesh.geometry.x
    above = np.unique(geometry_nodes(mesh)[cells.find(tag["block"])])
    X[above, 0] += np.tan(np.radians(angle - 90)) * X[above, 1]
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    material = nts.NeoHookean(2e5, 0.3, 1.0)
    floor, block = (nts.Body(V, cells, tag[name], material) for name in ("floor", "block"))
    friction = nts.Coulomb(mu) if mu else None
    surfaces = nts.boundary_of(floor), nts.boundary_of(block)
    pair = nts.ContactPair(*surfaces, friction=friction, method="mortar")
    motion = fem.Constant(mesh, np.zeros(2))

    def update(t: float) -> None:
        motion.value[:] = size * max(t - 0.2, 0) / 0.8, -0.005 * min(t, 0.2) / 0.2

    def held(name: str, value: Any) -> fem.DirichletBC:
        return fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, facets.find(tag[name])), V)

    bcs = [held("floor_bottom", np.zeros(2)), held("block_top", motion)]
    stepper = nts.QuasiStatic([floor, block], [pair], dt=0.1, bcs=bcs, update=update)
    for report in stepper.run(until=1.0):
        force = report.reactions[1].force
        if report.t > 0.55:
            assert force[0] / -force[1] == pytest.approx(mu, abs=0.06)


@pytest.mark.parametrize(
    "impact",
    [once(("elastic",)), ("plastic",), once(("restitution", 0.0))],
    ids=lambda law: law[0],
)
@pytest.mark.parametrize("kink", [0.25, once(0.5)])
def test_impact_of_a_chamfered_block_begins_when_surfaces_touch(impact, kink):
    """The block flies flat onto the base: it touches after ten steps, not before."""
    V, bodies, sides, held = chamfered(0.5, kink, height=0.0101)
    pair = nts.ContactPair(*sides, method="mortar", enforcement=nts.LagrangeMultiplier(*impact))
    stepper = nts.EnergyMomentum(bodies, [pair], dt=1e-3, bcs=[held("base_bottom", (0, 0))])
    stepper.set_velocity(bodies[1], (0.0, -1.0))
    comm, first = V.mesh.comm, 0
    for report in stepper.run(until=0.012):
        pressed = bool((stepper.contacts[0].history.lambda_N < 0).any())
        if not first and comm.allreduce(pressed, op=MPI.LOR):
            first = report.step
    assert first in (10, 11)
