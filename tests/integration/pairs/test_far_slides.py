"""Steps in which mortar points slide over several segments."""

from mpi4py import MPI

import gmsh
import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.contact.implicit.mortar.frozen_points import SettlingPoints

pytestmark = pytest.mark.at_most_two_ranks

MU, RADIUS, TOP, DEPTH = 0.3, 1.2, 0.4, 0.3  # -, m, m, m
FACET, STEP = 0.125, 0.2  # of the block, and slide in a step; segments have 0.09 m


def ironing():
    """A stiff round tool that is pressed into a soft block, and slides over it from t = 1 on."""

    def build(model):
        occ = model.occ
        block, above = occ.addRectangle(0, 0, 0, 5, 1.5), occ.addRectangle(0, 1, 0, 4, 0.5 + TOP)
        disk = occ.addDisk(1.6, 1.5 + RADIUS, 0, RADIUS, RADIUS)
        ((_, tool),), _ = occ.intersect([(2, disk)], [(2, above)])
        occ.synchronize()
        for tag, name in ((block, "block"), (tool, "tool")):
            model.addPhysicalGroup(2, [tag], name=name)
        for _, curve in model.getEntities(1):
            x_min, _, _, x_max, _, _ = model.getBoundingBox(1, curve)
            is_of_block = curve in [c for _, c in model.getBoundary([(2, block)], oriented=False)]
            number = (40 if x_max - x_min > 1 else 8) if is_of_block else 22
            model.mesh.setTransfiniteCurve(curve, number + 1)
        model.mesh.setTransfiniteSurface(block)
        for tag in (block, tool):
            model.mesh.setRecombine(2, tag)
        for option, value in (
            ("Algorithm", 8),
            ("RecombinationAlgorithm", 2),
            ("MeshSizeMax", 0.25),
        ):
            gmsh.option.setNumber(f"Mesh.{option}", value)
        model.mesh.generate(2)

    mesh, cells, _, tags = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    bodies = [
        nts.Body(V, cells, tags[name], nts.NeoHookean(E, 0.3, 1.0))
        for name, E in (("block", 1.0), ("tool", 1e3))
    ]
    held, moved = (
        fem.locate_dofs_geometrical(V, lambda x, y=y: np.isclose(x[1], y)) for y in (0, 1.5 + TOP)
    )
    place = fem.Constant(mesh, np.zeros(2))
    pair = nts.ContactPair(*map(nts.boundary_of, bodies), friction=nts.Coulomb(MU), method="mortar")
    return nts.QuasiStatic(
        bodies,
        [pair],
        dt=0.5,
        bcs=[fem.dirichletbc(np.zeros(2), held, V), fem.dirichletbc(place, moved, V)],
        update=lambda t: np.copyto(place.value, (max(t - 1, 0) * STEP / 0.5, -DEPTH * min(t, 1))),
    )


def test_static_contact_holds_nodes_that_slide_over_several_segments():
    stepper = ironing()
    for number in range(6):
        step = stepper.advance()
        (overlap,) = nts.Diagnostics(stepper).overlaps()
        assert max(overlap.depth, overlap.reverse_depth) < 0.03 * FACET
        if number > 2:
            force = np.abs(step.reactions[0].force)
            assert abs(force[0] / force[1] - MU) < 0.015
    assert stepper.t == pytest.approx(3.0)


def test_static_step_in_which_nodes_lose_their_points_is_refused(monkeypatch):
    """The points are left out that are off their segments at t_n."""
    monkeypatch.setattr(SettlingPoints, "_slides_far", False)
    stepper = ironing()
    with pytest.raises(nts.ConvergenceError, match=r"inside the other .* up to 0.02\d* m deep"):
        for _ in range(6):
            stepper.advance()
    assert stepper.t == pytest.approx(1.5)


def sliding_block(facets):
    """A block under gravity that slides over ``facets`` segments of a floor in each step."""
    size, dt = 0.05, 0.02

    def build(model):
        parts.add_rectangle(model, "block", corner=(0, 0), size=(1, 0.5), cells=(4, 2))
        parts.add_rectangle(model, "floor", corner=(-1, -0.5), size=(3, 0.5), cells=(60, 2))

    mesh, cells, found, tags = nts.read_mesh(build, MPI.COMM_WORLD)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    block, floor = (
        nts.Body(V, cells, tags[name], nts.NeoHookean(E, 0.3, 1e3))
        for name, E in (("block", 1e6), ("floor", 1e7))
    )
    sides = (nts.Surface(V, found, tags[name]) for name in ("block_bottom", "floor_top"))
    base = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], -0.5))
    stepper = nts.EnergyMomentum(
        [block, floor],
        [nts.ContactPair(*sides, method="mortar")],
        dt=dt,
        bcs=[fem.dirichletbc(np.zeros(2), base, V)],
        loads=[nts.Gravity([block], (0.0, -50.0))],
    )
    stepper.set_velocity(block, (facets * size / dt, 0.0))
    return stepper


def test_slides_over_a_segment_are_held_with_inertia():
    stepper = sliding_block(0.8)
    for _ in range(4):
        assert stepper.advance().num_active == 5


def test_slides_over_many_segments_are_refused_with_inertia():
    """Points more than 1.25 segments outside of their own at t_n are left out."""
    stepper = sliding_block(3.0)
    with pytest.raises(nts.ConvergenceError, match=r"5 nodes .* inside the other surface without"):
        stepper.advance()
    assert stepper.t == 0
