"""Meshes from gmsh: of files, of live models, and of functions that fill a model.

Physical volumes and surfaces of gmsh become tagged cells and facets of a distributed DOLFINx
mesh, in the plane physical surfaces and curves, and the names of the physical groups lead to
the tags. Simple bodies to fill a model with are in `parts`.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, NamedTuple, NoReturn

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import Mesh, MeshTags

from dolfinx_nts import compat
from dolfinx_nts.common.arguments import kind_of
from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.common.named_tag import NamedTag
from dolfinx_nts.meshing.mixed_cells import gmsh_options, only_one_kind
from dolfinx_nts.meshing.partition import ranks_of_cells
from dolfinx_nts.meshing.parts import (
    add_bowl,
    add_box,
    add_hollow_ball,
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
    "add_rectangle",
    "add_ring",
    "add_solid_ball",
    "add_torus",
    "read_mesh",
]

_KINDS = ("point", "curve", "surface", "volume")  # by dimension
# gmsh's numbers of the element types of a point, an edge, a facet and a cell that go together.
_FAMILIES = {
    3: ((15, 1, 2, 4), (15, 1, 3, 5), (15, 8, 9, 11), (15, 8, 10, 12)),
    2: ((15, 1, 2), (15, 1, 3), (15, 8, 9), (15, 8, 10)),
}  # by dimension of the cells, straight ones first
_CELLS = {3: "hexahedra, tetrahedra or prisms", 2: "triangles or quadrilaterals"}
_PYRAMIDS = {7, 14, 19}  # of first, second and incomplete second order
# Suffixes of files of other programs that hold meshes, which meshio reads.
_MESHES = {".inp", ".vtk", ".vtu", ".med", ".bdf", ".nas", ".fem", ".e", ".exo", ".mesh", ".cgns"}
# det J at a point, relative to the power of the longest tangent of the cell [-], below which the
# cell is flat there but for round-off; and z of nodes in the plane, relative to its extent [-].
_FLAT = 1e-12


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
        raise ValueError(f"expected a physical group out of {sorted(self)}, given {name!r}")


def read_mesh(source: Any, comm: MPI.Comm, *, rank: int = 0) -> MeshData:
    """Read a mesh with named physical groups and distribute it.

    Planes cut it into parts of as many cells, the same each time. Collective; every error is raised
    on all ranks. Mirrored cells are accepted, as DOLFINx integrates with ``|det J|``. Cells of
    second order may be curved, as those of round surfaces are after
    ``gmsh.model.mesh.setOrder(2)``; they go with displacements of degree 2. DOLFINx has spaces on
    cells of one kind only, and not on prisms: meshes of prisms, or of several kinds, are cut into
    hexahedra, four of a tetrahedron, six of a prism and eight of a hexahedron, and a warning is
    logged. A model without volumes is a mesh of the plane z = 0, whose cells are on physical
    surfaces; triangles next to quadrilaterals are cut into three and four quadrilaterals.

    Args:
        source: Path of a ``.msh`` file; a live gmsh model such as ``gmsh.model``; or a function
            that is called with an empty model and adds bodies and physical groups. It is used
            on ``rank`` only. The current model and the log level of gmsh stay as they are.
        comm: Communicator of the mesh.
        rank: Rank that reads the file or holds the live model.

    Returns:
        Mesh, cell tags, facet tags and tags by name.

    Raises:
        OSError: The file cannot be read.
        ImportError: gmsh is not installed on ``rank``.
        TypeError: ``source`` is no path, gmsh model or function.
        ValueError: The file is no mesh; cells are pyramids, of third or incomplete second order,
            or not in exactly one physical volume; ``det J`` vanishes or changes sign within a
            cell; a name stands for two tags; a physical surface has facets that belong to no
            cell, or shares some with another; a mesh of surfaces leaves the plane z = 0;
            ``rank`` does not exist.

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
    with ExitStack() as stack:
        model, dim = None, 3
        tags: dict[str, int] = {}
        num_facets: dict[int, int] = {}
        with agreed(comm, "read a mesh"):
            if comm.rank == rank:
                try:
                    given = stack.enter_context(_opened(source))
                    dim = _dimension(given)
                    model = stack.enter_context(only_one_kind(given, dim))
                    stack.enter_context(_cells_first(model, dim))
                    stack.enter_context(_only_cells_and_facets(model, dim))
                    tags, num_facets = _inspect(model, dim)
                except Exception as error:
                    if type(error) is not Exception:  # that of gmsh, which has no other
                        raise
                    raise ValueError(f"expected a gmsh mesh, given {source}: {error}") from error
        dim, tags, num_facets = comm.bcast((dim, tags, num_facets), root=rank)
        X = _positions(model)
        mesh, cells, facets = compat.model_to_mesh(
            model, comm, rank, dim, partial(ranks_of_cells, X)
        )

    mesh.topology.create_connectivity(dim - 1, dim)
    mesh.topology.create_connectivity(dim, dim - 1)
    owned = facets.values[facets.indices < mesh.topology.index_map(dim - 1).size_local]
    for tag, expected in num_facets.items():
        given = reductions.total(comm, np.count_nonzero(owned == tag))
        if given != expected:
            raise ValueError(
                f"physical {_KINDS[dim - 1]} {tag}: expected {expected} facets of cells, "
                f"given {given}"
            )
    named = {name: NamedTag(tag, name) for name, tag in tags.items()}
    return MeshData(mesh, cells, facets, MappingProxyType(_Tags(named)))


