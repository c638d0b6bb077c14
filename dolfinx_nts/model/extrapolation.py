"""Extrapolation of affine fields from the nodes of a body to nodes of its surface.

A node of the surface gets a weighted sum of the values at nodes below it. If two nodes are
collinear with it, as in meshes swept from the surface, these are used. Otherwise twelve or more
neighbours are fitted by weighted least squares.
"""

from collections.abc import Sequence
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
from dolfinx import la

from dolfinx_nts.common.arrays import Floats, GlobalInts, Ints, indices
from dolfinx_nts.fem.node_numbering import input_ids, listed, reference_positions
from dolfinx_nts.fem.surroundings import add_surroundings
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.connected_bodies import connected
from dolfinx_nts.parallel.communication import joined

__all__ = ["Extrapolation", "extrapolate", "group_of_nodes"]

# Depth of the neighbours below the surface [cells].
_LAYERS = 2
# Numbers of neighbours in a least-squares fit [-], tried in turn: the nearest ones may lie in one
# layer.
_FITTED = (12, 20, 40)
# Sum of absolute weights [-] up to which a fit is used at once, and up to which it is accepted. It
# is 3 with two equidistant nodes on a line.
_GOOD, _MOST = 4.0, 10.0
# Sine of an angle, and relative difference of distances [-], that count as round-off.
_ROUND_OFF = 1e-10
# Largest extrapolation along a line, relative to the distance of its two nodes [-].
_FARTHEST = 2.0
# Relative error for affine fields [-] above which a fit is rejected.
_ERROR = 1e-8
# Number of distances that are computed at a time [-], to save memory.
_CHUNK = 2_000_000


class Extrapolation(NamedTuple):
    """Sparse matrix (CSR) that extrapolates values of other nodes to surface nodes.

    Attributes:
        node: Owned surface nodes, sorted, shape ``(m,)``.
        start: Offsets of the rows, shape ``(m + 1,)``.
        column: Global numbers of the other nodes, shape ``(b,)``.
        weight: Their weights, shape ``(b,)`` [-].
    """

    node: Ints
    start: GlobalInts
    column: GlobalInts
    weight: Floats


class _Neighbours(NamedTuple):
    """Nodes near the surface, from all ranks.

    Attributes:
        number: Global numbers, shape ``(k,)``.
        id: Numbers that do not depend on the partition, shape ``(k,)``.
        X: Positions, shape ``(k, 3)`` [m].
        group: Number of the group of connected bodies, shape ``(k,)``.
    """

    number: GlobalInts
    id: GlobalInts
    X: Floats
    group: Ints


