"""Options of gmsh that are set for a while."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["gmsh_options"]


@contextmanager
def gmsh_options(gmsh: Any, **values: float) -> Iterator[None]:
    """Context in which options of gmsh have other values. Local.

    Args:
        gmsh: The module, initialised.
        values: Numbers by name, ``Mesh_SaveAll`` for ``Mesh.SaveAll``.
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
