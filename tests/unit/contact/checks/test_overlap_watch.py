"""Overlap checks of a run from start to end: one report for each overlap, with its cause."""

import logging

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from dolfinx_nts.common.archive import Snapshot
from dolfinx_nts.contact.checks import reverse_passage
from dolfinx_nts.contact.checks.overlap_watch import OverlapWatch
from helpers.models.crossing import crossed
from helpers.once import once

pytestmark = pytest.mark.at_most_two_ranks

SOFT = nts.NeoHookean(E=1e4, nu=0.3, rho=1e3)
STIFF = nts.NeoHookean(E=1e7, nu=0.3, rho=1e3)
FORGOTTEN = "no contact pair contains both"


class Scene:
    """A small stiff cube above a plate of coarse cells."""

    def __init__(self, comm, height=0.02, at=0.2, width=0.2):
        """Make the bodies and the surfaces that face each other."""

        def build(model):
            parts.add_box(model, "plate", corner=(0, 0, -0.5), size=(1, 1, 0.5), cells=(2, 2, 2))
            corner, size = (at, at, height), (width, width, width)
            parts.add_box(model, "cube", corner=corner, size=size, cells=(1, 1, 1))

        mesh, cells, facets, tag = nts.read_mesh(build, comm)
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        self.plate = nts.Body(V, cells, tag["plate"], SOFT)
        self.cube = nts.Body(V, cells, tag["cube"], STIFF)
        self.bodies = [self.plate, self.cube]
        self.top = nts.Surface(V, facets, tag["plate_top"])
        self.bottom = nts.Surface(V, facets, tag["cube_bottom"])

    def stepper(self, *pairs, dt=0.02, scheme=nts.EnergyMomentum):
        stepper = scheme(self.bodies, pairs, dt=dt)
        stepper.set_velocity(self.cube, (0.0, 0.0, -1.0))
        return stepper


@pytest.fixture
def reported_overlaps(comm, caplog):
    """Warnings of overlaps so far, as logged on rank 0. Collective."""
    caplog.set_level(logging.WARNING, "dolfinx_nts")

    def texts():
        warnings = [r.getMessage() for r in caplog.records if r.module == "overlap_watch"]
        assert comm.rank == 0 or not warnings
        return comm.bcast(warnings)

    return texts


def run(stepper, until):
    for _ in stepper.run(until=until):
        pass


def test_a_pair_with_wrong_roles_is_reported_once_with_names_and_advice(comm, reported_overlaps):
    scene = Scene(comm)
    # Nodes of the plate are next to the cube, whose vertices penetrate between them.
    stepper = scene.stepper(
        nts.ContactPair(
            scene.top, scene.bottom, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        )
    )
    run(stepper, 0.2)
    (text,) = reported_overlaps()
    assert "cube is up to 0." in text and "inside plate" in text
    assert "constrains only the nodes of plate" in text and "two_half_passes" in text
    (deepest,) = stepper.watch.overlaps.deepest.values()
    assert deepest.names == ("cube", "plate") and deepest.reverse_depth < deepest.depth


def test_a_missing_pair_is_reported_with_the_remedy(comm, reported_overlaps):
    stepper = Scene(comm).stepper()
    run(stepper, 0.3)
    (text,) = reported_overlaps()
    assert "cube" in text and "plate" in text and FORGOTTEN in text and "all_pairs" in text


def test_a_growing_overlap_is_reported_again_at_double_depth_or_at_cell_centres(
    comm, reported_overlaps
):
    stepper = Scene(comm).stepper()
    for _ in stepper.run(until=0.26):
        stepper.watch.overlaps.check(stepper.x, stepper.t, ())
    first, twice, cells = reported_overlaps()
    assert "up to 0.04 m inside" in first
    assert "up to 0.12 m inside" in twice and "cell centres inside: 0" in twice
    assert "up to 0.14 m inside" in cells and "cell centres inside: 1" in cells