@contextmanager
def _opened(source: Any) -> Iterator[Any]:
    """Context with the gmsh model of a source, which is removed at the end if it is new."""
    try:
        import gmsh
    except (ImportError, OSError) as error:  # OSError: gmsh misses a library
        raise ImportError(
            f"expected the Python module gmsh, given {error}: install python-gmsh (conda), "
            "python3-gmsh (apt) or gmsh (pip), or use a mesh and tags of DOLFINx without read_mesh"
        ) from error
    if hasattr(source, "getPhysicalGroups"):
        if not gmsh.isInitialized():
            raise ValueError("expected a live gmsh model, given gmsh before gmsh.initialize()")
        yield source
        return
    if isinstance(source, str | os.PathLike):
        with Path(source).open("rb") as file:
            # gmsh would run a file that it does not recognise as a script.
            if not file.read(16).startswith((b"$MeshFormat", b"$Comments")):
                raise ValueError(f"expected a gmsh mesh (.msh), given {source}: {_remedy(source)}")
    elif not callable(source):
        raise TypeError(f"expected a path, a gmsh model or a function, given {source!r}")
    initialised = gmsh.isInitialized()
    if not initialised:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        with gmsh_options(gmsh, General_Terminal=0):
            current = gmsh.model.getCurrent()
            gmsh.model.add(f"dolfinx_nts {source}")
            try:
                if callable(source):
                    source(gmsh.model)
                else:
                    _merge(gmsh, Path(source))
                gmsh.model.mesh.renumberNodes()
                yield gmsh.model
            finally:
                gmsh.model.remove()
                gmsh.model.setCurrent(current)
    finally:
        if not initialised:
            gmsh.finalize()


def _remedy(source: str | os.PathLike[str]) -> str:
    """Say how a file that is no gmsh mesh becomes one, by its suffix."""
    suffix = Path(source).suffix.lower()
    if suffix in _MESHES:
        return (
            f"convert the {suffix[1:].upper()} file by meshio, with the number of the body of each "
            'cell as cell_data "gmsh:physical" and "gmsh:geometrical", and write it as "gmsh22" '
            "(the page on geometry has the script)"
        )
    return (
        "mesh a geometry first (gmsh -3 part.geo, or part.step); a mesh and tags that DOLFINx "
        "reads by itself (XDMFFile) can be used without read_mesh"
    )


