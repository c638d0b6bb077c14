"""Contact forces between each two bodies, for any division into contact pairs."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats, Ints
from dolfinx_nts.contact.method import EDGES, MORTAR
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined

__all__ = ["BodyForces"]


class BodyForces:
    """Finds the bodies on both sides of the contact of a stepper. Collective.

    Each node belongs to one body, and the reaction to its force acts on the body of its segment.
    Nodes of several bodies belong to the first of them. A vertex of a mortar facet may transmit
    force without a segment of its own. The reaction then acts on the body of the segment of the
    nearest loaded node.

    Args:
        stepper: The stepper.

    Attributes:
        pairs: Numbers of each two bodies with a common pair of surfaces, the lower number first, in
            ascending order.
    """

    def __init__(self, stepper: Stepper) -> None:
        contacts: list[PairState] = [c for c in stepper.contacts if isinstance(c.segments, Surface)]
        contacts += [vertices for contact in contacts for vertices in contact.vertices]
        self._contacts, self._stepper = contacts, stepper
        self.pairs: list[tuple[int, int]] = []
        if not contacts:
            return
        bodies = stepper.bodies
        size = stepper.u.function_space.dofmap.index_map
        of_node = np.full(size.size_local + size.num_ghosts, -1, dtype=np.int64)
        for number, body in reversed(list(enumerate(bodies))):
            of_node[body.nodes] = number
        self._nodes = [of_node[contact.nodes.nodes] for contact in contacts]
        # Rows: number of the contact, key of a segment or -1 for nodes, and body.
        rows = []
        for i, (contact, of_nodes) in enumerate(zip(contacts, self._nodes, strict=True)):
            present = np.unique(of_nodes)
            nodes = np.column_stack([np.full(len(present), -1), present])
            parts = np.concatenate([nodes, _of_segments(contact, [b.nodes for b in bodies])])
            rows.append(np.column_stack([np.full(len(parts), i), parts]))
        comm: MPI.Comm = stepper.u.function_space.mesh.comm
        together = joined(comm, np.concatenate(rows))
        together = together[np.lexsort(together.T[::-1])]
        ends = np.searchsorted(together[:, 0], np.arange(1, len(contacts)))
        # Keys of all segments of each contact, ascending, and bodies of the segments.
        self._segments: list[tuple[Array, Array]] = []
        found = np.zeros((len(bodies), len(bodies)), dtype=bool)
        for part in np.split(together[:, 1:], ends):
            key, owner = part.T
            first = np.searchsorted(key, 0)
            self._segments.append((key[first:], owner[first:]))
            found[np.ix_(np.unique(owner[:first]), np.unique(owner[first:]))] = True
        self.pairs = [(int(a), int(b)) for a, b in np.argwhere(np.triu(found | found.T, k=1))]

    def of_own_nodes(self) -> Floats:
        """Forces on the first body of each of `pairs`, by the nodes of this rank. Collective.

        Returns:
            Forces, shape ``(p, 3)`` [N], to be summed over all ranks. NaN where edge-to-edge
            contact of several bodies on one side does not show which of them touch.
        """
        number = {pair: i for i, pair in enumerate(self.pairs)}
        forces: Floats = np.zeros((len(self.pairs), 3))
        if not self.pairs:
            return forces
        for contact, nodes, (keys, bodies) in zip(
            self._contacts, self._nodes, self._segments, strict=True
        ):
            history = contact.history
            if np.all(bodies == bodies[0]):
                other: Array = np.full(len(nodes), bodies[0])
            else:
                place = np.clip(np.searchsorted(keys, history.key), 0, len(keys) - 1)
                other = np.where(keys[place] == history.key, bodies[place], -1)
                if contact.pair.method == EDGES:
                    other[:] = -1
            acts = np.any(history.force != 0, axis=1)
            if contact.pair.method == MORTAR:
                self._assign(contact, acts, other)
            for a, b in np.unique(np.column_stack([nodes, other])[acts], axis=0).tolist():
                force = history.force[acts & (nodes == a) & (other == b)].sum(axis=0)
                if b < 0:  # any body of the other side
                    force = np.full(3, np.nan)
                for c in [b] if b >= 0 else np.unique(bodies).tolist():
                    if a != c and (min(a, c), max(a, c)) in number:
                        forces[number[min(a, c), max(a, c)]] += force if a < c else -force
        return forces

    def _assign(self, contact: PairState, acts: Array, other: Array) -> None:
        """Set ``other`` where it is -1: the bodies opposite nodes ``acts`` without a segment."""
        unknown = acts & (other < 0)
        comm: MPI.Comm = contact.pair.nodes.V.mesh.comm
        if not reductions.anywhere(comm, bool(unknown.any())):
            return
        x, known = self._stepper.x[contact.nodes.nodes], acts & (other >= 0)
        rows = joined(comm, np.column_stack([x[known], other[known]]))
        for node in np.flatnonzero(unknown) if len(rows) else ():
            other[node] = rows[np.linalg.norm(rows[:, :3] - x[node], axis=1).argmin(), 3]


def _of_segments(contact: PairState, nodes: list[Ints]) -> Array:
    """Keys of the segments of a pair on this rank, and the body of each, shape ``(s, 2)``."""
    surface = contact.pair.segments
    assert isinstance(surface, Surface)
    body = np.full(len(surface.segments), -1, dtype=np.int64)
    for number, own in reversed(list(enumerate(nodes))):
        body[np.isin(surface.segments, own).all(axis=1)] = number
    return np.column_stack([surface.key, body])
