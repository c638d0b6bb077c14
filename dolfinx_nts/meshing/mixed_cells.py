"""Cutting of mixed cells into cells of one kind, as DOLFINx has no spaces on several.

Cells are cut at the midpoints of their edges and the centres of their faces: a tetrahedron
becomes four hexahedra, a prism six, a hexahedron eight; in the plane, a triangle becomes three
quadrilaterals, a quadrilateral four. Neighbours of any kind still share their nodes, and
volumes stay the same.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

__all__ = ["gmsh_options", "only_one_kind"]

_logger = logging.getLogger("dolfinx_nts")

_TRIANGLE, _QUADRILATERAL, _TETRAHEDRON, _HEXAHEDRON, _PRISM = 2, 3, 4, 5, 6  # gmsh element types


class _Cut(NamedTuple):
    """How cells of one dimension are cut.

    Attributes:
        kinds: Element types that can be cut.
        into: Element type of the pieces.
        name: What the pieces are called.
        algorithm: gmsh's number of the subdivision.
    """

    kinds: frozenset[int]
    into: int
    name: str
    algorithm: int


_CUTS = {
    2: _Cut(frozenset({_TRIANGLE, _QUADRILATERAL}), _QUADRILATERAL, "quadrilaterals", 1),
    3: _Cut(frozenset({_TETRAHEDRON, _HEXAHEDRON, _PRISM}), _HEXAHEDRON, "hexahedra", 2),
}


@contextmanager
def only_one_kind(model: Any, dim: int) -> Iterator[Any]:
    """Context with a gmsh model, or with a copy that is cut into cells of one kind. Local.

    A model is cut if its cells are prisms or of several kinds, and a warning is logged; the
    model itself stays as it is. Cells that cannot be cut, pyramids and those of higher order,
    are left for the caller to refuse.

    Args:
        model: The current gmsh model.
        dim: Dimension of its cells, 2 or 3.

    Yields:
        The model or the copy, which is removed at the end.
    """
    kinds, cut = set(model.mesh.getElementTypes(dim)), _CUTS[dim]
    mixed = len(kinds) > 1 or _PRISM in kinds
    if not mixed or not kinds <= cut.kinds:
        yield model
        return
    import gmsh

    given = ", ".join(
        f"{len(model.mesh.getElementsByType(kind)[0])} {model.mesh.getElementProperties(kind)[0]}"
        for kind in sorted(kinds)
    )
    current = model.getCurrent()
    with TemporaryDirectory() as folder, gmsh_options(gmsh, General_Terminal=0):
        file = Path(folder) / "mixed.msh"
        with gmsh_options(gmsh, Mesh_SaveAll=1, Mesh_MshFileVersion=4.1, Mesh_Binary=1):
            gmsh.write(str(file))
        model.add(f"dolfinx_nts {cut.name}")
        try:
            gmsh.merge(str(file))
            with gmsh_options(
                gmsh, Mesh_SubdivisionAlgorithm=cut.algorithm, Mesh_SecondOrderLinear=1
            ):
                model.mesh.refine()
            model.mesh.renumberNodes()
            count = len(model.mesh.getElementsByType(cut.into)[0])
            _logger.warning(
                "DOLFINx has spaces on cells of one kind, without prisms: %s are cut into %d "
                "%s, which is harmless but for their number",
                given,
                count,
                cut.name,
            )
            yield model
        finally:
            model.remove()
            model.setCurrent(current)


@contextmanager
def gmsh_options(gmsh: Any, **values: float) -> Iterator[None]:
    """Context in which options of gmsh have other values. Local.

    Args:
        gmsh: The module, initialised.
        **values: Numbers by name of the option, with an underscore for the dot:
            ``Mesh_SaveAll`` for ``Mesh.SaveAll``.
    """
    names = {key: key.replace("_", ".") for key in values}
    before = {key: gmsh.option.getNumber(name) for key, name in names.items()}
    try:
        for key, value in values.items():
            gmsh.option.setNumber(names[key], value)
        yield
    finally:
        for key, value in before.items():
            gmsh.option.setNumber(names[key], value)
