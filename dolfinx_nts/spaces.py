"""Spaces that the package works in, and tags on their meshes: checks."""

import numpy as np
from dolfinx import fem
from dolfinx.mesh import MeshTags

from dolfinx_nts import compat

__all__ = ["check_space", "check_tag"]

_CELLS = ("tetrahedron", "hexahedron")


def check_space(V: fem.FunctionSpace) -> None:
    """Raise unless V is a space that this package works in. Local.

    Args:
        V: Space of the displacement.

    Raises:
        ValueError: Mesh or element is another.
    """
    mesh = V.mesh
    cell = mesh.topology.cell_name()
    element = V.ufl_element()
    if cell not in _CELLS:
        raise ValueError(f"expected a mesh of tetrahedra or hexahedra, given {cell} cells")
    degree = compat.geometry_degree(mesh)
    if mesh.geometry.dim != 3 or degree != 1:
        raise ValueError(
            "expected a mesh of degree 1 in three dimensions, given degree "
            f"{degree} in {mesh.geometry.dim}; displacements on it may be of "
            "degree 2"
        )
    if (
        element.family_name not in ("P", "Q")
        or element.degree not in (1, 2)
        or V.dofmap.index_map_bs != 3
        or element.discontinuous
    ):
        raise ValueError(
            "expected the space functionspace(mesh, ('Lagrange', 1, (3,))), or of degree 2, given "
            f"{element} with block size {V.dofmap.index_map_bs}"
        )


def check_tag(V: fem.FunctionSpace, tags: MeshTags, tag: int, dim: int, name: str) -> None:
    """Raise on all ranks unless ``tags`` has entities of value ``tag``.

    Collective.

    Args:
        V: Space of the displacement.
        tags: Tags of the mesh.
        tag: Value that is looked for.
        dim: Dimension that the tags should have.
        name: What the message calls the tags.

    Raises:
        TypeError: ``tags`` is no MeshTags, or ``tag`` no integer.
        ValueError: The dimension is wrong, or no rank has the tag.
    """
    if not isinstance(tags, MeshTags):
        raise TypeError(f"expected MeshTags as {name}, given {type(tags).__name__}")
    if isinstance(tag, bool) or not isinstance(tag, int | np.integer):
        raise TypeError(f"expected an integer tag, given {tag!r}")
    if tags.dim != dim:
        raise ValueError(f"expected {name} of dimension {dim}, given dimension {tags.dim}")
    comm = V.mesh.comm
    values = sorted(set().union(*comm.allgather(set(tags.values.tolist()))))
    if tag not in values:
        raise ValueError(f"expected a tag out of {values} in {name}, given {tag}")