def plate_and_cubes(comm, heights):
    """A plate, and a row of small cubes at ``heights`` over its top."""

    def build(model):
        parts.add_box(model, "plate", corner=(0, 0, -0.5), size=(2, 1, 0.5), cells=(4, 2, 2))
        for i, height in enumerate(heights):
            corner = (0.1 + 0.4 * i, 0.1, height)  # between the nodes of the plate
            parts.add_box(model, f"cube {i}", corner=corner, size=(0.2, 0.2, 0.2), cells=(1, 1, 1))

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    return [nts.Body(V, cells, tag[name], SOFT) for name in tag if name.count("_") == 0]


def watched_fall(bodies, num_steps):
    """Let cubes fall into the plate, with a check after each step."""
    stepper = nts.EnergyMomentum(bodies, dt=0.02)
    for body in bodies[1:]:
        stepper.set_velocity(body, (0.0, 0.0, -1.0))
    for _ in range(num_steps):
        stepper.advance()
        stepper.watch.overlaps.check(stepper.x, stepper.t, ())
    return stepper


def test_the_deepest_overlap_of_one_cause_is_reported_and_others_are_counted(
    comm, reported_overlaps
):
    bodies = plate_and_cubes(comm, [-0.02, -0.05, -0.03, -0.06, -0.04])
    nts.EnergyMomentum(bodies, dt=0.02).advance()
    (text,) = reported_overlaps()
    assert text.startswith("cube 3 starts up to 0.06 m inside plate (")
    assert f", and 4 more by less: {FORGOTTEN}" in text and text.count("inside plate") == 1


def test_overlaps_of_one_cause_are_reported_as_they_become_deeper(comm, reported_overlaps):
    stepper = watched_fall(plate_and_cubes(comm, [0.015, 0.035, 0.034]), num_steps=4)
    # Other overlaps are hardly deeper when detected. Each of two bodies is as deep in the other.
    (first,) = reported_overlaps()
    assert first.startswith("at t = 0.06 s, ") and "is up to 0.045 m inside" in first
    assert "cube 0" in first and "more by less" not in first
    stepper.check_overlaps()
    stepper.check_overlaps()
    _, last = reported_overlaps()
    assert last.startswith("until t = 0.08 s, ") and "was up to 0.046 m inside" in last
    assert "cube 2" in last and f", and 1 more by less: {FORGOTTEN}" in last


def test_working_contact_is_not_reported(comm, reported_overlaps):
    scene = Scene(comm)
    stepper = scene.stepper(
        nts.ContactPair(
            scene.bottom, scene.top, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        ),
        dt=0.002,
    )
    assert any(step.num_active for step in stepper.run(until=0.06))
    assert reported_overlaps() == []


def test_soft_springs_are_reported_as_the_cause(comm, reported_overlaps):
    scene = Scene(comm)
    pair = nts.ContactPair(
        scene.bottom, scene.top, nts.Penalty(eps_N=1.0), method="node-to-segment"
    )
    run(scene.stepper(pair), 0.2)
    (text,) = reported_overlaps()
    assert "springs" in text and "eps_N" in text


def test_explicit_runs_are_watched(comm, reported_overlaps):
    stepper = Scene(comm).stepper(dt=None, scheme=nts.CentralDifference)
    run(stepper, 0.12)
    (text,) = reported_overlaps()
    assert FORGOTTEN in text


def test_initial_overlaps_are_reported_before_the_first_step(comm, reported_overlaps):
    scene = Scene(comm, height=-0.05)
    stepper = scene.stepper(
        nts.ContactPair(
            scene.bottom, scene.top, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        )
    )
    stepper.set_velocity(scene.cube, (0.0, 0.0, 0.0))
    stepper.advance()
    (text,) = reported_overlaps()
    assert text.startswith("cube starts up to 0.05 m inside plate (0.18 of the longest facet; ")
    assert "nodes inside: 4," in text
    assert "harmless" in text
    run(stepper, 0.1)
    assert len(reported_overlaps()) == 1  # elastic impact keeps the depth, which is known


