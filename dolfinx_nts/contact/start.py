"""The start of a run: bodies inside rigid obstacles, and bodies that were forgotten."""

import logging
from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.node_numbering import listed, reference_positions
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.connected_bodies import connected
from dolfinx_nts.model.obstacles import Obstacle
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.communication import joined

__all__ = ["check_start", "warn_of_bodies_without_pair"]

_logger = logging.getLogger("dolfinx_nts")

# Depth, relative to the size of a facet [-], that is more than round-off.
_DEEP = 1e-6


def check_start(state: PairState, t: float, x: Floats, x_before: Floats | None = None) -> None:
    """Raise on all ranks if nodes of a pair lie inside its rigid obstacle. Collective.

    Inside another deformable body they may start, see `OverlapWatch`.

    Args:
        state: State of the contact pair.
        t: Time, at which moving obstacles are where they start [s].
        x: Positions of the local nodes of the space, shape ``(l, 3)`` [m].
        x_before: Those from which the user has displaced bodies; nodes that were as deep there
            may stay. None at the first step.

    Raises:
        ValueError: Nodes are deeper than a millionth of the size of the surface's facets.
    """
    pair = state.pair
    if not isinstance(pair.segments, Obstacle):
        return
    obstacle, comm, nodes = pair.segments, pair.nodes.V.mesh.comm, pair.nodes.nodes
    place = obstacle.motion.frame(t, t, obstacle.dim).at_end
    depth = obstacle.depth(place(x[nodes]))
    allowed = _DEEP * pair.segment_size
    new = depth > allowed
    if x_before is not None:
        new &= ~(depth <= obstacle.depth(place(x_before[nodes])) + allowed)
    ids = np.sort(joined(comm, pair.nodes.node_ids[new]))
    if len(ids):
        deepest = reductions.largest(comm, float(depth[new].max(initial=0.0)))
        raise ValueError(
            f"expected bodies outside of obstacles, given {len(ids)} nodes of {pair.nodes.name} "
            f"up to {deepest:.3g} inside {obstacle.name}: {listed(ids)}"
        )


def warn_of_bodies_without_pair(bodies: Sequence[Body], pairs: Sequence[ContactPair]) -> None:
    """Warn of bodies that have a contact pair with none of the others. Collective.

    Bodies that share nodes count as one.

    Args:
        bodies: All bodies of a stepper.
        pairs: Its contact pairs.
    """
    groups = connected(bodies)
    if len(groups) == 1:
        return
    V = bodies[0].V
    comm, group_of = V.mesh.comm, np.full(len(reference_positions(V)), -1)
    for number, group in enumerate(groups):
        group_of[np.concatenate([body.nodes for body in group])] = number
    sides = [(pair.nodes, pair.segments) for pair in pairs if isinstance(pair.segments, Surface)]
    found = np.zeros((len(sides), 2, len(groups)), dtype=bool)
    for flags, surfaces in zip(found, sides, strict=True):
        for flag, surface in zip(flags, surfaces, strict=True):
            flag[group_of[surface.segments]] = True
    found = reductions.anywhere(comm, found)
    met = np.einsum("psi,psj->ij", found, found[:, ::-1]) & ~np.eye(len(groups), dtype=bool)
    alone = [group for group, others in zip(groups, met, strict=True) if not others.any()]
    if alone and comm.rank == 0:
        names = ", ".join(body.name for group in alone for body in group)
        _logger.warning(
            "bodies without a contact pair with another body: %s; harmless if they never meet "
            "one, which they would pass through; otherwise add pairs, or take all_pairs(bodies)",
            names,
        )
