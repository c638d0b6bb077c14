"""Discrete entities of a gmsh model, with numbers that CAD shapes do not use.

The CAD kernels of gmsh only take their own shapes into account when they number a new one. A later
shape with the number of a discrete entity would replace it, or crash the process.
"""

from collections.abc import Sequence
from typing import Any

__all__ = ["add_discrete_entity"]

# First number, far larger than those of CAD shapes, which are counted from 1.
_FIRST = 1_000_001


def add_discrete_entity(model: Any, dim: int, boundary: Sequence[int] = ()) -> int:
    """Add a discrete entity with a unique number to a gmsh model. Local.

    Args:
        model: Live gmsh model.
        dim: Dimension of the entity.
        boundary: Numbers of the entities of one dimension less around it.

    Returns:
        Its number.
    """
    highest = max((tag for _, tag in model.getEntities(dim)), default=0)
    return int(model.addDiscreteEntity(dim, max(highest + 1, _FIRST), boundary))
