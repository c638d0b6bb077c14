"""Warning of round bodies in each other whose facets are too coarse for the gap."""

import logging
import math
import re

import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

pytestmark = pytest.mark.at_most_two_ranks

RUBBER = nts.NeoHookean(1e5, 0.3, 1e3)
WARNING = "fit each other with a gap of"


def warnings(caplog, comm, build, degree=1, **options):
    """Warnings when contact pairs of all bodies of a mesh are used."""
    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", degree, (mesh.geometry.dim,)))
    bodies = [nts.Body(V, cells, tag[name], RUBBER) for name in sorted(tag) if "_" not in name]
    with caplog.at_level(logging.WARNING):
        nts.EnergyMomentum(bodies, nts.all_pairs(bodies, **options), dt=1.0)
    return [each for each in caplog.messages if WARNING in each]


def pin_in_hole(gap, num_pin, num_hole, turned=0.0):
    """A pin of radius 1 m in a ring, with a number of facets each."""

    def build(model):
        occ, dim = model.occ, 2
        for name, radii, number in (
            ("pin", (0.3, 1.0), num_pin),
            ("ring", (1.0 + gap, 2.0), num_hole),
        ):
            inner, outer = ([(dim, occ.addDisk(0, 0, 0, r, r))] for r in radii)
            (surface,), _ = occ.cut(outer, inner)
            if name == "pin":
                occ.rotate([surface], 0, 0, 0, 0, 0, 1, turned)
            occ.synchronize()
            model.addPhysicalGroup(dim, [surface[1]], name=name)
            for _, curve in model.getBoundary([surface], oriented=False):
                model.mesh.setTransfiniteCurve(curve, number + 1)
        model.mesh.generate(dim)

    return build


@pytest.mark.parametrize(
    ("gap", "num_pin", "num_hole"), [(0.02, 40, 28), (0.02, 28, 40), (0.002, 40, 28)]
)
def test_coarse_pin_in_hole_is_reported(comm, caplog, gap, num_pin, num_hole):
    found = warnings(caplog, comm, pin_in_hole(gap, num_pin, num_hole, 0.03))
    assert len(found) == (comm.rank == 0)
    names = r"round surfaces of (pin and ring|ring and pin) fit"
    assert all(re.search(names, each) and "smooth=True" in each for each in found)


@pytest.mark.parametrize("part", [90, 60])  # degrees
def test_coarse_sector_of_a_tube_in_a_tube_is_reported(comm, caplog, part):
    """Sectors of models with symmetry planes, with other facets on each side."""

    def build(model):
        occ = model.occ
        for name, (inner, outer), number in (("balloon", (0.4, 0.5), 12), ("tube", (0.501, 1), 17)):
            line = occ.addLine(occ.addPoint(inner, 0, 0), occ.addPoint(outer, 0, 0))
            made = occ.revolve([(1, line)], 0, 0, 0, 0, 0, 1, math.radians(part), [number])
            (surface,) = [tag for dim, tag in made if dim == 2]
            occ.synchronize()
            model.addPhysicalGroup(2, [surface], name=name)
        model.mesh.generate(2)

    found = warnings(caplog, comm, build)
    assert len(found) == (comm.rank == 0)


@pytest.mark.parametrize(
    ("gap", "number", "turned", "options"),
    [
        (0.02, 160, 0.01, {}),  # fine facets
        (0.2, 40, 0.03, {}),  # wide gap
        (0.02, 40, 0.0, {}),  # nodes opposite each other
        (0.0, 40, 0.0, {}),  # at the same places
        (0.02, 40, 0.03, {"smooth": True, "method": "mortar"}),
    ],
)
def test_fits_that_facets_resolve_are_not_reported(comm, caplog, gap, number, turned, options):
    assert not warnings(caplog, comm, pin_in_hole(gap, number, number, turned), **options)


@pytest.mark.parametrize("kind", ["ball", "block"])
def test_bodies_that_touch_on_one_side_are_not_reported(comm, caplog, kind):
    def build(model):
        if kind == "ball":
            ball = {"cells_per_edge": 4, "layers": 2}
            parts.add_solid_ball(model, "top", centre=(0, 0, 1.01), radius=1.0, **ball)
        else:
            parts.add_box(model, "top", corner=(-1, -1, 0), size=(2, 2, 1), cells=(5, 5, 2))
        parts.add_box(model, "plate", corner=(-2, -2, -1), size=(4, 4, 1), cells=(6, 6, 2))

    assert not warnings(caplog, comm, build)


