"""Bodies from mesh files for a gmsh model. Local."""

import os
from collections.abc import Callable
from typing import Any

import numpy as np

from dolfinx_nts.common.arguments import real_array
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.meshing.bodies import find_dimension, with_default_groups
from dolfinx_nts.meshing.discrete_entities import add_discrete_entity
from dolfinx_nts.meshing.elements import Block
from dolfinx_nts.meshing.msh_file import read_msh

__all__ = ["add_mesh"]


def add_mesh(
    model: Any,
    name: str,
    path: str | os.PathLike[str],
    *,
    move: Callable[[Floats], Floats] | None = None,
) -> None:
    """Add the cells of a ``.msh`` file as one body to a gmsh model. Local.

    Several files, or one file several times, make a scene. The physical volume, in the plane
    surface, is called ``name``, and its surfaces ``name_`` with the names that they have in the
    file. Nodes of no cell are left out.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        path: File of format 4.1 or 2.2, see `read_mesh`.
        move: Function of the positions in the file, shape ``(n, 3)`` [m], that returns positions in
            the model, to scale, rotate and shift the body; None to keep them.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is not a mesh, or ``move`` returns other numbers.

    Example:
        >>> ball = nts.examples.ball_plate()  # with its plate
        >>> def build(model):
        ...     parts.add_mesh(model, "low", ball)
        ...     parts.add_mesh(model, "high", ball, move=lambda x: 2 * x + (0, 0, 6))
        >>> data = nts.read_mesh(build, comm)
        >>> sorted(name for name in data.tag if name.startswith("high"))
        ['high', 'high_ball_inner', 'high_ball_outer', ..., 'high_plate_top']
    """
    mesh = with_default_groups(read_msh(path))
    dim = find_dimension(mesh)
    cells = [block for block in mesh.blocks if block.dim == dim]
    used = np.unique(np.concatenate([block.nodes.ravel() for block in cells]))
    x = mesh.positions(used)
    if move is not None:
        moved = real_array("move", move(x.copy()))
        if moved.shape != x.shape:
            raise ValueError(
                f"expected positions of shape {x.shape} from move, given {moved.shape}"
            )
        x = moved
    first = int(model.mesh.getMaxNodeTag()) + 1
    body = add_discrete_entity(model, dim)
    model.mesh.addNodes(dim, body, first + np.arange(len(used)), x.ravel())

    def add(entity: int, block: Block) -> None:
        nodes = first + np.searchsorted(used, block.nodes)
        model.mesh.addElementsByType(entity, block.kind, [], nodes.ravel())

    for block in cells:
        add(body, block)
    model.addPhysicalGroup(dim, [body], name=name)
    for tag, blocks in mesh.physical(dim - 1).items():
        side = add_discrete_entity(model, dim - 1)
        for block in blocks:
            add(side, block)
        model.addPhysicalGroup(dim - 1, [side], name=f"{name}_{mesh.name(dim - 1, tag)}")
