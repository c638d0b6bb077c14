"""Nodes that should touch are moved onto segments: gaps, cells, ranks, statics, refusals."""

import logging

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.models import box_meshes, plane, rings
from helpers.once import once

EPS = np.finfo(float).eps
GAP = 0.01  # at most [m]
RUBBER = nts.NeoHookean(1.0e5, 0.3, 1.0e3)


class Blocks:
    """A block of 0.4 m on a wider one: meshes that do not match."""

    def __init__(self, cell="hexahedron", degree=1, *, wavy="top 0", sharp=False):
        """Make one face wavy by up to +-`GAP`; optionally with a flat cell above a node."""
        data = box_meshes.boxes([(5, 5, 2), (3, 3, 3)], [(0.6, 0.6, 0.2), (0.4, 0.4, 0.4)], cell)
        X, upper = data.X, np.unique(data.cells[data.body == 1])
        X[upper] += (0.1, 0.1, 0.2)
        waves = data.surfaces[wavy]
        X[waves, 2] += GAP * np.sin(13 * X[waves, 0]) * np.cos(9 * X[waves, 1])
        if sharp:
            X[np.isclose(X, (0.1, 0.1, 0.2 + 0.4 / 3)).all(axis=1), 2] = 0.202
        self.mesh, cells, facets, tag = box_meshes.distribute(MPI.COMM_WORLD, data)
        self.V = fem.functionspace(self.mesh, ("Lagrange", degree, (3,)))
        self.bodies = [nts.Body(self.V, cells, tag[f"body {i}"], RUBBER) for i in (0, 1)]
        self.nodes, self.segments = (
            nts.Surface(self.V, facets, tag[name]) for name in ("bottom 1", "top 0")
        )

    def pair(self, **options):
        """The upper block's nodes against the lower block's segments."""
        return nts.ContactPair(self.nodes, self.segments, **options)

    def press(self, pair):
        """Statics that press the upper block down by a hundredth of a gap."""
        bcs = [
            fem.dirichletbc(
                np.array([0.0, 0.0, depth]),
                fem.locate_dofs_geometrical(self.V, lambda x, z=z: np.isclose(x[2], z)),
                self.V,
            )
            for z, depth in ((0.0, 0.0), (0.6, -GAP / 100))
        ]
        return nts.QuasiStatic(self.bodies, [pair], dt=1.0, bcs=bcs)


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("cell", ["hexahedron", once("tetrahedron")])
@pytest.mark.parametrize(
    # Mean gaps of touching surfaces vanish where both are flat.
    ("method", "wavy"),
    [("node-to-segment", "top 0"), ("mortar", "bottom 1")],
)
def test_nodes_lie_on_segments_and_touch_from_the_first_step_on(cell, method, wavy, caplog):
    scene = Blocks(cell, wavy=wavy)
    pair, before = scene.pair(method=method), scene.mesh.geometry.x.copy()
    with caplog.at_level(logging.INFO, logger="dolfinx_nts"):
        moved, farthest = nts.close_gaps(pair, within=1.1 * GAP)
    assert moved == 16
    change = np.linalg.norm(scene.mesh.geometry.x - before, axis=1)
    assert MPI.COMM_WORLD.allreduce(change.max(), MPI.MAX) == pytest.approx(farthest)
    assert 0.5 * GAP < farthest < 1.1 * GAP
    if MPI.COMM_WORLD.rank == 0:
        assert "16 nodes of surface 3 were moved onto surface 2, by 0.00" in caplog.text
    # A second call moves nothing.
    assert nts.close_gaps(pair, within=1.1 * GAP)[0] == 0
    stepper = scene.press(pair)
    assert np.abs(stepper.contacts[0].gap(stepper.x)).max(initial=0.0) <= 1e2 * EPS
    assert nts.Diagnostics(stepper).strain_energy() == 0.0
    assert stepper.advance().num_active == 16
    unadjusted = Blocks(cell, wavy=wavy)
    assert unadjusted.press(unadjusted.pair(method=method)).advance().num_active < 16


@pytest.mark.at_most_two_ranks
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_gaps_in_the_plane_are_closed(cell):
    scene = plane.blocks(cell, angle=0.4)
    pair = nts.ContactPair(
        scene.nodes, scene.segments, enforcement=nts.LagrangeMultiplier(), method="node-to-segment"
    )
    moved, farthest = nts.close_gaps(pair, within=0.03)
    assert (moved, farthest) == (4, pytest.approx(0.02, rel=1e-12))
    stepper = nts.Midpoint([scene.lower, scene.upper], [pair], dt=0.01)
    assert np.abs(pair.gap(stepper.x)).max(initial=0.0) <= 1e2 * EPS
    assert nts.Diagnostics(stepper).strain_energy() == 0.0


@pytest.mark.at_most_two_ranks
def test_nodes_with_larger_gaps_are_not_moved():
    scene = Blocks()
    before = scene.mesh.geometry.x.copy()
    moved, farthest = nts.close_gaps(scene.pair(), within=0.3 * GAP)
    assert 0 < moved < 16
    assert 0 < farthest <= 0.3 * GAP
    assert np.abs(scene.mesh.geometry.x - before).max() <= 0.3 * GAP


def test_ranks_agree_on_the_adjusted_mesh():
    scene = Blocks()
    nts.close_gaps(scene.pair(), within=1.1 * GAP)
    geometry = scene.mesh.geometry
    rows = MPI.COMM_WORLD.allgather((geometry.input_global_indices, geometry.x))
    number, x = (np.concatenate(part) for part in zip(*rows, strict=True))
    first = np.unique(number, return_index=True)[1]
    np.testing.assert_array_equal(x, x[first][np.searchsorted(number[first], number)])


@pytest.mark.at_most_two_ranks
def test_invalid_adjustments_are_refused():
    scene = Blocks(sharp=True)
    pair, before = scene.pair(), scene.mesh.geometry.x.copy()
    with pytest.raises(TypeError, match="expected a ContactPair, given Surface"):
        nts.close_gaps(scene.nodes, GAP)
    with pytest.raises(ValueError, match="gaps are closed > 0, given 0"):
        nts.close_gaps(pair, 0.0)
    with pytest.raises(
        ValueError, match=r"a quarter of the height of the flattest cell .* given 1"
    ):
        nts.close_gaps(pair, 1.0)
    for segments in (scene.nodes, nts.RigidPlane((0, 0, 0), (0, 0, 1))):
        with pytest.raises(ValueError, match="a pair of two surfaces, whose gaps can be closed"):
            nts.close_gaps(
                nts.ContactPair(
                    scene.nodes,
                    segments,
                    enforcement=nts.LagrangeMultiplier(),
                    method="node-to-segment",
                ),
                GAP,
            )
    with pytest.raises(ValueError, match=r"no inverted cells after .* given 1, such as"):
        nts.close_gaps(pair, 1.1 * GAP)
    np.testing.assert_array_equal(scene.mesh.geometry.x, before)
    stepper = nts.Midpoint(scene.bodies, [pair], dt=0.01)
    with pytest.raises(ValueError, match="expected a pair that no stepper uses yet"):
        nts.close_gaps(pair, GAP)
    del stepper
    with pytest.raises(ValueError, match=r"degree 1 on straight cells, .* given degree 2"):
        nts.close_gaps(Blocks(degree=2).pair(), GAP)
    rounds = rings.ball_on_plate()
    with pytest.raises(ValueError, match="given an axisymmetric mesh"):
        nts.close_gaps(rounds.pairs()[0], GAP)
