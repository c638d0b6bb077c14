"""The start of a run: bodies that overlap, and bodies that were forgotten."""

import logging
from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.node_numbering import listed
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.connected_bodies import connected
from dolfinx_nts.model.obstacles import Obstacle
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["check_start", "warn_of_bodies_without_pair"]

_logger = logging.getLogger("dolfinx_nts")

# Depths that are reported, relative to the size of a segment [-]: meshes of curved surfaces
# overlap by less, and a body and a rigid obstacle not at all but for round-off.
_OVERLAP, _OVERLAP_RIGID = 0.02, 1e-6


def check_start(state: PairState, x: Floats, x_before: Floats | None = None) -> None:
    """Raise on all ranks if nodes lie inside a rigid obstacle. Collective.

    Inside another deformable body they may start, which is only logged: elastic impact holds
    their depth, plastic impact and springs push them out.

    Args:
        state: State of the contact pair.
        x: Positions of the local nodes of the space, shape ``(l, 3)`` [m].
        x_before: Those from which the user has displaced bodies; nodes that were as deep there
            may stay. None at the first step.

    Raises:
        ValueError: Nodes are deeper than a millionth of the size of the surface's facets.
    """
    pair, depth = state.pair, -state.gap(x)
    rigid = isinstance(pair.segments, Obstacle)
    comm = pair.nodes.V.mesh.comm
    allowed = (_OVERLAP_RIGID if rigid else _OVERLAP) * pair.segment_size
    new = depth > allowed
    if x_before is not None:
        new &= ~(depth <= -state.gap(x_before) + allowed)
    nodes = np.sort(np.concatenate(comm.allgather(pair.nodes.node_ids[new])))
    if not len(nodes):
        return
    deepest = reductions.largest(comm, float(depth[new].max(initial=0.0)))
    count, where = f"{len(nodes)} nodes of {pair.nodes.name}", listed(nodes)
    inside = f"up to {deepest:.3g} inside {pair.segments.name}: {where}"
    if rigid:
        raise ValueError(f"expected bodies outside of obstacles, given {count} {inside}")
    if comm.rank == 0:
        _logger.warning(
            "%s start %s; move the bodies apart, unless %.0f %% of a facet do not matter: elastic "
            "impact keeps the nodes at their depth, plastic impact and springs push them out",
            count,
            inside,
            100 * deepest / pair.segment_size,
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
    comm, group_of = V.mesh.comm, np.full(len(V.tabulate_dof_coordinates()), -1)
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