def _merge(gmsh: Any, file: Path) -> None:
    """Read a file into the current model, and nothing that lies next to it.

    gmsh would also execute a script of the same name that ends in ``.opt``.
    """
    with TemporaryDirectory() as folder:
        alone = Path(folder) / "mesh.msh"
        alone.symlink_to(file.resolve())
        gmsh.merge(str(alone))


@contextmanager
def _cells_first(model: Any, dim: int) -> Iterator[None]:
    """Context in which nodes of cells have the numbers 1, 2, 3, ..., and others those after them.

    DOLFINx would end the process otherwise. Others are those of points and curves of no cell, as
    of a construction. At the end nodes have their own numbers again.
    """
    every = model.mesh.getNodes()[0]
    lists = (model.mesh.getElementsByType(kind)[1] for kind in model.mesh.getElementTypes(dim))
    of_cells = np.unique(np.concatenate([np.empty(0, dtype=every.dtype), *lists]))
    if len(every) == every.max(initial=0) and len(of_cells) == of_cells.max(initial=0):
        yield
        return
    own = np.concatenate([of_cells, np.setdiff1d(every, of_cells)])
    ascending = np.arange(1, len(own) + 1, dtype=own.dtype)
    model.mesh.renumberNodes(own, ascending)
    try:
        yield
    finally:
        model.mesh.renumberNodes(ascending, own)


@contextmanager
def _only_cells_and_facets(model: Any, dim: int) -> Iterator[None]:
    """Context in which there are no physical groups below facets, which nothing here asks for.

    DOLFINx would end the process where such a group has nodes of no cell.
    """
    groups = [group for group in model.getPhysicalGroups() if group[0] < dim - 1]
    known = [
        (*group, model.getEntitiesForPhysicalGroup(*group).tolist(), model.getPhysicalName(*group))
        for group in groups
    ]
    if groups:  # An empty list would stand for all groups.
        model.removePhysicalGroups(groups)
    try:
        yield
    finally:
        for of, tag, entities, name in known:
            model.addPhysicalGroup(of, entities, tag, name)


def _positions(model: Any) -> Floats:
    """Positions of the nodes by their numbers, shape ``(n, 3)`` [m]; none without a model."""
    if model is None:
        return np.empty((0, 3))
    numbers, x, _ = model.mesh.getNodes()
    X: Floats = np.reshape(x, (-1, 3))[np.argsort(numbers)]
    return X


def _dimension(model: Any) -> int:
    """Find the dimension of the cells of a gmsh model, and check that there are bodies."""
    if model.getPhysicalGroups(3):
        return 3
    if model.getEntities(3) or not model.getPhysicalGroups(2):
        raise ValueError(
            "expected physical volumes, or in a model without volumes physical surfaces, as "
            f"bodies, given {_without_bodies(model)}"
        )
    x = model.mesh.getNodes()[1].reshape(-1, 3)
    if np.abs(x[:, 2]).max(initial=0) > _FLAT * np.ptp(x[:, :2], axis=0).max(initial=0):
        low, high = x[:, 2].min(), x[:, 2].max()
        raise ValueError(
            "expected physical volumes, or surfaces in the plane z = 0, given surfaces from "
            f"z = {low:g} up to z = {high:g}: bodies are solid, there are no shells; mesh their "
            "volumes, gmsh.model.mesh.generate(3), and put these into physical groups"
        )
    return 2


def _without_bodies(model: Any) -> str:
    """Say what a gmsh model without bodies has, and what would make bodies of it."""
    for dim in (3, 2):
        if count := len(model.getEntities(dim)):
            return (
                f"{count} {_KINDS[dim]}{'s' * (count > 1)} in no physical group: call "
                f"model.addPhysicalGroup({dim}, [number, ...], name=...) for each body"
            )
    return (
        "a model without either: call synchronize() of model.occ or model.geo after adding "
        "shapes, and before making physical groups"
    )


