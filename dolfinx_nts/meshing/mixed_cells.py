"""Cutting of mixed cells into hexahedra, as DOLFINx has no spaces on several kinds.

Cells are cut at the midpoints of their edges and the centres of their faces: a tetrahedron
becomes four hexahedra, a prism six, a hexahedron eight. Neighbours of any kind still share
their nodes, and volumes stay the same.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

__all__ = ["gmsh_options", "only_one_kind"]

_logger = logging.getLogger("dolfinx_nts")

_TETRAHEDRON, _HEXAHEDRON, _PRISM = 4, 5, 6  # gmsh element types


@contextmanager
def only_one_kind(model: Any) -> Iterator[Any]:
    """Context with a gmsh model, or with a copy that is cut into hexahedra. Local.

    A model is cut if its cells are prisms or of several kinds, and a warning is logged; the
    model itself stays as it is. Cells that cannot be cut, pyramids and those of higher order,
    are left for the caller to refuse.

    Args:
        model: The current gmsh model.

    Yields:
        The model or the copy, which is removed at the end.
    """
    kinds = set(model.mesh.getElementTypes(3))
    mixed = len(kinds) > 1 or _PRISM in kinds
    if not mixed or not kinds <= {_TETRAHEDRON, _HEXAHEDRON, _PRISM}:
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
        model.add("dolfinx_nts hexahedra")
        try:
            gmsh.merge(str(file))
            with gmsh_options(gmsh, Mesh_SubdivisionAlgorithm=2, Mesh_SecondOrderLinear=1):
                model.mesh.refine()
            model.mesh.renumberNodes()
            count = len(model.mesh.getElementsByType(_HEXAHEDRON)[0])
            _logger.warning(
                "DOLFINx has spaces on cells of one kind, without prisms: %s are cut into %d "
                "hexahedra, which is harmless but for their number",
                given,
                count,
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