def group_of_nodes(bodies: Sequence[Body]) -> Ints:
    """Number of the group of connected bodies of each local node. Collective.

    Args:
        bodies: Bodies of one space, which fill the mesh.

    Returns:
        Numbers from 0, shape ``(l,)``.
    """
    index_map = bodies[0].V.dofmap.index_map
    group_of = np.zeros(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
    for number, group in enumerate(connected(bodies)):
        for body in group:
            group_of[body.nodes] = number
    return group_of


def extrapolate(bodies: Sequence[Body], nodes: Ints) -> Extrapolation:
    """Compute the weights of an extrapolation to surface nodes. Collective.

    It is exact for affine fields, and does not depend on the partition.

    Args:
        bodies: Bodies of one space, which fill the mesh.
        nodes: Owned nodes of the surface, sorted, shape ``(m,)``.

    Raises:
        ValueError: A body has no more than one layer of nodes below the surface.
    """
    V = bodies[0].V
    comm: MPI.Comm = V.mesh.comm
    X, group = reference_positions(V), group_of_nodes(bodies)
    below = _neighbours(bodies, nodes, group)
    rows = []
    size = max(1, _CHUNK // max(1, len(below.id)))
    for first in range(0, len(nodes), size):
        some = nodes[first : first + size]
        distance = np.linalg.norm(X[some, None] - below.X, axis=2)
        distance[group[some, None] != below.group] = np.inf
        rows += [_row(X[node], d, below) for node, d in zip(some, distance, strict=True)]
    ids = input_ids(V)[nodes[[row is None for row in rows]]]
    thin = np.sort(joined(comm, ids))
    if len(thin):
        raise ValueError(
            "expected two layers of nodes below a surface with impact 'resolved', as they carry "
            f"the mass of the surface, given fewer at {len(thin)} nodes: {listed(thin)}; use more "
            "cells through the thickness, displacements of degree 2, a smaller surface, or impact "
            "'elastic'"
        )
    found = [row for row in rows if row is not None]
    counts = np.cumsum([0, *(len(column) for column, _ in found)])
    column = np.concatenate([np.empty(0, dtype=np.int64), *(below.number[c] for c, _ in found)])
    weight = np.concatenate([np.empty(0), *(weight for _, weight in found)])
    return Extrapolation(nodes, counts, column, weight)


def _neighbours(bodies: Sequence[Body], nodes: Ints, group: Ints) -> _Neighbours:
    """Nodes of all ranks within `_LAYERS` cells of ``nodes``, without ``nodes``. Collective."""
    V = bodies[0].V
    index_map = V.dofmap.index_map
    n, marker = index_map.size_local, la.vector(index_map)
    marker.array[nodes] = 1
    given = marker.array > 0
    add_surroundings(marker, V, _LAYERS)
    below = indices((marker.array > 0)[:n] & ~given[:n])
    own = (
        np.asarray(index_map.local_to_global(below)),
        input_ids(V)[below],
        reference_positions(V)[below],
        group[below],
    )
    return _Neighbours(*(joined(V.mesh.comm, values) for values in own))


def _combine_flags(marker: la.Vector) -> None:
    """Combine the flags of all ranks at shared nodes. Collective."""
    marker.scatter_reverse(la.InsertMode.add)
    marker.scatter_forward()


def _row(x: Floats, distance: Floats, below: _Neighbours) -> tuple[Ints, Floats] | None:
    """Neighbours of a node and their weights; None if no weights reproduce affine fields."""
    num_looked_at = min(_FITTED[-1], int(np.count_nonzero(np.isfinite(distance))))
    if not num_looked_at:
        return None
    near = np.argpartition(distance, num_looked_at - 1)[:num_looked_at].astype(np.int32)
    # At equal distances the order is by node number.
    length = np.round(distance[near] / distance[near].min() / _ROUND_OFF) * _ROUND_OFF
    near = near[np.lexsort((below.id[near], length))]
    offset = below.X[near] - x
    if (line := _line(near, offset)) is not None:
        return line
    best: tuple[Ints, Floats] | None = None
    least = _MOST
    for number in _FITTED:
        if (fit := _fit(near, offset, number)) is not None and (
            size := np.abs(fit[1]).sum()
        ) < least:
            best, least = fit, size
        if least <= _GOOD:
            break
    return best


def _line(near: Ints, offset: Floats) -> tuple[Ints, Floats] | None:
    """Weights of the nearest node and of a second one on the same line; None without one."""
    first, others = offset[0], offset[1:] - offset[0]
    length, lengths = np.linalg.norm(first), np.linalg.norm(others, axis=1)
    sine = np.linalg.norm(np.cross(others, first), axis=1) / (length * lengths)
    beyond = (sine < _ROUND_OFF) & (others @ first > 0) & (length <= _FARTHEST * lengths)
    if not beyond.any():
        return None
    second = int(beyond.argmax())
    ratio = length / lengths[second]
    return near[[0, 1 + second]], np.array([1 + ratio, -ratio])


def _fit(near: Ints, offset: Floats, number: int) -> tuple[Ints, Floats] | None:
    """Weighted least-squares fit of the nearest nodes, exact for affine fields."""
    length = np.linalg.norm(offset, axis=1)
    last = length[min(number, len(length)) - 1]
    some = length <= (1 + _ROUND_OFF) * last
    near, offset, length = near[some], offset[some], length[some]
    B = np.column_stack([np.ones(len(offset)), offset / last])
    w = (length[0] / length) ** 2
    weight = w * (B @ np.linalg.pinv(B.T * w @ B, rcond=_ERROR, hermitian=True)[:, 0])
    if np.abs(weight @ B - [1, 0, 0, 0]).max() > _ERROR:
        return None
    return near, weight