@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.QuasiStatic])
def test_bodies_that_start_deeper_than_half_of_their_thickness_are_refused(comm, refused, scheme):
    """The plate is 0.5 m thick."""
    scene = Scene(comm, -0.4)
    stepper = scheme(
        scene.bodies,
        [
            nts.ContactPair(
                scene.bottom,
                scene.top,
                enforcement=nts.LagrangeMultiplier(),
                method="node-to-segment",
            )
        ],
        dt=0.001,
    )
    with refused(ValueError, "4 nodes of .* up to 0.4 m inside plate, which is 0.5 m thick"):
        stepper.advance()


def sheet_and_cube(comm, height, cells, *, hole=False, motion=None, scheme=nts.QuasiStatic):
    """A cube of 1 m with its bottom at a height above a rigid sheet of square facets, 3 m wide.

    With a hole the sheet has none of its facets below the cube.
    """

    def build(model):
        parts.add_box(model, "cube", corner=(0, 0, height), size=(1, 1, 1), cells=(2, 2, 2))

    mesh, tags, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    cube = nts.Body(V, tags, tag["cube"], SOFT)
    y, x = 3 * np.indices((cells + 1, cells + 1)).reshape(2, -1) / cells - 1
    number = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    squares = [number[j : j + 2, i : i + 2].ravel() for j in range(cells) for i in range(cells)]
    points = np.stack([x, y, 0 * x], axis=1)
    if hole:
        middle = points[np.array(squares)].mean(axis=1)
        squares = np.array(squares)[np.abs(middle[:, :2] - 0.5).max(axis=1) > 0.5]
    sheet = nts.RigidSurface(points, np.array(squares), outside=(0.5, 0.5, 9.0))
    pair = nts.ContactPair(
        nts.Surface(V, facets, tag["cube_bottom"]),
        sheet.moving(motion) if motion else sheet,
        nts.Penalty(1e4) if scheme is nts.CentralDifference else None,
        method="node-to-segment",
    )
    bcs = []
    if scheme is nts.QuasiStatic:
        top = fem.locate_dofs_topological(V, 2, facets.find(tag["cube_top"]))
        bcs = [fem.dirichletbc(np.zeros(3), top, V)]
    return scheme([cube], [pair], dt=1e-3, bcs=bcs)


@pytest.mark.parametrize("cells", [3, 15])
@pytest.mark.parametrize("depth", [0.02, 0.3, 0.9])
@pytest.mark.parametrize("scheme", [nts.QuasiStatic, nts.EnergyMomentum, nts.CentralDifference])
def test_bodies_that_start_in_rigid_facets_are_refused_at_any_depth(
    comm, refused, scheme, depth, cells
):
    """Also deeper than half a facet, where nodes face none: 0.02 to 4.5 sides of a facet."""
    stepper = sheet_and_cube(comm, -depth, cells, scheme=scheme)
    message = rf"outside of obstacles, given 9 nodes of cube_bottom up to {depth:g} inside a Rigid"
    with refused(ValueError, message):
        stepper.advance()
    assert stepper.t == 0


@pytest.mark.parametrize(
    ("cells", "seen"), [(3, "as facets are seen to half"), (15, "no force acts")]
)
def test_a_refused_start_in_rigid_facets_names_place_and_remedy(comm, refused, cells, seen):
    down = nts.Motion(translation=lambda t: (0.0, 0.0, -0.1))
    message = rf"up to 0\.4 inside .*{seen}.* deepest at \(.*, -0\.5\).* move the two apart"
    with refused(ValueError, message):
        sheet_and_cube(comm, -0.5, cells, motion=down).advance()


@pytest.mark.parametrize(
    ("height", "hole"), [(0.1, False), (0.0, False), (-1.2, False), (-0.5, True)]
)
def test_bodies_that_do_not_start_in_rigid_facets_are_not_refused(comm, height, hole):
    """They are above, on and behind the sheet, and in a hole of it."""
    report = sheet_and_cube(comm, height, 15, hole=hole).advance()
    assert report.reactions[0].force[2] == 0


