"""Reverse pass-through: segment vertices that leave the nodes' body on another side are named."""

from itertools import pairwise

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts.contact.checks.reverse_passage import ReversePassages
from helpers.models import box_meshes

pytestmark = pytest.mark.at_most_two_ranks

STONE = nts.NeoHookean(1e5, 0.3, 1e3)


class Bullet:
    """A small block 0.1 above a coarse plate of thickness 0.5; the plate gives the nodes."""

    def __init__(self, comm):
        """Make the bodies and the pair."""
        data = box_meshes.boxes([(1, 1, 1), (1, 1, 1)], [(4.0, 4.0, 0.5), (0.2, 0.2, 0.2)])
        plate, block = np.split(data.X, 2)
        plate += [-2, -2, -0.5] - plate.min(axis=0)
        block += [0.3, 0.4, 0.1] - block.min(axis=0)
        mesh, tags, _, _ = box_meshes.distribute(comm, data)
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        self.plate, self.block = (nts.Body(V, tags, number, STONE) for number in (0, 1))
        pair = nts.ContactPair(
            nts.boundary_of(self.plate),
            nts.boundary_of(self.block),
            enforcement=nts.LagrangeMultiplier(),
            method="node-to-segment",
        )
        self.X = V.tabulate_dof_coordinates()
        self.watch = ReversePassages([pair])

    def at(self, *shift):
        """Positions of all nodes with the block shifted."""
        x = self.X.copy()
        x[self.block.nodes] += shift
        return x


@pytest.mark.parametrize("num_steps", [1, 15])
def test_vertices_that_come_out_below_are_named_before_they_are_a_cell_away(comm, agree, num_steps):
    bullet = Bullet(comm)
    places = [bullet.at(0, 0, -z) for z in np.linspace(0, 1.35, num_steps + 1)]
    moved, reasons = 1.35 / num_steps, []
    for x_n, x in pairwise(places):
        reasons.append(bullet.watch.check(x_n, x, moved))
        bullet.watch.accept()
    assert agree(reasons == comm.bcast(reasons))
    # Four of them start 0.1 above the plate and have to move by 0.6.
    first, last = (int(np.floor(way / moved)) for way in (0.6, 0.6 + 0.5))
    assert not any(reasons[:first])
    assert any(
        "4 vertices of segments pass through" in reason for reason in reasons[first : last + 1]
    )
    assert all("let the finer surface give the nodes" in reason for reason in reasons if reason)


def test_vertices_that_sink_in_or_return_do_not_pass(comm):
    bullet = Bullet(comm)
    for down in (0.3, 0.0, -0.2):
        x_n, x = bullet.at(0, 0, 0), bullet.at(0, 0, -down)
        assert bullet.watch.check(x_n, x, 0.6) == ""


def test_a_failed_step_does_not_count(comm):
    bullet = Bullet(comm)
    start, below = bullet.at(0, 0, 0), bullet.at(0, 0, -0.9)
    for _ in range(2):
        assert "pass through" in bullet.watch.check(start, below, 0.9)


def test_pairs_of_both_directions_need_no_check_of_vertices(comm):
    bullet = Bullet(comm)
    surfaces = nts.boundary_of(bullet.plate), nts.boundary_of(bullet.block)
    watch = ReversePassages(nts.two_half_passes(*surfaces))
    assert watch.clearance == np.inf
    assert watch.check(bullet.at(0, 0, 0), bullet.at(0, 0, -0.9), 0.9) == ""
