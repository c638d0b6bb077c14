"""Meshes: read gmsh files and live gmsh models, build simple bodies.

First stage of the pipeline: the volumes and surfaces of a gmsh model
become the tagged cells and facets of a distributed DOLFINx mesh, and
the names of its physical groups lead to the tags.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, NoReturn

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh, MeshTags

from dolfinx_nts import compat

__all__ = ["MeshData", "add_box", "add_hollow_ball", "read_mesh"]

_KINDS = ("point", "curve", "surface", "volume")
_CELLS = {"tetrahedron": 4, "hexahedron": 5}  # gmsh element types
_FACETS = {4: 2, 5: 3}  # of a tetrahedron triangles, of a hexahedron quadrangles

# A corner is flat up to rounding if det J is smaller than this, relative
# to the cube of the longest tangent of the cell.
_FLAT = 1e-12


class MeshData(NamedTuple):
    """A distributed mesh and its named regions.

    Attributes:
        mesh: Hexahedra or tetrahedra [m], with the connectivities
            between cells and facets.
        cells: Tags of the physical volumes; every cell has one.
        facets: Tags of the physical surfaces.
        tag: Tags by name, read-only. A group without a name is called
            by its tag, ``"volume 3"`` or ``"surface 3"``; an unknown
            name raises ``ValueError`` with the names that exist.
    """

    mesh: Mesh
    cells: MeshTags
    facets: MeshTags
    tag: Mapping[str, int]


class _Tags(dict[str, int]):
    def __missing__(self, name: str) -> NoReturn:
        raise ValueError(f"expected a physical group out of {sorted(self)}, given {name!r}")


def read_mesh(source: Any, comm: MPI.Comm, *, rank: int = 0) -> MeshData:
    """Read a mesh with named physical groups.

    Collective; every error is raised on all ranks. Mirrored cells are
    accepted, as DOLFINx integrates with ``|det J|``.

    Args:
        source: Path of a ``.msh`` file, or a live gmsh model such as
            ``gmsh.model``; looked at on ``rank`` only. The current
            model and the log level of gmsh stay as they are.
        comm: Communicator of the mesh.
        rank: Rank that reads the file or owns the live model.

    Returns:
        Mesh, cell tags, facet tags and tags by name.

    Raises:
        OSError: The file cannot be read.
        ImportError: gmsh is not installed on ``rank``.
        TypeError: ``source`` is neither a path nor a gmsh model.
        ValueError: The file is no mesh; cells are mixed, of higher
            order, or not in exactly one physical volume; ``det J``
            vanishes or changes sign between the corners of a cell; a
            name stands for two tags; a physical surface has facets
            that belong to no cell, or shares some with another.
    """
    if not 0 <= rank < comm.size:
        raise ValueError(f"expected a rank below {comm.size}, given {rank}")
    with ExitStack() as stack:
        model, failure = None, None
        tags: dict[str, int] = {}
        num_facets: dict[int, int] = {}
        if comm.rank == rank:
            try:
                model = stack.enter_context(_opened(source))
                tags, num_facets = _inspect(model)
            except (ImportError, OSError, TypeError, ValueError) as error:
                failure = error
            except Exception as error:  # gmsh has no exception class of its own
                failure = ValueError(f"expected a gmsh mesh, given {source}: {error}")
        failure, tags, num_facets = comm.bcast((failure, tags, num_facets), root=rank)
        if failure is not None:
            raise failure
        mesh, cells, facets = compat.model_to_mesh(model, comm, rank)

    mesh.topology.create_connectivity(2, 3)
    mesh.topology.create_connectivity(3, 2)
    owned = facets.values[facets.indices < mesh.topology.index_map(2).size_local]
    for tag, expected in num_facets.items():
        given = comm.allreduce(np.count_nonzero(owned == tag))
        if given != expected:
            raise ValueError(
                f"physical surface {tag}: expected {expected} facets of cells, given {given}"
            )
    return MeshData(mesh, cells, facets, MappingProxyType(_Tags(tags)))


@contextmanager
def _opened(source: Any) -> Iterator[Any]:
    """Yield a live model, or that of a file and clean up behind it."""
    try:
        import gmsh
    except (ImportError, OSError) as error:  # OSError: gmsh misses a library
        raise ImportError(f"expected the Python module gmsh, given {error}") from error
    if not isinstance(source, str | os.PathLike):
        if not hasattr(source, "getPhysicalGroups"):
            raise TypeError(f"expected a path or a gmsh model, given {source!r}")
        if not gmsh.isInitialized():
            raise ValueError("expected a live gmsh model, given gmsh before gmsh.initialize()")
        yield source
        return
    with Path(source).open("rb") as file:
        # gmsh would run a file that it does not recognise as a script.
        if not file.read(16).startswith((b"$MeshFormat", b"$Comments")):
            raise ValueError(f"expected a gmsh mesh (.msh), given {source}")
    initialised = gmsh.isInitialized()
    if not initialised:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    current, terminal = gmsh.model.getCurrent(), gmsh.option.getNumber("General.Terminal")
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add(f"dolfinx_nts {source}")
    try:
        gmsh.merge(str(source))
        gmsh.model.mesh.renumberNodes()
        yield gmsh.model
    finally:
        gmsh.model.remove()
        gmsh.model.setCurrent(current)
        gmsh.option.setNumber("General.Terminal", terminal)
        if not initialised:
            gmsh.finalize()


def _inspect(model: Any) -> tuple[dict[str, int], dict[int, int]]:
    """Check a gmsh model; return tags by name and facets per tag."""
    if not model.getPhysicalGroups(3):
        raise ValueError("expected physical volumes (gmsh addPhysicalGroup(3, ...)), given none")
    tags: dict[str, int] = {}
    for dim, tag in model.getPhysicalGroups(3) + model.getPhysicalGroups(2):
        name = model.getPhysicalName(dim, tag) or f"{_KINDS[dim]} {tag}"
        if tags.setdefault(name, tag) != tag:
            raise ValueError(f"expected one tag for {name!r}, given {tags[name]} and {tag}")

    def names(types: Sequence[int]) -> str:
        return ", ".join(model.mesh.getElementProperties(t)[0] for t in types) or "no elements"

    types = model.mesh.getElementTypes(3)
    if any(model.mesh.getElementProperties(t)[2] > 1 for t in types):
        hint = "set Mesh.ElementOrder to 1 or call gmsh.model.mesh.setOrder(1)"
        raise ValueError(f"expected first-order cells, given {names(types)}; {hint}")
    if len(types) != 1 or types[0] not in _FACETS:
        raise ValueError(f"expected all hexahedra or all tetrahedra, given {names(types)}")
    expected = (15, 1, _FACETS[types[0]], types[0])  # elements by dimension, from the point on
    num_facets: dict[int, int] = {}
    for dim, entity in model.getEntities():
        groups = model.getPhysicalGroupsForEntity(dim, entity).tolist()
        given, elements, _ = model.mesh.getElements(dim, entity)
        where = f"{_KINDS[dim]} {entity} in physical groups {groups}"
        if (dim == 3 and len(given) and len(groups) != 1) or (dim == 2 and len(groups) > 1):
            raise ValueError(f"expected one physical group, given {where}")
        if groups and list(given) != [expected[dim]]:
            raise ValueError(f"{where}: expected {names([expected[dim]])}, given {names(given)}")
        if dim == 2 and groups:
            num_facets[groups[0]] = num_facets.get(groups[0], 0) + len(elements[0])
    nodes, _, _ = model.mesh.getNodes()
    if len(nodes) != nodes.max():
        raise ValueError("expected nodes 1, 2, 3, ...; call gmsh.model.mesh.renumberNodes()")
    _check_cells(model, types[0])
    return tags, num_facets


def _check_cells(model: Any, cell: int) -> None:
    """Refuse cells with a flat corner or with corners of both signs."""
    corners = model.mesh.getElementProperties(cell)[4]
    tags, _ = model.mesh.getElementsByType(cell)
    jacobians, det, points = model.mesh.getJacobians(cell, corners)
    det = det.reshape(len(tags), -1)
    longest = np.linalg.norm(jacobians.reshape(len(tags), -1, 3), axis=2).max(axis=1)
    good = det * np.sign(det[:, :1]) > _FLAT * longest[:, None] ** 3
    bad = np.flatnonzero(~good.all(axis=1))
    if len(bad):
        midpoint = points.reshape(*det.shape, 3)[bad[0]].mean(axis=0)
        raise ValueError(
            f"expected det J of one sign at the corners of a cell, given {len(bad)} inverted or "
            f"degenerate cells, first gmsh element {tags[bad[0]]} at {midpoint.round(6).tolist()}"
        )


# --- bodies ------------------------------------------------------------

# Corners of the gmsh hexahedron, and its sides: axis of a block of
# hexahedra (nx, ny, nz, 8), layer, corners anticlockwise from outside.
_CORNERS = np.array([(*ij, k) for k in (0, 1) for ij in ((0, 0), (1, 0), (1, 1), (0, 1))])
_SIDES = {
    "left": (-4, 0, (3, 0, 4, 7)),
    "right": (-4, -1, (1, 2, 6, 5)),
    "front": (-3, 0, (0, 1, 5, 4)),
    "back": (-3, -1, (2, 3, 7, 6)),
    "bottom": (-2, 0, (0, 3, 2, 1)),
    "top": (-2, -1, (4, 5, 6, 7)),
}

_Ints = npt.NDArray[np.int64]


def add_box(
    model: Any,
    name: str,
    *,
    corner: Sequence[float],
    size: Sequence[float],
    cells: Sequence[int],
    cell: str = "hexahedron",
) -> None:
    """Add a box of equal cells to a live gmsh model.

    Local. Creates the physical volume ``name`` and the physical
    surfaces ``name_left``, ``name_right`` (lowest, highest x),
    ``name_front``, ``name_back`` (y), ``name_bottom``, ``name_top`` (z).

    Args:
        model: Live gmsh model.
        name: Name of the body.
        corner: Lowest coordinates, shape ``(3,)`` [m].
        size: Edge lengths, shape ``(3,)`` [m].
        cells: Number of hexahedra along the edges, shape ``(3,)``.
        cell: ``"hexahedron"``; ``"tetrahedron"`` splits each into six.

    Raises:
        ValueError: A size or number is not positive; unknown ``cell``.
    """
    if min(size) <= 0 or min(cells) < 1:
        raise ValueError(f"expected positive size and cells, given {size} and {cells}")
    ids = np.arange(np.prod(np.add(cells, 1))).reshape(np.add(cells, 1))
    x = corner + np.argwhere(ids >= 0) / cells * size
    hexahedra = _hexahedra(ids)
    _add_body(model, name, x, hexahedra, {side: _side(hexahedra, side) for side in _SIDES}, cell)


def add_hollow_ball(
    model: Any,
    name: str,
    *,
    centre: Sequence[float],
    inner_radius: float,
    outer_radius: float,
    cells_per_edge: int,
    layers: int,
    cell: str = "hexahedron",
) -> None:
    """Add a hollow ball, an equiangular cubed sphere, to a gmsh model.

    Local. The nodes of a cube face with parameters a, b in [-1, 1] lie
    in the directions ``(tan(pi a / 4), tan(pi b / 4), 1)``, evenly
    spaced in a, b and the radius. Creates the physical volume ``name``
    and the physical surfaces ``name_outer`` and ``name_inner``.

    Args:
        model: Live gmsh model.
        name: Name of the body.
        centre: Centre, shape ``(3,)`` [m].
        inner_radius: Radius of the cavity [m].
        outer_radius: Radius of the ball [m].
        cells_per_edge: Number of hexahedra along an edge of the cube.
        layers: Number of hexahedra through the wall.
        cell: ``"hexahedron"``; ``"tetrahedron"`` splits each into six.

    Raises:
        ValueError: A radius or number out of range; unknown ``cell``.
    """
    if not 0 < inner_radius < outer_radius:
        raise ValueError(f"expected 0 < inner < outer radius, given {inner_radius}, {outer_radius}")
    if min(cells_per_edge, layers) < 1:
        raise ValueError(
            f"expected positive numbers, given {cells_per_edge} cells, {layers} layers"
        )
    n = cells_per_edge
    lattice = np.moveaxis(np.indices((n + 1, n + 1, n + 1)), 0, -1)
    on_cube = ((lattice == 0) | (lattice == n)).any(axis=-1)
    direction = np.tan(np.pi / 4 * (2 * lattice[on_cube] - n) / n)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radii = np.linspace(inner_radius, outer_radius, layers + 1)
    x = centre + radii[:, None, None] * direction

    ids = np.full(on_cube.shape, -1)
    ids[on_cube] = np.arange(len(direction))
    # Transposed where the two lattice axes and the outward direction
    # would make a left-handed triple.
    faces = (ids[-1], ids[0].T, ids[:, -1].T, ids[:, 0], ids[:, :, -1], ids[:, :, 0].T)
    wall = len(direction) * np.arange(layers + 1)
    hexahedra = np.stack([_hexahedra(face[:, :, None] + wall) for face in faces])
    surfaces = {"outer": _side(hexahedra, "top"), "inner": _side(hexahedra, "bottom")}
    _add_body(model, name, x, hexahedra, surfaces, cell)


def _hexahedra(ids: _Ints) -> _Ints:
    """Connect a grid of nodes (nx + 1, ...) to hexahedra (nx, ..., 8)."""
    nx, ny, nz = np.subtract(ids.shape, 1)
    i, j, k = np.indices((nx, ny, nz))[..., None] + _CORNERS.T[:, None, None, None]
    return np.asarray(ids[i, j, k])


def _side(hexahedra: _Ints, side: str) -> _Ints:
    """Quadrangles on one side of blocks of hexahedra."""
    axis, layer, corners = _SIDES[side]
    return hexahedra.take([layer], axis=axis)[..., corners]


def _triangles(quadrangles: _Ints) -> _Ints:
    """Cut quadrangles from their lowest node, so that neighbours agree."""
    turned = (quadrangles.argmin(axis=-1)[..., None] + np.arange(4)) % 4
    return np.take_along_axis(quadrangles, turned, axis=-1)[..., [[0, 1, 2], [0, 2, 3]]]


def _tetrahedra(hexahedra: _Ints) -> _Ints:
    """Cut hexahedra into six from their lowest node: conforming."""
    sides = hexahedra[:, [corners for *_, corners in _SIDES.values()]]
    lowest = hexahedra.min(axis=1)
    opposite = (sides != lowest[:, None, None]).all(axis=2)  # three of the six sides
    triangles = _triangles(sides[opposite]).reshape(-1, 3)
    return np.column_stack((np.repeat(lowest, 6), triangles))


def _add_body(
    model: Any,
    name: str,
    x: npt.NDArray[np.float64],
    hexahedra: _Ints,
    surfaces: Mapping[str, _Ints],
    cell: str,
) -> None:
    """Add nodes, cells and named sides as discrete gmsh entities."""
    if cell not in _CELLS:
        raise ValueError(f"expected cell out of {sorted(_CELLS)}, given {cell!r}")
    split = cell == "tetrahedron"
    first = int(model.mesh.getMaxNodeTag()) + 1
    entities = [model.addDiscreteEntity(2) for _ in surfaces]
    volume = model.addDiscreteEntity(3, boundary=entities)
    model.mesh.addNodes(3, volume, first + np.arange(x.size // 3), x.ravel())
    cells = first + (_tetrahedra(hexahedra.reshape(-1, 8)) if split else hexahedra)
    model.mesh.addElementsByType(volume, _CELLS[cell], [], cells.ravel())
    model.addPhysicalGroup(3, [volume], name=name)
    for entity, (side, facets) in zip(entities, surfaces.items(), strict=True):
        facets = first + (_triangles(facets) if split else facets)
        model.mesh.addElementsByType(entity, _FACETS[_CELLS[cell]], [], facets.ravel())
        model.addPhysicalGroup(2, [entity], name=f"{name}_{side}")
