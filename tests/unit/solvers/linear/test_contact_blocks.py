"""Lists of nodes of any length, split and joined again."""

import numpy as np
import pytest

from dolfinx_nts.solvers.linear.contact_blocks import ContactBlocks
from helpers.contact_blocks import NODES, blocks, kinds, parts

pytestmark = pytest.mark.serial


@kinds
def test_parts_together_are_the_whole(kind, rng):
    whole = ContactBlocks(*blocks(kind, rng))
    m, p = len(whole.rank), len(whole.tangent)
    halves = [whole.take(np.arange(i, m, 2), np.arange(i, p, 2)) for i in range(2)]
    joined = ContactBlocks.concatenated([*halves, whole.take(np.arange(0), np.arange(0))])
    x, y = rng.normal(size=(2, NODES, 3))
    results = [y.copy(), y.copy()]
    for some, result in zip((whole, joined), results, strict=True):
        some.kernel().act(*parts(x), *parts(result))
    # The same sums in another order.
    np.testing.assert_allclose(*results, rtol=0, atol=1e-13 * np.abs(results[0]).max())
    order = [*range(0, m, 2), *range(1, m, 2)]
    again = joined.take(np.argsort(order), np.argsort([*range(0, p, 2), *range(1, p, 2)]))
    assert all(np.array_equal(a.ravel(), b.ravel()) for a, b in zip(again, whole, strict=True))


@kinds
def test_constraints_of_some_nodes_are_found(kind, rng):
    whole = ContactBlocks(*blocks(kind, rng))
    wanted = rng.permutation(NODES)[:6]
    lists = np.split(whole.nodes, whole.start[1:-1])
    flags = (np.isin(nodes, wanted) for nodes in (whole.nodes, whole.tangent_nodes))
    for found, items in zip(whole.touching(*flags), (lists, whole.tangent_nodes), strict=True):
        expected = [i for i, nodes in enumerate(items) if np.isin(nodes, wanted).any()]
        np.testing.assert_array_equal(found, expected)


def test_nodes_get_other_numbers_and_keep_their_lists(rng):
    whole = ContactBlocks(*blocks("ragged", rng))
    other = whole.renumbered(lambda nodes: nodes + 7)
    np.testing.assert_array_equal(other.nodes, whole.nodes + 7)
    np.testing.assert_array_equal(other.tangent_nodes, whole.tangent_nodes + 7)
    np.testing.assert_array_equal(whole.constrained, [1, 2, 3, 4])
    np.testing.assert_array_equal(other.constrained, [8, 9, 10, 11])