def with_facets(model, shapes):
    """Mesh surfaces of the plane, given by name with the number of facets along each curve."""
    model.occ.synchronize()
    for name, (surface, number) in shapes.items():
        model.addPhysicalGroup(2, [surface], name=name)
        for _, curve in model.getBoundary([(2, surface)], oriented=False):
            model.mesh.setTransfiniteCurve(curve, number + 1)
    model.mesh.generate(2)


def pin_in_slot(model):
    """A pin between the parallel faces of a slot."""
    occ = model.occ
    block = [(2, occ.addRectangle(-2, -2, 0, 4, 4))]
    (block,), _ = occ.cut(block, [(2, occ.addRectangle(-1.5, -1.002, 0, 3.5, 2.004))])
    with_facets(model, {"pin": (occ.addDisk(0, 0, 0, 1, 1), 28), "block": (block[1], 30)})


def ball_between_races(model):
    """A roller between two rings: it fits neither of them."""
    occ = model.occ
    rings = []
    for radii in ((1.0, 2.0), (4.004, 5.0)):
        inner, outer = ([(2, occ.addDisk(0, 0, 0, r, r))] for r in radii)
        (ring,), _ = occ.cut(outer, inner)
        rings.append(ring[1])
    roller = occ.addDisk(3.002, 0, 0, 1, 1)
    with_facets(model, {"inner": (rings[0], 60), "outer": (rings[1], 90), "roller": (roller, 24)})


def teeth(model):
    """Straight teeth of one rack between those of another."""
    occ, gap = model.occ, 0.05
    shapes = {}
    for name, side in (("lower", -1), ("upper", 1)):
        ends = [
            (-3, 0),
            *((x, side * (0.5 if i % 2 else -0.5)) for i, x in enumerate(range(-3, 4))),
        ]
        ends = [(x, y + side * gap) for x, y in ends[1:]]
        points = [occ.addPoint(x, y, 0) for x, y in [*ends, (3, 2 * side), (-3, 2 * side)]]
        lines = [occ.addLine(*pair) for pair in zip(points, points[1:] + points[:1], strict=True)]
        shapes[name] = occ.addPlaneSurface([occ.addCurveLoop(lines)]), 9 - 2 * side
    with_facets(model, shapes)


def plate_between_rollers(model):
    occ = model.occ
    rollers = {f"roller {x}": occ.addDisk(x, -0.5, 0, 0.5, 0.5) for x in (-2, 2)}
    rollers["punch"] = occ.addDisk(0, 0.9, 0, 0.5, 0.5)
    plate = occ.addRectangle(-3, 0, 0, 6, 0.4)
    shapes = {name: (surface, 24) for name, surface in rollers.items()}
    with_facets(model, {**shapes, "plate": (plate, 50)})


@pytest.mark.parametrize("build", [pin_in_slot, ball_between_races, teeth, plate_between_rollers])
def test_bodies_that_do_not_fit_are_not_reported(comm, caplog, build):
    assert not warnings(caplog, comm, build)


def test_two_bodies_of_several_are_named_and_others_counted(comm, caplog):
    """Two pins in the holes of one plate, beside a bar that touches it."""

    def build(model):
        occ = model.occ
        plate = [(2, occ.addRectangle(-2, -2, 0, 7, 4))]
        holes = [(2, occ.addDisk(x, 0, 0, 1.002, 1.002)) for x in (0, 3)]
        (plate,), _ = occ.cut(plate, holes)
        pins = [occ.addDisk(x, 0, 0, 1, 1) for x in (0, 3)]
        for pin in pins:
            occ.rotate([(2, pin)], occ.getCenterOfMass(2, pin)[0], 0, 0, 0, 0, 1, 0.03)
        shapes = {"left": (pins[0], 40), "right": (pins[1], 40), "plate": (plate[1], 28)}
        with_facets(model, {**shapes, "bar": (occ.addRectangle(-2, 2, 0, 7, 1), 20)})

    found = warnings(caplog, comm, build)
    assert len(found) == (comm.rank == 0)
    names = "of (plate and (left|right)|(left|right) and plate), and 1 more of other bodies, fit"
    assert all(re.search(names, each) for each in found)


def test_advice_at_degree_two_is_one_that_works_there(comm, caplog):
    found = warnings(caplog, comm, pin_in_hole(0.002, 20, 14, 0.03), degree=2)
    assert all("setOrder(2)" in each and "smooth" not in each for each in found)
    assert len(found) == (comm.rank == 0)