@pytest.mark.parametrize("inwards", [False, True])
@pytest.mark.parametrize("cells", [1, 12])
def test_bodies_within_a_closed_rigid_surface_are_refused_unless_it_is_a_container(
    comm, refused, inwards, cells
):
    """A box of 3 m with facets of 3 m and of 0.25 m around a cube of 1 m."""
    cube = sheet_and_cube(comm, 0.0, 3).bodies[0]
    steps = np.linspace(-1.5, 1.5, cells + 1)
    sheet = np.stack(np.meshgrid(steps, steps), axis=2).reshape(-1, 2)
    squares = np.arange((cells + 1) ** 2).reshape(cells + 1, -1)
    squares = [squares[j : j + 2, i : i + 2].ravel() for j in range(cells) for i in range(cells)]
    points, facets = [], []
    for axis in range(3):
        for side in (-1.5, 1.5):
            facets += [square + len(points) * len(sheet) for square in squares]
            points.append(np.insert(sheet, axis, side, axis=1))
    points, number = np.unique(np.vstack(points).round(9), axis=0, return_inverse=True)
    facets = number.ravel()[np.array(facets)]
    centres = points[facets].mean(axis=1)
    middle = np.full(3, 0.5)
    box = nts.RigidSurface(points + middle, facets, middle + (0 if inwards else 2) * centres)
    stepper = nts.EnergyMomentum([cube], nts.all_pairs([cube], obstacles=[box]), dt=1e-3)
    if inwards:
        assert stepper.advance().num_active == 0
    else:
        with refused(ValueError, "outside of obstacles, given .* inside"):
            stepper.advance()
        assert stepper.t == 0


@pytest.mark.serial
@pytest.mark.parametrize("cells", [4, 16])
def test_a_rigid_tip_that_sinks_between_nodes_is_reported_with_a_remedy(
    comm, reported_overlaps, cells
):
    def build(model):
        size, number = (1, 1, 0.5), (cells, cells, cells // 2)
        parts.add_box(model, "block", corner=(-0.37, -0.37, -0.5), size=size, cells=number)

    mesh, tags, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, tags, tag["block"], SOFT)
    corners = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    points = 0.2 * np.array([[0, 0, 0], *((x, y, 3) for x, y in corners)], dtype=float)
    sides = [[0, i, i % 4 + 1] for i in range(1, 5)]
    outside = 2 * points[np.array(sides)].mean(axis=1) - [0, 0, 0.4]
    tip = nts.RigidSurface(points, sides, outside, name="tip")
    tip = tip.moving(nts.Motion(translation=lambda t: (0, 0, -0.08 * t)))
    floor = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], -0.5))
    bcs = [fem.dirichletbc(np.zeros(3), floor, V)]
    pair = nts.ContactPair(nts.boundary_of(block), tip)
    stepper = nts.QuasiStatic([block], [pair], dt=0.5, bcs=bcs)
    list(stepper.run(until=1.0))
    texts = reported_overlaps()
    assert texts
    assert all("tip is up to" in text and "inside block" in text for text in texts)
    assert all("tip penetrates between them" in text and "RigidBody" in text for text in texts)


class Ring(nts.ExactObstacle):
    """A torus about z of the radii 0.1 and 0.06 m."""

    shortest_passage = 0.03

    def distance(self, x):
        out = np.linalg.norm(x[:, :2], axis=1)
        to_circle = np.column_stack([x[:, :2] * (1 - 0.1 / out)[:, None], x[:, 2]])
        length = np.linalg.norm(to_circle, axis=1)
        return length - 0.06, to_circle / length[:, None]


SMALL = {
    "sphere": nts.RigidSphere((0, 0, -0.15), 0.14),
    "cylinder": nts.RigidCylinder((0, 0, -0.15), (0, 1, 0), 0.14),
    "torus": Ring(),
}


