"""Discrete entities of a gmsh model, whose numbers no shape of a CAD kernel gets.

The kernels of gmsh count their own shapes only. A shape that is added after a discrete entity of
the same number would replace it, or end the process.
"""

from collections.abc import Sequence
from typing import Any

__all__ = ["add_discrete_entity"]

# Far above the numbers that kernels count up to from 1.
_FIRST = 1_000_001


def add_discrete_entity(model: Any, dim: int, boundary: Sequence[int] = ()) -> int:
    """Add a discrete entity with a number of its own to a gmsh model. Local.

    Args:
        model: Live gmsh model.
        dim: Dimension of the entity.
        boundary: Numbers of the entities of one dimension less around it.

    Returns:
        Its number.
    """
    highest = max((tag for _, tag in model.getEntities(dim)), default=0)
    return int(model.addDiscreteEntity(dim, max(highest + 1, _FIRST), boundary))
