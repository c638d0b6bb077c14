"""Projections that eliminate multipliers, against dense matrices."""

import numpy as np
import pytest

from dolfinx_nts import _kernels
from helpers.contact_blocks import NODES, ROUNDING, blocks, dense, kinds, parts

pytestmark = pytest.mark.serial


@kinds
def test_constrain_is_the_projection_on_the_constraints(kind, rng):
    arrays = blocks(kind, rng)
    E, G, _, _ = dense(*arrays)
    x = rng.normal(size=(NODES, 3))
    z = x.copy()
    _kernels.Elimination(*arrays).constrain(np.empty(0), *parts(z))
    expected = x.ravel() - E @ np.linalg.solve(G.T @ E, G.T @ x.ravel())
    np.testing.assert_allclose(z.ravel(), expected, atol=ROUNDING)
    assert np.abs(G.T @ z.ravel()).max() < ROUNDING


@kinds
def test_constrain_reaches_given_values(kind, rng):
    arrays = blocks(kind, rng)
    _, G, _, _ = dense(*arrays)
    values = rng.normal(size=(5, 3))
    x = np.zeros((NODES, 3))
    _kernels.Elimination(*arrays).constrain(values, *parts(x))
    wanted = values[np.arange(3) < arrays[2][:, None]]
    np.testing.assert_allclose(G.T @ x.ravel(), wanted, atol=ROUNDING)


@kinds
def test_act_adds_the_tangent_and_removes_multipliers(kind, rng):
    arrays = blocks(kind, rng)
    E, _, F, C = dense(*arrays)
    x, y = rng.normal(size=(2, NODES, 3))
    result = y.copy()
    removed = _kernels.Elimination(*arrays).act(*parts(x), *parts(result))
    total = y.ravel() + C @ x.ravel()
    multipliers = np.linalg.solve(E.T @ F, E.T @ total)
    has = np.arange(3) < arrays[2][:, None]
    np.testing.assert_allclose(removed[has], multipliers, atol=ROUNDING)
    assert np.all(removed[~has] == 0)
    expected = total - F @ multipliers
    np.testing.assert_allclose(result.ravel(), expected, atol=ROUNDING)
    assert np.abs(E.T @ result.ravel()).max() < ROUNDING


def test_nodes_move_along_their_normals_to_zero_gap(rng):
    normal, gradients = rng.normal(size=(5, 3)), rng.normal(size=(5, 3, 12))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    gradients[:, 0, :3] += 5 * normal
    gap = np.array([0.1, -0.2, 0.1, 15.0, np.nan])
    moves = np.array([True, True, False, True, True])
    nodes = np.arange(5, dtype=np.int32)
    x = np.zeros((NODES, 3))
    _kernels.close_gaps(nodes, moves, gap, normal, gradients, np.ones(5), x)
    # To first order in the displacements of the nodes themselves.
    change = np.einsum("mi,mi->m", gradients[:, 0, :3], x[:5])
    np.testing.assert_allclose(gap[:2] + change[:2], 0, atol=ROUNDING)
    assert np.abs(np.cross(x[:2], normal[:2])).max() < ROUNDING
    # Clamped, too far away, without a gap; and all nodes without contact.
    np.testing.assert_array_equal(x[2:], 0)


def test_wrong_lists_and_vectors_are_refused(rng):
    names = (
        *("start", "nodes", "rank", "normal", "gradients", "columns"),
        *("slopes", "tangent_nodes", "tangent"),
    )
    arrays = dict(zip(names, blocks("ragged", rng), strict=True))
    start, nodes, rank = arrays["start"], arrays["nodes"], arrays["rank"]
    lists = "strictly ascending offsets, from 0 to the length of nodes"
    for changed, match in (
        ({"nodes": -nodes - 1}, "nodes: expected no negative entry"),
        ({"tangent_nodes": -arrays["tangent_nodes"] - 1}, "nodes: expected no negative entry"),
        ({"start": start[:-1]}, "start: expected shape"),
        ({"start": start + 1}, lists),
        ({"start": start - [0, 0, 0, 0, 0, 1]}, lists),
        ({"start": np.array([0, 3, 3, 40, 52, 55])}, lists),
        ({"start": np.array([0, 33, 3, 40, 52, 55])}, lists),
        ({"rank": rank + 1}, "rank: expected 0, 1 or the number of components"),
        ({"normal": arrays["normal"][:, :2].copy()}, "slopes: expected shape"),
        ({"gradients": arrays["gradients"][:-1]}, "a block for each entry of nodes"),
        ({"columns": arrays["columns"][:-1]}, "a block for each entry of nodes"),
        ({"tangent": arrays["tangent"][:-1]}, "tangent: expected shape"),
    ):
        with pytest.raises(ValueError, match=match):
            _kernels.Elimination(**{**arrays, **changed})
    elimination = _kernels.Elimination(**arrays)
    with pytest.raises(ValueError, match="x: expected a row for each of the nodes"):
        elimination.constrain(np.empty(0), *parts(np.zeros((4, 3))))
    with pytest.raises(ValueError, match="y: expected a row for each of the nodes"):
        elimination.act(*parts(np.zeros((NODES, 3))), *parts(np.zeros((4, 3))))
    with pytest.raises(ValueError, match="values: expected shape"):
        elimination.constrain(np.zeros((4, 3)), *parts(np.zeros((NODES, 3))))


def test_without_contacts_nothing_happens(rng):
    x, y = rng.normal(size=(2, NODES, 3))
    none = np.zeros(1, dtype=np.int64), *np.zeros((2, 0), dtype=np.int32), np.zeros((0, 3))
    rows = np.empty(0), np.empty(0), np.empty((0, 3, 3))
    tangent = (np.empty((0, 4), np.int32), np.empty((0, 12, 12)))
    elimination, z = _kernels.Elimination(*none, *rows, *tangent), y.copy()
    elimination.constrain(np.empty((0, 3)), *parts(z))
    elimination.act(*parts(x), *parts(z))
    np.testing.assert_array_equal(z, y)