@pytest.mark.serial
@pytest.mark.parametrize("obstacle", SMALL.values(), ids=SMALL)
@pytest.mark.parametrize("scheme", [nts.QuasiStatic, nts.EnergyMomentum, nts.CentralDifference])
def test_obstacles_smaller_than_the_facets_that_they_enter_are_reported(
    comm, reported_overlaps, scheme, obstacle
):
    """A block with facets of 0.6 m, pressed or thrown onto an obstacle below one of them."""
    base = 0.065 if isinstance(obstacle, Ring) else 0.0

    def build(model):
        parts.add_box(
            model, "block", corner=(-0.9, -0.9, base), size=(1.8, 1.8, 0.6), cells=(3, 3, 1)
        )

    mesh, tags, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    block = nts.Body(V, tags, tag["block"], STIFF)
    how = {}
    if scheme is nts.QuasiStatic:
        obstacle = obstacle.moving(nts.Motion(translation=lambda t: (0, 0, 10 * t)))
        top = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], base + 0.6))
        how["bcs"] = [fem.dirichletbc(np.zeros(3), top, V)]
    pair = nts.ContactPair(nts.boundary_of(block), obstacle)
    stepper = scheme([block], [pair], dt=5e-4, **how)
    if scheme is not nts.QuasiStatic:
        stepper.set_velocity(block, (0.0, 0.0, -10.0))
    # In dynamics the block passes the obstacle.
    list(stepper.run(until=0.01 if scheme is nts.QuasiStatic else 0.15))
    texts = reported_overlaps()
    assert texts
    assert all(" inside block" in text and "penetrates between them" in text for text in texts)


@pytest.mark.parametrize("is_rigid", [False, once(True)])
def test_edges_that_cross_without_a_pair_of_theirs_are_reported_with_the_remedy(
    comm, reported_overlaps, is_rigid
):
    scene = crossed(comm, is_rigid=is_rigid, edges=False)
    run(scene.stepper, 0.2)
    (text, *_) = reported_overlaps()
    assert "edges of both cross between nodes" in text and "edges=True" in text


def test_initial_overlaps_that_contact_does_not_detect_are_reported(comm, reported_overlaps):
    """Facets of the plate are 0.71 m long, and no node of it is inside the cube."""
    scene = Scene(comm, -0.05)
    pair = nts.ContactPair(
        scene.top, scene.bottom, nts.LagrangeMultiplier("plastic"), method="node-to-segment"
    )
    assert scene.stepper(pair, dt=0.001).advance().num_active == 0
    (text,) = reported_overlaps()
    assert text.startswith("cube starts up to 0.") and "inside plate" in text
    assert "does not detect this" in text and "harmless" not in text


def test_a_shrink_fit_found_by_contact_is_not_reported_as_undetected(comm, reported_overlaps):
    """Chords of the coarse ring go deeper into the fine one than its nodes, which contact sees."""
    fit, radius = 2e-3, 0.5  # m, a chord of 16 lies 9.6e-3 m below its arc

    def build(model):
        ends = {"centre": (0, 0, 0), "width": 0.1}
        inner, outer = radius + fit, 0.8
        nts.parts.add_ring(
            model, "shaft", inner_radius=0.3, outer_radius=inner, cells=(64, 2, 1), **ends
        )
        nts.parts.add_ring(
            model, "hub", inner_radius=radius, outer_radius=outer, cells=(16, 2, 1), **ends
        )

    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    steel = nts.SaintVenantKirchhoff(E=1e5, nu=0.3, rho=1e3)
    bodies = [nts.Body(V, cells, tag[name], steel) for name in ("shaft", "hub")]
    nodes, segments = (nts.Surface(V, facets, tag[n]) for n in ("hub_inner", "shaft_outer"))
    pair = nts.ContactPair(
        nodes, segments, nts.LagrangeMultiplier("plastic"), method="node-to-segment"
    )
    step = nts.EnergyMomentum(bodies, [pair], dt=1e-4).advance()
    assert step.num_active == 32
    (text,) = reported_overlaps()
    assert text.startswith("shaft starts up to 0.01") and "inside hub" in text
    assert "are 0.002 m inside" in text
    assert "shrink fit" in text and "does not see" not in text


