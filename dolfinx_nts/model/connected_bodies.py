"""Bodies that share nodes, which count as one in contact."""

import logging
from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arrays import Flags, Ints
from dolfinx_nts.fem.elements import Element
from dolfinx_nts.fem.node_numbering import reference_positions
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.parallel import reductions

__all__ = ["connected", "log_shared_nodes"]

_logger = logging.getLogger("dolfinx_nts")

# Numbers of vertices of a cell and of its facets.
_NUM_VERTICES = {
    "triangle": (3, 2),
    "quadrilateral": (4, 2),
    "tetrahedron": (4, 3),
    "hexahedron": (8, 4),
}


def connected(bodies: Sequence[Body]) -> list[list[Body]]:
    """Sort bodies into groups that are connected by shared nodes. Collective.

    Args:
        bodies: Bodies of one space.

    Returns:
        The groups; each body is in one of them.
    """
    index_map = bodies[0].V.dofmap.index_map
    last = np.full(index_map.size_local, -1)  # last body of each owned node
    touching: Flags = np.zeros((len(bodies), len(bodies)), dtype=bool)
    for i, body in enumerate(bodies):
        nodes = body.nodes[body.nodes < index_map.size_local]
        touching[i, np.setdiff1d(last[nodes], -1)] = True
        last[nodes] = i
    touching = reductions.total(bodies[0].V.mesh.comm, touching.astype(np.int32)) > 0
    groups: dict[int, list[Body]] = {}
    for body, group in zip(bodies, _groups(touching), strict=True):
        groups.setdefault(int(group), []).append(body)
    return [groups[group] for group in sorted(groups)]


def log_shared_nodes(bodies: Sequence[Body]) -> None:
    """Log bodies that share nodes, and warn if they share no facets. Collective.

    Bodies that share facets are parts of one body, such as layers of two materials. Nodes shared
    only along a line or at a point are mostly a mistake in the mesh.

    Args:
        bodies: Bodies of one space.
    """
    V = bodies[0].V
    comm, num_owned = V.mesh.comm, V.dofmap.index_map.size_local
    count = np.zeros(len(reference_positions(V)), dtype=np.int32)
    for body in bodies:
        count[body.nodes] += 1
    shared = np.flatnonzero(count > 1)
    belongs: Ints = np.zeros((len(shared) + 1, len(bodies)), dtype=np.int32)  # the last row stays 0
    place = np.full(len(count), len(shared))
    place[shared] = np.arange(len(shared))
    for i, body in enumerate(bodies):
        belongs[place[body.nodes], i] = 1
    belongs[-1] = 0
    owned = belongs[:-1][shared < num_owned]
    numbers = reductions.total(comm, owned.T @ owned)
    np.fill_diagonal(numbers, 0)
    vertices, of_facet = _NUM_VERTICES[Element.of(V).cell]
    joined: Flags = np.zeros(numbers.shape, dtype=bool)
    for i, body in enumerate(bodies):
        cells = place[V.dofmap.list[body.cells, :vertices]]
        joined[i] = (belongs[cells].sum(axis=1) >= of_facet).any(axis=0)
    part = _groups(reductions.anywhere(comm, joined) & (numbers > 0))
    if comm.rank != 0:
        return
    group = _groups(numbers > 0)
    for k in np.unique(group):
        members = np.flatnonzero(group == k)
        if len(members) > 1 and len(np.unique(part[members])) == 1:
            names = ", ".join(bodies[i].name for i in members)
            _logger.info("%s share nodes and count as one body", names)
    for i, j in np.argwhere(np.triu(numbers)):
        if part[i] != part[j]:
            _logger.warning(
                "%s and %s share %d nodes, but no facet: they are joined there, count as one "
                "body, and do not touch each other elsewhere; give each body its own nodes in the "
                "mesh (in gmsh without fragment), or let them touch by self_contact=[%s]",
                *(bodies[i].name, bodies[j].name, numbers[i, j], bodies[i].name),
            )


def _groups(linked: Flags) -> Ints:
    """Connected components of items with links ``(n, n)``, shape ``(n,)``. Local."""
    group = np.arange(len(linked))
    for i, j in np.argwhere(linked):
        group[group == group[i]] = group[j]
    return group
