"""Contact forces between any two bodies, for any division into contact pairs."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats, Ints
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.bodies import body_of_nodes
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined

__all__ = ["BodyForces"]


class BodyForces:
    """Finds the bodies on both sides of the contact of a stepper. Collective.

    Each node belongs to one body, and the reaction to its force acts on the body of its segment, or
    in mortar contact on all bodies of its quadrature points. Nodes of several bodies belong to the
    first of them.

    Args:
        stepper: The stepper.

    Attributes:
        pairs: Numbers of any two bodies with a common pair of surfaces, the lower number first, in
            ascending order.
    """

    def __init__(self, stepper: Stepper) -> None:
        contacts: list[PairState] = [c for c in stepper.contacts if isinstance(c.segments, Surface)]
        contacts += [vertices for contact in contacts for vertices in contact.vertices]
        self._contacts = contacts
        self._comm: MPI.Comm = stepper.u.function_space.mesh.comm
        self.pairs: list[tuple[int, int]] = []
        if not contacts:
            return
        bodies, of_node = stepper.bodies, body_of_nodes(stepper.bodies)
        self._nodes = [of_node[contact.nodes.nodes] for contact in contacts]
        # Rows: number of the contact, key of a segment or -1 for nodes, and body.
        rows = []
        for i, (contact, of_nodes) in enumerate(zip(contacts, self._nodes, strict=True)):
            present = np.unique(of_nodes)
            nodes = np.column_stack([np.full(len(present), -1), present])
            parts = np.concatenate([nodes, _of_segments(contact, [b.nodes for b in bodies])])
            rows.append(np.column_stack([np.full(len(parts), i), parts]))
        together = joined(self._comm, np.concatenate(rows))
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
        """Forces on the first body of each of `pairs`, from the nodes of this rank. Collective.

        Returns:
            Forces, shape ``(p, 3)`` [N], to be summed over all ranks. NaN where edge-to-edge
            contact of several bodies in explicit steps does not show which of them touch.
        """
        number = {pair: i for i, pair in enumerate(self.pairs)}
        forces: Floats = np.zeros((len(self.pairs), 3))
        if not self.pairs:
            return forces
        for contact, nodes, (keys, bodies) in zip(
            self._contacts, self._nodes, self._segments, strict=True
        ):
            history, own, other = (
                contact.history,
                nodes,
                self._opposite_bodies(contact, keys, bodies),
            )
            force = history.force
            if reductions.anywhere(self._comm, bool((history.partner >= 0).any())):
                node, place = (history.partner >= 0).nonzero()
                own, other = nodes[node], history.partner[node, place]
                force = -history.reaction[node, place]
            acts = np.any(force != 0, axis=1)
            own, other, force = own[acts], other[acts], force[acts]
            for a, b in sorted(set(zip(map(int, own), map(int, other), strict=True))):
                total = force[(own == a) & (other == b)].sum(axis=0)
                if b < 0:  # any body of the other side
                    total = np.full(3, np.nan)
                for c in map(int, [b] if b >= 0 else np.unique(bodies)):
                    if a != c and (min(a, c), max(a, c)) in number:
                        forces[number[min(a, c), max(a, c)]] += total if a < c else -total
        return forces

    @staticmethod
    def _opposite_bodies(contact: PairState, keys: Array, bodies: Array) -> Array:
        """Body of each node's segment, or -1, by keys and bodies of segments, ``(n,)``. Local."""
        key = contact.history.key
        if np.all(bodies == bodies[0]):
            return np.full(len(key), bodies[0])
        if contact.pair.method == EDGES:
            return np.full(len(key), -1)
        place = np.clip(np.searchsorted(keys, key), 0, len(keys) - 1)
        return np.where(keys[place] == key, bodies[place], -1)


def _of_segments(contact: PairState, nodes: list[Ints]) -> Array:
    """Keys of the segments of a pair on this rank, and the body of each, shape ``(s, 2)``."""
    surface = contact.pair.segments
    assert isinstance(surface, Surface)
    body = np.full(len(surface.segments), -1, dtype=np.int64)
    for number, own in reversed(list(enumerate(nodes))):
        body[np.isin(surface.segments, own).all(axis=1)] = number
    return np.column_stack([surface.key, body])