def test_penetration_between_active_nodes_is_reported_as_the_cause(comm, reported_overlaps):
    """Edges of the plate go through the cube from the one node that touches it."""
    scene = Scene(comm, height=0.0, at=0.35, width=0.4)
    V, down = scene.top.V, fem.Constant(scene.top.V.mesh, (0.0, 0.0, 0.0))
    conditions = [
        fem.dirichletbc(value, fem.locate_dofs_geometrical(V, where), V)
        for value, where in ((down, lambda x: x[2] > 0.39), (np.zeros(3), lambda x: x[2] < -0.49))
    ]
    pair = nts.ContactPair(
        scene.top, scene.bottom, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )

    def update(t):
        down.value[2] = -t

    stepper = nts.QuasiStatic(scene.bodies, [pair], dt=0.1, bcs=conditions, update=update)
    run(stepper, 0.3)
    (text,) = reported_overlaps()
    assert comm.allreduce(np.nansum(np.abs(pair.history.gap))) < 1e-12
    (overlap,) = nts.Diagnostics(stepper).overlaps()
    assert overlap.reverse_depth > overlap.depth / 2
    assert "constrains only the nodes of plate" in text and "two_half_passes" in text


def test_a_body_placed_into_another_between_steps_is_reported(comm, reported_overlaps):
    scene = Scene(comm)
    stepper = scene.stepper(
        nts.ContactPair(
            scene.bottom, scene.top, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        )
    )
    stepper.set_velocity(scene.cube, (0.0, 0.0, 0.0))
    stepper.advance()
    assert reported_overlaps() == []
    stepper.set_displacement(scene.cube, (0.0, 0.0, -0.1))
    stepper.advance()
    (text,) = reported_overlaps()
    assert "starts up to 0.08 m inside" in text


