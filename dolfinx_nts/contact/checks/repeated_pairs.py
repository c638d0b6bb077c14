"""Check for repeated pairs, whose constraints are linearly dependent."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from dolfinx_nts.contact.enforcement import LagrangeMultiplier
from dolfinx_nts.contact.method import EDGES
from dolfinx_nts.contact.pair import ContactPair
from dolfinx_nts.model.obstacles.obstacle import Obstacle
from dolfinx_nts.model.surfaces import Surface
from dolfinx_nts.parallel import reductions

__all__ = ["check_repeated"]


def check_repeated(pairs: Sequence[ContactPair]) -> None:
    """Check that no two pairs have multipliers for the same nodes and segments. Collective.

    Args:
        pairs: All pairs of a stepper.

    Raises:
        ValueError: Two pairs are the same.
    """
    exact = [i for i, pair in enumerate(pairs) if isinstance(pair.enforcement, LagrangeMultiplier)]
    for i, j in combinations(exact, 2):
        first, second = pairs[i], pairs[j]
        if EDGES in (first.method, second.method) and first.method != second.method:
            continue  # edges are constrained in addition to nodes
        if _same(first.nodes, second.nodes) and _same(first.segments, second.segments):
            raise ValueError(
                "expected each pair once, as two multipliers for one constraint are not unique, "
                f"given the nodes of {first.between} in pairs[{i}] and pairs[{j}]"
            )


def _same(first: Surface | Obstacle, second: Surface | Obstacle) -> bool:
    """Whether two surfaces or obstacles are the same. Collective."""
    if isinstance(first, Obstacle) or isinstance(second, Obstacle):
        return first is second
    same = first is second or np.array_equal(first.nodes, second.nodes)
    return reductions.everywhere(first.V.mesh.comm, same)
