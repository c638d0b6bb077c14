"""Massless nodes of pairs with impact "resolved"."""

from collections.abc import Sequence

import numpy as np

from dolfinx_nts.common.arrays import Ints
from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["is_resolved", "massless_nodes"]


def is_resolved(pair: ContactPair) -> bool:
    """Whether the nodes of a pair are massless. Local."""
    law = pair.enforcement
    return isinstance(law, LagrangeMultiplier) and law.impact == "resolved"


def massless_nodes(bodies: Sequence[Body], pairs: Sequence[ContactPair]) -> Ints:
    """Owned massless nodes. Collective.

    Args:
        bodies: Bodies of a stepper.
        pairs: Its contact pairs.

    Returns:
        Nodes of all pairs with impact ``"resolved"``, sorted.

    Raises:
        ValueError: A pair, or its combination with other pairs, does not support impact
            "resolved".
    """
    resolved = [pair for pair in pairs if is_resolved(pair)]
    nodes: Ints = np.empty(0, dtype=np.int32)
    for pair in resolved:
        _check(pair)
        nodes = np.union1d(nodes, pair.nodes.nodes)
    if not resolved:
        return nodes
    for pair in pairs:
        sides = [pair.segments] if is_resolved(pair) else [pair.nodes, pair.segments]
        for surface in sides:
            shared = 0
            role = "segments" if surface is pair.segments else "nodes"
            if isinstance(surface, Surface):
                shared = len(np.intersect1d(surface.nodes, nodes))
            if shared := reductions.total(pair.nodes.V.mesh.comm, shared):
                raise ValueError(
                    f"expected nodes with impact 'resolved' in no other contact, given {shared} "
                    f"nodes of {surface.name} also {role} of contact between {pair.between}: use "
                    "other surfaces, or impact 'elastic' in all of these pairs"
                )
    return nodes


def _check(pair: ContactPair) -> None:
    """Check that a pair supports impact "resolved". Local."""
    wrong = ""
    if pair.touches_itself:
        wrong = "two surfaces, given one that touches itself"
    elif pair.friction is not None and pair.has_slip_spring:
        wrong = f"friction without springs, given {pair.friction!r}"
    if wrong:
        raise ValueError(f"expected, with impact 'resolved', {wrong}; or use impact 'elastic'")
