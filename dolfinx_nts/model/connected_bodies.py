"""Bodies that share nodes, which count as one in contact."""

from collections.abc import Sequence

import numpy as np
from dolfinx import la

from dolfinx_nts.common.arrays import Flags
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.parallel import reductions

__all__ = ["connected"]


def connected(bodies: Sequence[Body]) -> list[list[Body]]:
    """Sort bodies into groups that are connected by shared nodes. Collective.

    Args:
        bodies: Bodies of one space.

    Returns:
        The groups, which together have all the bodies.
    """
    index_map = bodies[0].V.dofmap.index_map
    last = np.full(index_map.size_local, -1)  # last body of each owned node
    touching: Flags = np.zeros((len(bodies), len(bodies)), dtype=bool)
    for i, body in enumerate(bodies):
        # A node may be owned by a rank that has no cell of the body.
        marker = la.vector(index_map)
        marker.array[body.nodes] = 1
        marker.scatter_reverse(la.InsertMode.add)
        nodes = np.flatnonzero(marker.array[: index_map.size_local])
        touching[i, np.setdiff1d(last[nodes], -1)] = True
        last[nodes] = i
    touching = reductions.total(bodies[0].V.mesh.comm, touching.astype(np.int32)) > 0
    group = np.arange(len(bodies))
    for i, j in np.argwhere(touching):
        group[group == group[i]] = group[j]
    return [[b for b, g in zip(bodies, group, strict=True) if g == k] for k in np.unique(group)]
