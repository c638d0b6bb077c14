"""Contact forces between each two bodies, whichever pairs transmit them."""

from mpi4py import MPI

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats, Ints
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.integrators.stepper import Stepper
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined

__all__ = ["BodyForces"]


class BodyForces:
    """Finds the bodies on both sides of the contact of a stepper. Collective.

    A node belongs to one body, and its force acts on the body of the segment that it faces. Of
    bodies that share nodes, the first one has these nodes.

    Args:
        stepper: The stepper.

    Attributes:
        pairs: Numbers of each two bodies that pairs of surfaces let touch, the lower one first,
            in ascending order.
    """

    def __init__(self, stepper: Stepper) -> None:
        self._comm: MPI.Comm = stepper.u.function_space.mesh.comm
        contacts: list[PairState] = [c for c in stepper.contacts if isinstance(c.segments, Surface)]
        contacts += [c.exchange for c in contacts if c.exchange is not None]
        self._contacts = contacts
        bodies = stepper.bodies
        size = stepper.u.function_space.dofmap.index_map
        of_node = np.full(size.size_local + size.num_ghosts, -1, dtype=np.int64)
        for number, body in reversed(list(enumerate(bodies))):
            of_node[body.nodes] = number
        # Body of each node, and of each segment by its key, for each pair.
        self._nodes = [of_node[contact.nodes.nodes] for contact in self._contacts]
        self._segments = [self._of_segments(c, [b.nodes for b in bodies]) for c in self._contacts]
        found: Array = np.zeros((len(bodies), len(bodies)))
        for nodes, (_, segments) in zip(self._nodes, self._segments, strict=True):
            found[np.ix_(np.unique(nodes), np.unique(segments))] = 1
        found = np.triu(found + found.T, k=1)
        found = reductions.total(self._comm, found) if len(self._contacts) else found
        self.pairs = [(int(a), int(b)) for a, b in np.argwhere(found)]

    def _of_segments(self, contact: PairState, nodes: list[Ints]) -> tuple[Array, Array]:
        """Keys of all segments of a pair, ascending, and the body of each."""
        surface = contact.pair.segments
        assert isinstance(surface, Surface)
        body = np.full(len(surface.segments), -1, dtype=np.int64)
        for number, own in reversed(list(enumerate(nodes))):
            body[np.isin(surface.segments, own).all(axis=1)] = number
        keys, body = joined(self._comm, np.column_stack([surface.key, body])).T
        order = np.argsort(keys)
        return keys[order], body[order]

    def of_last_step(self) -> Floats:
        """Forces of the last step on the first body of each of `pairs`. Collective.

        Returns:
            Forces, shape ``(p, 3)`` [N]. NaN where edge-to-edge contact of several bodies on one
            side does not tell which of them touch.
        """
        number = {pair: i for i, pair in enumerate(self.pairs)}
        forces: Floats = np.zeros((len(self.pairs), 3))
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
            for a, b in np.unique(np.column_stack([nodes, other])[acts], axis=0).tolist():
                force = history.force[acts & (nodes == a) & (other == b)].sum(axis=0)
                if b < 0:  # one of the bodies on the other side
                    force = np.full(3, np.nan)
                for c in [b] if b >= 0 else np.unique(bodies).tolist():
                    if a != c and (min(a, c), max(a, c)) in number:
                        forces[number[min(a, c), max(a, c)]] += force if a < c else -force
        total: Floats = reductions.total(self._comm, forces) if len(self.pairs) else forces
        return total