def test_a_resumed_run_does_not_report_gaps_of_elastic_impact_as_initial_overlap(
    comm, reported_overlaps
):
    """The report starts at 1/50 of a facet at the start, and at 1/10 within a run."""
    scene, saved = Scene(comm, height=0.031), Snapshot()
    pair = nts.ContactPair(
        scene.bottom, scene.top, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    stepper = scene.stepper(pair)
    run(stepper, 0.04)
    (overlap,) = nts.Diagnostics(stepper).overlaps()
    assert 0.02 < overlap.depth / overlap.size < 0.1
    stepper.serialize(saved)
    resumed = scene.stepper(pair)
    resumed.serialize(saved.rewind())
    run(resumed, 0.06)
    assert reported_overlaps() == []


@pytest.mark.parametrize("moved", [None, -0.2])
def test_a_loaded_state_is_reported_if_it_is_deeper_than_its_contact_holds(
    comm, reported_overlaps, folder, moved
):
    scene = Scene(comm, height=0.01)
    pair = nts.ContactPair(scene.bottom, scene.top, nts.Penalty(200.0))
    stepper = scene.stepper(pair, dt=0.01)
    with nts.Recorder(folder / "run", stepper, checkpoint_every=1) as recorder:
        for step in stepper.run(until=0.1):
            recorder.write(step)
    (overlap,) = nts.Diagnostics(stepper).overlaps()
    assert 0.02 < overlap.depth / overlap.size and overlap.depth < 0.08
    before = len(reported_overlaps())
    other = scene.stepper(pair, dt=0.01)
    nts.load_state(folder / "run.checkpoint.h5", other)
    if moved:
        other.set_displacement(scene.cube, (0.0, 0.0, moved))
    other.advance()
    starts = [text for text in reported_overlaps()[before:] if "starts" in text]
    assert len(starts) == (1 if moved else 0)


def test_the_end_of_a_run_reports_the_largest_depth_of_an_overlap(comm, reported_overlaps):
    stepper = watched_fall(plate_and_cubes(comm, [0.015, 0.035]), num_steps=5)
    stepper.check_overlaps()
    first, last = reported_overlaps()
    assert "cube 0" in first and "is up to 0.045 m inside" in first
    assert "cube 1" in last and "was up to 0.065 m inside" in last


def test_a_small_overlap_at_the_end_of_a_run_is_reported(comm, reported_overlaps):
    scene = Scene(comm, height=0.01)
    stepper = scene.stepper(dt=0.05)
    run(stepper, 0.05)  # less than half of a cell
    (text,) = reported_overlaps()
    assert "at t = 0.05 s, cube is up to 0.04 m inside plate" in text


def test_a_recorder_checks_overlaps_at_the_end_of_a_user_loop(comm, reported_overlaps, tmp_path):
    stepper = Scene(comm, height=0.01).stepper(dt=0.05)
    name = comm.bcast(str(tmp_path / "run"))
    with nts.Recorder(name, stepper) as record:
        record.write(stepper.advance())
        assert reported_overlaps() == []
    assert len(reported_overlaps()) == 1
    assert "cube overlaps plate by up to 0.04 m at t = 0.05 s" in record.summary()


def test_overlap_with_an_obstacle_without_pair_is_reported(comm, reported_overlaps):
    scene = Scene(comm)
    floor = nts.RigidPlane((0, 0, -0.5), (0, 0, 1))
    wall = nts.RigidPlane((0.5, 0, 0), (1, 0, 0))
    away = nts.boundary_of(scene.plate, where=lambda x: x[0] > 0.9)
    stepper = scene.stepper(
        nts.ContactPair(away, wall, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"),
        nts.ContactPair(
            scene.bottom, floor, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        ),
    )
    stepper.advance()
    texts = reported_overlaps()
    assert any("cube starts" in t and "RigidPlane 1" in t and FORGOTTEN in t for t in texts)


@pytest.mark.serial
def test_no_overlap_check_while_bodies_are_apart(comm, monkeypatch):
    scene = Scene(comm, height=1.02)
    stepper = scene.stepper(dt=0.05)
    checks, check = [], OverlapWatch.check
    monkeypatch.setattr(OverlapWatch, "check", lambda *args: (checks.append(1), check(*args)))
    for _ in range(10):
        stepper.advance()
    assert not checks  # the cube has moved by less than half of the distance
    run(stepper, 2.0)
    assert 1 < len(checks) < 25


@pytest.mark.serial
def test_touching_bodies_are_checked_after_an_approach_of_a_cell(comm, monkeypatch):
    """The cube slides over the plate; clean checks prove that no vertex has passed a node."""
    scene = Scene(comm, height=0.0)
    stepper = scene.stepper(
        nts.ContactPair(
            scene.top, scene.bottom, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
        ),
        dt=0.005,
    )
    stepper.set_velocity(scene.cube, (1.0, 0.0, 0.0))
    checks, paths, check = [], [], OverlapWatch.check
    follow = reverse_passage.through_to_another_side
    monkeypatch.setattr(OverlapWatch, "check", lambda *args: checks.append(1) or check(*args))
    monkeypatch.setattr(
        reverse_passage, "through_to_another_side", lambda *args: paths.append(1) or follow(*args)
    )
    for _ in range(100):
        stepper.advance()
    run(stepper, 0.75)
    # Cells are 0.2 and 0.25 thick. There is one check at the end of the run, neither close to
    # another check nor beyond the edge of the plate.
    assert len(checks) == int(0.75 / (0.85 * 0.7 * 0.45)) + 1
    assert not paths


def test_round_bodies_that_touch_in_mortar_contact_press_on_each_other(comm, reported_overlaps):
    """The corner of a polygon touches the arc behind a chord, while mean gaps are open."""

    def build(model):
        occ = model.occ
        pin = occ.addDisk(0, -0.5, 0, 0.5, 0.5)
        occ.rotate([(2, pin)], 0, -0.5, 0, 0, 0, 1, -np.pi / 2)
        (cup,), _ = occ.cut(
            [(2, occ.addDisk(0, 0, 0, 1.5, 1.5))], [(2, occ.addDisk(0, 0, 0, 1, 1))]
        )
        occ.rotate([cup], 0, 0, 0, 0, 0, 1, np.pi / 12)
        occ.synchronize()
        for name, surface, number in (("pin", pin, 12), ("cup", cup[1], 12)):
            model.addPhysicalGroup(2, [surface], name=name)
            for _, curve in model.getBoundary([(2, surface)], oriented=False):
                model.mesh.setTransfiniteCurve(curve, number + 1)
        model.mesh.generate(2)

    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    bodies = [nts.Body(V, cells, tag[name], SOFT) for name in ("pin", "cup")]
    pin, cup = map(nts.boundary_of, bodies)
    nts.EnergyMomentum(bodies, [nts.ContactPair(cup, pin)], dt=1e-3).advance()
    (text,) = reported_overlaps()
    assert "starts up to" in text and "closes mean gaps over facets" in text
    assert "no force acts" not in text
