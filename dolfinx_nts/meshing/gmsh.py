"""Meshes from gmsh: from files, from models in memory, and from functions that build a model.

Files are read without gmsh. Physical volumes and surfaces become tagged cells and facets of a
distributed DOLFINx mesh, in the plane physical surfaces and curves, and the names of the
physical groups give the tags. Functions that add simple bodies to a model are in `parts`.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple, NoReturn

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import Mesh, MeshTags

from dolfinx_nts import compat
from dolfinx_nts.common.arguments import did_you_mean, kind_of
from dolfinx_nts.common.named_tag import NamedTag
from dolfinx_nts.meshing.bodies import Bodies, bodies_of, find_dimension, with_default_groups
from dolfinx_nts.meshing.elements import ENTITIES, Block, Elements
from dolfinx_nts.meshing.mixed_cells import only_one_kind
from dolfinx_nts.meshing.msh_file import read_msh
from dolfinx_nts.meshing.partition import ranks_of_cells
from dolfinx_nts.meshing.parts import (
    add_bowl,
    add_box,
    add_hollow_ball,
    add_mesh,
    add_rectangle,
    add_ring,
    add_solid_ball,
    add_torus,
)
from dolfinx_nts.parallel import reductions
from dolfinx_nts.parallel.errors import agreed

__all__ = [
    "MeshData",
    "add_bowl",
    "add_box",
    "add_hollow_ball",
    "add_mesh",
    "add_rectangle",
    "add_ring",
    "add_solid_ball",
    "add_torus",
    "read_mesh",
]


class MeshData(NamedTuple):
    """A distributed mesh with named regions, as `read_mesh` returns it.

    Attributes:
        mesh: Mesh of hexahedra or of tetrahedra, in the plane of quadrilaterals or of triangles
            [m], with the connectivities between cells and facets.
        cells: Tags of the physical volumes, in the plane surfaces; every cell has one.
        facets: Tags of the physical surfaces, in the plane curves.
        tag: Tags by name, read-only; messages use the names. A group without a name is called
            by its tag, ``"volume 3"``, ``"surface 3"`` or ``"curve 3"``. An unknown name raises
            ``ValueError`` with the names that exist.

    Example:
        >>> mesh, cells, facets, tag = nts.read_mesh(nts.examples.ball_plate(), comm)
        >>> V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        >>> ball = nts.Body(V, cells, tag["ball"], rubber)
    """

    mesh: Mesh
    cells: MeshTags
    facets: MeshTags
    tag: Mapping[str, int]


class _Tags(dict[str, int]):
    """Tags by name, with a message for names that do not exist."""

    def __missing__(self, name: str) -> NoReturn:
        raise ValueError(
            f"expected one of the physical groups {sorted(self)}, given {name!r}"
            f"{did_you_mean(name, self)}"
        )


def read_mesh(source: Any, comm: MPI.Comm, *, rank: int = 0) -> MeshData:
    """Read a mesh with named physical groups and distribute it.

    It is partitioned by recursive bisection with planes, the same in each run. Collective; every
    error is raised on all ranks. Mirrored cells are accepted, as DOLFINx integrates with ``|det
    J|``. Cells of second order may be curved, as on round surfaces after
    ``gmsh.model.mesh.setOrder(2)``; they require displacements of degree 2. DOLFINx only has spaces
    on cells of one kind, and none on prisms. Meshes of prisms or of several kinds are therefore cut
    into hexahedra: four from a tetrahedron, six from a prism and eight from a hexahedron. A warning
    is logged. A model without volumes is a mesh of the plane z = 0, whose cells are on physical
    surfaces; triangles next to quadrilaterals are cut into three and four quadrilaterals. If no
    cells are in physical groups, each volume, in the plane each surface, is a body, such as
    ``"volume 1"``. Warnings name bodies with several nodes at the same position, where cells are
    not connected, and triangles or tetrahedra that overlap.

    Args:
        source: Path of a ``.msh`` file, format 4.1 or 2.2, text or binary, which is read
            without gmsh; a live gmsh model such as ``gmsh.model``; or a function that is called
            with an empty model and adds bodies and physical groups. It is used on ``rank``
            only. Models and options of gmsh stay as they are.
        comm: Communicator of the mesh.
        rank: Rank that reads the file or holds the live model.

    Returns:
        Mesh, cell tags, facet tags and tags by name.

    Raises:
        OSError: The file cannot be read.
        ImportError: ``source`` is a model or function, and gmsh is not installed on ``rank``.
        TypeError: ``source`` is not a path, gmsh model or function.
        ValueError: The file is not a mesh, of another format or damaged; cells are pyramids, of
            third or incomplete second order, given twice, in several physical volumes, or in none
            while others are in one; ``det J`` vanishes or changes sign within a cell; a name stands
            for two tags; a physical surface has facets that belong to no cell, or shares some with
            another; a mesh of surfaces leaves the plane z = 0; ``rank`` does not exist.

    Example:
        >>> def build(model):
        ...     size = {"corner": (0, 0, 0), "size": (2, 2, 0.2), "cells": (8, 8, 1)}  # m
        ...     parts.add_box(model, "plate", **size)
        >>> mesh, cells, facets, tag = nts.read_mesh(build, comm)
        >>> sorted(tag)
        ['plate', 'plate_back', 'plate_bottom', ..., 'plate_top']
    """
    if not isinstance(comm, MPI.Comm):
        raise TypeError(f"expected a communicator such as MPI.COMM_WORLD, given {kind_of(comm)}")
    if not 0 <= rank < comm.size:
        raise ValueError(f"expected a rank below {comm.size}, given {rank}")
    own: Bodies | None = None
    with agreed(comm, "read a mesh"):
        if comm.rank == rank:
            try:
                elements = with_default_groups(_elements(source))
            except Exception as error:
                if type(error) is not Exception:  # type of all errors of gmsh
                    raise
                what = "a gmsh mesh"
                if callable(source):
                    what = "a function that makes a mesh by calls that gmsh accepts"
                raise ValueError(f"expected {what}, given {source}: {error}") from error
            dim = find_dimension(elements)
            own = bodies_of(only_one_kind(elements, dim), dim)
    description = comm.bcast(own and own.description(), root=rank)
    bodies = own or description
    mesh, cells, facets = compat.tagged_mesh(
        comm,
        bodies.cell,
        bodies.degree,
        bodies.x,
        (bodies.cells, bodies.cell_tags),
        (bodies.facets, bodies.facet_tags),
        partial(ranks_of_cells, bodies.x),
    )
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    mesh.topology.create_connectivity(dim, dim - 1)
    owned = facets.values[facets.indices < mesh.topology.index_map(dim - 1).size_local]
    names = {tag: name for name, tag in bodies.tags.items()}
    for tag, expected in bodies.num_facets.items():
        given = reductions.total(comm, np.count_nonzero(owned == tag))
        if given != expected:
            number = f"{ENTITIES[dim - 1]} {tag}"
            name = names.get(tag, number)
            raise ValueError(
                f"physical {number if name == number else repr(name)}: expected {expected} facets "
                f"of cells, given {given}: the others are on no cell of a physical "
                f"{ENTITIES[dim]}; make that one physical, or leave them out of the group"
            )
    named = {name: NamedTag(tag, name) for name, tag in bodies.tags.items()}
    return MeshData(mesh, cells, facets, MappingProxyType(_Tags(named)))


def _elements(source: Any) -> Elements:
    """Nodes, elements and groups of a file or of a gmsh model."""
    if hasattr(source, "getPhysicalGroups"):
        if not _import_gmsh().isInitialized():
            raise ValueError("expected a gmsh model, given gmsh before gmsh.initialize()")
        return _elements_of(source)
    if callable(source):
        with _empty_model(f"dolfinx_nts {source}") as model:
            source(model)
            model.mesh.renumberNodes()
            return _elements_of(model)
    if not isinstance(source, str | os.PathLike):
        raise TypeError(f"expected a path, a gmsh model or a function, given {source!r}")
    return read_msh(source)


def _import_gmsh() -> Any:
    """Import gmsh, which is only needed for models and functions."""
    try:
        import gmsh
    except (ImportError, OSError) as error:  # OSError: a library of gmsh is missing
        raise ImportError(
            f"expected the Python module gmsh for a model or a function, given {error}: install "
            "python-gmsh (conda), python3-gmsh (apt) or gmsh (pip), or read a .msh file, which "
            "needs no gmsh"
        ) from error
    return gmsh


@contextmanager
def _empty_model(name: str) -> Iterator[Any]:
    """Context with a new gmsh model; the state of gmsh is restored afterwards."""
    gmsh = _import_gmsh()
    initialised = gmsh.isInitialized()
    if not initialised:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        terminal = gmsh.option.getNumber("General.Terminal")
        gmsh.option.setNumber("General.Terminal", 0)
        current = gmsh.model.getCurrent()
        gmsh.model.add(name)
        try:
            yield gmsh.model
        finally:
            gmsh.model.remove()
            gmsh.model.setCurrent(current)
            gmsh.option.setNumber("General.Terminal", terminal)
    finally:
        if not initialised:
            gmsh.finalize()


def _elements_of(model: Any) -> Elements:
    """Nodes, sorted by number, elements and groups of a gmsh model."""
    numbers, x, _ = model.mesh.getNodes()
    order = np.argsort(numbers)
    groups, blocks = {}, []
    for dim, entity in model.getEntities():
        tags = model.getPhysicalGroupsForEntity(dim, entity)
        groups[dim, entity] = tuple(np.abs(tags).tolist())
        for kind, own, nodes in zip(*model.mesh.getElements(dim, entity), strict=True):
            rows = nodes.reshape(len(own), -1).astype(np.int64)
            blocks.append(Block(dim, entity, int(kind), own.astype(np.int64), rows))
    names = {group: model.getPhysicalName(*group) for group in model.getPhysicalGroups()}
    return Elements(
        numbers[order].astype(np.int64), x.reshape(-1, 3)[order], groups, names, tuple(blocks)
    )
