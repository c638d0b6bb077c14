"""Statics in which a tool reaches a body within a step, from any distance, with all laws."""

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts
from helpers.laws import NODAL

pytestmark = pytest.mark.serial

RUBBER = nts.NeoHookean(1e6, 0.3, 1e3)
DEPTH, NEAR, FAR = 0.02, 0.03, 0.2  # m
LAWS = {
    "multipliers": {},
    "springs": {"enforcement": nts.Penalty()},
    "mortar": {"method": "mortar"},
    "mortar and springs": {"method": "mortar", "enforcement": nts.Penalty()},
}


def punched(tool, gap, *, crumb=0.0, **laws):
    """A sheet on which a punch moves down in one step; optionally a small cell next to it.

    The punch moves as a rigid body, or by supports at its top.
    """

    def build(model):
        boxes = {
            "sheet": ((-0.25, -0.1), (0.5, 0.1), (20, 4)),
            "punch": ((-0.1, gap), (0.2, 0.1), (6, 3)),
        }
        if crumb:
            boxes["crumb"] = ((2.0, 0.0), (crumb, crumb), (1, 1))
        for name, (corner, size, cells) in boxes.items():
            parts.add_rectangle(model, name, corner=corner, size=size, cells=cells)

    mesh, cells, facets, tag = nts.read_mesh(build, MPI.COMM_SELF)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    bodies = [nts.Body(V, cells, tag["sheet"], RUBBER)]
    driven, travel = fem.Constant(mesh, np.zeros(2)), DEPTH + gap
    held = fem.locate_dofs_geometrical(V, lambda x: (x[1] < -0.099) | (x[0] > 1.9))
    top = fem.locate_dofs_topological(V, 1, facets.find(tag["punch_top"]))
    bcs = [fem.dirichletbc(np.zeros(2), held, V)]
    if tool == "guide":
        guide = nts.Guide(motion=nts.Motion(lambda t: (0.0, -travel * t)))
        bodies.append(nts.RigidBody(V, cells, tag["punch"], 1e3, guide=guide))
    else:
        bodies.append(nts.Body(V, cells, tag["punch"], nts.NeoHookean(1e7, 0.3, 1e3)))
        bcs.append(fem.dirichletbc(driven, top, V))
    if crumb:
        bodies.append(nts.Body(V, cells, tag["crumb"], RUBBER))

    def update(t):
        driven.value[:] = 0.0, -travel * t

    sides = [nts.Surface(V, facets, tag[name]) for name in ("sheet_top", "punch_bottom")]
    pair = nts.ContactPair(*sides, friction=nts.Coulomb(0.1), **(NODAL | laws))
    return nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, update=update)


def force(stepper):
    """Reaction of all supports [N/m]."""
    step = stepper.advance()
    return step.reactions[0].force[1]


@pytest.mark.parametrize("law", LAWS)
def test_a_tool_from_far_away_presses_as_one_from_near(law):
    """The part of the displacement after first contact may be any."""
    near, far = (force(punched("guide", gap, **LAWS[law])) for gap in (NEAR, FAR))
    assert far == pytest.approx(near, rel=1e-4)


@pytest.mark.parametrize("tool", ["guide", "supports"])
def test_a_small_cell_elsewhere_costs_no_iterations(tool):
    """Increments of half a small cell would be twenty for supports."""
    usual, other = (
        punched(tool, NEAR, crumb=crumb).advance().newton_iterations for crumb in (0.0, 2e-3)
    )
    assert other <= usual + 3


def crossed(gap, law):
    """Two bars of square sections whose edges cross; the upper one moves down onto the lower."""
    half = 0.1 * np.sqrt(2)

    def build(model):
        for name, far, size, cells in (
            ("low", (-0.5, 50.0, 0.0), (1.0, 0.2, 0.2), (5, 2, 2)),
            ("up", (50.0, -0.5, 0.0), (0.2, 1.0, 0.2), (2, 5, 2)),
        ):
            parts.add_box(model, name, corner=far, size=size, cells=cells)

    mesh, cells, _, tag = nts.read_mesh(build, MPI.COMM_SELF)
    x = mesh.geometry.x
    for across, z, aside in ((1, -half, 0.003), (0, half + gap, 0.004)):
        own = x[:, across] > 40
        a, b = x[own, across] - 50.1, x[own, 2] - 0.1
        x[own, across], x[own, 2] = (a - b) / np.sqrt(2) + aside, (a + b) / np.sqrt(2) + z
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    low = nts.Body(V, cells, tag["low"], RUBBER)
    guide = nts.Guide(motion=nts.Motion(lambda t: (0, 0, -(DEPTH + gap) * t)))
    up = nts.RigidBody(V, cells, tag["up"], 1e3, guide=guide)
    held = fem.locate_dofs_geometrical(V, lambda x: x[2] < -1.9 * half)
    sides = nts.boundary_of(low), nts.boundary_of(up)
    pairs = [
        nts.ContactPair(*sides, law, method="node-to-segment"),
        nts.ContactPair(*sides, law, method="edge-to-edge"),
    ]
    bcs = [fem.dirichletbc(np.zeros(3), held, V)]
    return nts.QuasiStatic([low, up], pairs, dt=1.0, bcs=bcs)


@pytest.mark.parametrize("law", [nts.LagrangeMultiplier(), nts.Penalty()], ids=str)
def test_edges_meet_within_the_increment_from_any_start(law):
    near, far = (crossed(gap, law).advance().reactions[0].force[2] for gap in (NEAR, 0.4))
    assert near > 100.0
    assert far == pytest.approx(near, rel=1e-8)
