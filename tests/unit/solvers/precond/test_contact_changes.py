"""Change of the contacts since the factorisation, and contact data that the factors need."""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from dolfinx_nts.solvers.linear.contact_blocks import ContactBlocks, rows_of, slopes_at_nodes
from helpers.contact_blocks import blocks, kinds

pytestmark = pytest.mark.serial


@kinds
def test_slopes_at_nodes_agree_with_the_tangent_there(kind, rng):
    whole = ContactBlocks(*blocks(kind, rng))
    found = slopes_at_nodes(whole)
    for part, slope, (_, gradients, columns) in zip(
        found, whole.slopes, rows_of(whole), strict=True
    ):
        expected = (columns.T @ slope @ gradients)[:3, :3]
        np.testing.assert_allclose(part, expected, rtol=0, atol=1e-14)


@kinds
def test_nodes_are_essential_that_constraints_or_slopes_reach(kind, rng):
    whole = ContactBlocks(*blocks(kind, rng))
    size, stiffness = 0.5, 1.0
    lists = whole.start, whole.rank, whole.gradients, whole.columns, whole.slopes
    keeps = np.split(_kernels.essential_nodes(*lists, size, stiffness), whole.start[1:-1])
    assert kind == 0 or not all(part.all() for part in keeps)
    for part, rank, slope, (_, *rows) in zip(
        keeps, whole.rank, whole.slopes, rows_of(whole), strict=True
    ):
        largest = [
            np.abs(row[:rank]).reshape(rank, len(part), 3).max(axis=(0, 2), initial=0.0)
            for row in rows
        ]
        expected = np.maximum(*largest) > size
        expected[0] = True
        gradients, columns = rows
        products = np.einsum("ai,ab,bj->abij", *map(np.abs, (columns, slope, gradients)))
        products = products.max(axis=(0, 1)).reshape(len(part), 3, len(part), 3).max(axis=(1, 3))
        expected |= np.maximum(products.max(axis=0), products.max(axis=1)) > stiffness
        np.testing.assert_array_equal(part, expected)


@kinds
def test_lists_keep_nodal_gradients_of_constraints(kind, rng):
    whole = ContactBlocks(*blocks(kind, rng))
    keeps = rng.random(len(whole.nodes)) < 0.5
    start, *rows = _kernels.at_nodes(whole.start, keeps, whole.gradients, whole.columns, 3)
    names = {"start": start, "nodes": whole.nodes[keeps]}
    found = rows_of(whole._replace(**names, gradients=rows[0], columns=rows[1]))
    lists = np.split(keeps, whole.start[1:-1])
    for keep, (nodes, *parts), (own, *some) in zip(lists, rows_of(whole), found, strict=True):
        np.testing.assert_array_equal(own, nodes[keep])
        for part, taken in zip(parts, some, strict=True):
            expected = part.reshape(3, -1, 3)[:, keep].reshape(3, -1)
            np.testing.assert_array_equal(taken, expected)
    with pytest.raises(ValueError, match="expected ascending offsets of the lists"):
        _kernels.at_nodes(whole.start, keeps[:-1], whole.gradients, whole.columns, 3)


def test_blocks_are_large_by_one_entry():
    tangent = np.zeros((3, 2, 2))
    tangent[0, 1, 0], tangent[2, 0, 1] = -0.6, 0.4
    assert _kernels.large_blocks(tangent, 0.5).tolist() == [True, False, False]


def test_constraints_have_moved_to_other_nodes_or_gradients(rng):
    before = rng.normal(size=(4, 3, 6))
    now, same = before.copy(), np.ones((4, 2), dtype=bool)
    now[0, 2, 5] += 0.1
    assert _kernels.num_moved(4, same.ravel(), now, before, 0.2) == 0
    now[1, 2, 5] -= 0.3
    same[1:3, 1] = False
    assert _kernels.num_moved(4, same.ravel(), now, before, 0.2) == 2
    with pytest.raises(ValueError, match="expected multiples of m as sizes"):
        _kernels.num_moved(3, same.ravel(), now, before, 0.2)


def test_wrong_lists_of_constraints_are_refused(rng):
    start, _, rank, _, gradients, columns, slopes, *_ = blocks("ragged", rng)
    with pytest.raises(ValueError, match="expected a block for each node"):
        _kernels.slopes_at_nodes(start, gradients[:-9], columns, slopes)
    with pytest.raises(ValueError, match="expected ascending offsets of the lists"):
        _kernels.slopes_at_nodes(start[::-1].copy(), gradients, columns, slopes)
    with pytest.raises(ValueError, match="expected numbers from 0 to the number of components"):
        _kernels.essential_nodes(start, rank + 1, gradients, columns, slopes, 0.5, 1.0)