def _inspect(model: Any, cell_dim: int) -> tuple[dict[str, int], dict[int, int]]:
    """Check a gmsh model; returns tags by name, and the number of facets by tag."""
    tags: dict[str, int] = {}
    groups_of = model.getPhysicalGroups
    for dim, tag in groups_of(cell_dim) + groups_of(cell_dim - 1):
        name = model.getPhysicalName(dim, tag) or f"{_KINDS[dim]} {tag}"
        if tags.setdefault(name, tag) != tag:
            raise ValueError(f"expected one tag for {name!r}, given {tags[name]} and {tag}")

    def names(types: Sequence[int]) -> str:
        return ", ".join(model.mesh.getElementProperties(t)[0] for t in types) or "no elements"

    types = model.mesh.getElementTypes(cell_dim)
    families = {family[-1]: family for family in _FAMILIES[cell_dim]}
    if len(types) != 1 or types[0] not in families:
        hint = ""
        if any(model.mesh.getElementProperties(t)[2] > 1 for t in types):
            hint = (
                "; of second order those without prisms, of one kind and with all their nodes "
                "(Mesh.SecondOrderIncomplete = 0), or call gmsh.model.mesh.setOrder(1)"
            )
        if _PYRAMIDS.intersection(types):
            hint = (
                "; pyramids lie between hexahedra and tetrahedra: mesh all volumes with tetrahedra "
                "(without recombined or transfinite ones), or mesh both kinds apart, without "
                "common nodes, and join them by a contact pair with Tied()"
            )
        if not len(types):
            hint = f": call gmsh.model.mesh.generate({cell_dim}) before read_mesh reads the model"
        raise ValueError(f"expected {_CELLS[cell_dim]}, given {names(types)}{hint}")
    expected = families[types[0]]
    num_facets: dict[int, int] = {}
    for dim, entity in model.getEntities():
        groups = model.getPhysicalGroupsForEntity(dim, entity).tolist()
        given, elements, _ = model.mesh.getElements(dim, entity)
        where = f"{_KINDS[dim]} {entity} in physical groups {groups}"
        is_cell, is_facet = dim == cell_dim, dim == cell_dim - 1
        if (is_cell and len(given) and len(groups) != 1) or (is_facet and len(groups) > 1):
            hint = (
                "put each region into one group only"
                if groups
                else f"make it a body by model.addPhysicalGroup({dim}, [{entity}], name=...), or "
                "remove it if it was only an aid to the construction"
            )
            raise ValueError(f"expected one physical group, given {where}: {hint}")
        if groups and list(given) != [expected[dim]]:
            raise ValueError(f"{where}: expected {names([expected[dim]])}, given {names(given)}")
        if is_facet and groups:
            num_facets[groups[0]] = num_facets.get(groups[0], 0) + len(elements[0])
    _check_cells(model, types[0], cell_dim)
    return tags, num_facets


def _check_cells(model: Any, cell: int, dim: int) -> None:
    """Raise if a cell is flat somewhere, or has different signs of det J."""
    _, _, order, _, points, _ = model.mesh.getElementProperties(cell)
    if order > 1:
        # Where two edges of a cell are on a smooth surface, the node between them is flat.
        points, _ = model.mesh.getIntegrationPoints(cell, "Gauss4")
    tags, _ = model.mesh.getElementsByType(cell)
    jacobians, det, places = model.mesh.getJacobians(cell, points)
    tangents = jacobians.reshape(len(tags), -1, 3, 3)[:, :, :dim]
    if dim == 2:  # of surfaces gmsh gives the absolute value
        det = np.linalg.det(tangents[..., :2])
    det = det.reshape(len(tags), -1)
    longest = np.linalg.norm(tangents, axis=3).max(axis=(1, 2))
    good = det * np.sign(det[:, :1]) > _FLAT * longest[:, None] ** dim
    bad = np.flatnonzero(~good.all(axis=1))
    if len(bad):
        midpoint = places.reshape(*det.shape, 3)[bad[0]].mean(axis=0)
        raise ValueError(
            f"expected det J of one sign in a cell, given {len(bad)} inverted or "
            f"degenerate cells, first gmsh element {tags[bad[0]]} at {midpoint.round(6).tolist()}"
        )
