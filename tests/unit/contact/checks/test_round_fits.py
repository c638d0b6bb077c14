"""Warning of round bodies in each other whose facets are too coarse for the gap."""

import logging

import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

pytestmark = pytest.mark.at_most_two_ranks

RUBBER = nts.NeoHookean(1e5, 0.3, 1e3)
WARNING = "fit each other with a gap of"


def warnings(caplog, comm, build, **options):
    """Warnings when contact pairs of all bodies of a mesh are used."""
    mesh, cells, _, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (mesh.geometry.dim,)))
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
    assert all("boundary of pin" in each and "smooth=True" in each for each in found)


@pytest.mark.parametrize(
    ("gap", "number", "turned", "options"),
    [
        (0.02, 160, 0.01, {}),  # fine facets
        (0.2, 40, 0.03, {}),  # wide gap
        (0.02, 40, 0.0, {}),  # nodes opposite each other
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
