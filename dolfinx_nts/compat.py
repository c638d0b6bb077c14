"""Differences between the supported releases of DOLFINx.

Features are detected, versions are never compared. A comment in each function says
what changed, in which release, and when the function can be simplified.
"""

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib import import_module, metadata
from typing import Any

from mpi4py import MPI

import basix.ufl
import cffi
import numpy as np
from dolfinx import fem
from dolfinx.common import IndexMap
from dolfinx.cpp.mesh import cell_dim, cell_num_vertices
from dolfinx.graph import adjacencylist
from dolfinx.io.utils import distribute_entity_data
from dolfinx.mesh import (
    CellType,
    Geometry,
    GhostMode,
    Mesh,
    MeshTags,
    create_cell_partitioner,
    create_mesh,
    meshtags_from_entities,
)

from dolfinx_nts.common.arrays import Array, Floats, GlobalInts, Ints

# The gmsh reader `dolfinx.io.gmshio` became `dolfinx.io.gmsh` in 0.10.
# Import it directly when 0.9 is dropped.
try:
    _reader = import_module("dolfinx.io.gmsh")
except ModuleNotFoundError:
    _reader = import_module("dolfinx.io.gmshio")

# Since 0.11 `Geometry` has the attributes `dofmaps` and `cmaps`, with one entry for
# each cell type; `dofmap` and `cmap` are deprecated. Use the new ones directly when
# 0.10 is dropped.
_HAS_LISTS = all(
    isinstance(getattr(Geometry, name, None), property) for name in ("cmaps", "dofmaps")
)

# Tags of MPI messages [-], arguments since release 0.11: any two different numbers; the first one
# is that of earlier releases.
_TAG_OF_INDEX_MAP, _TAG_OF_SHARED = 1202, 1203

_ffi = cffi.FFI()

__all__ = [
    "cell_partitioner",
    "cpp_object",
    "form_of_kernels",
    "geometry_degree",
    "geometry_nodes",
    "index_map",
    "kernel",
    "modules_loaded_once",
    "order_of_gmsh",
    "quicker_ffcx",
    "shared",
    "tagged_mesh",
    "vtx_writer",
]


def geometry_nodes(mesh: Mesh) -> Ints:
    """Nodes of the geometry of each local cell. Local.

    Args:
        mesh: A mesh with one type of cells.

    Returns:
        Local indices into ``mesh.geometry.x``, shape ``(c, k)``.
    """
    nodes = mesh.geometry.dofmaps[0] if _HAS_LISTS else mesh.geometry.dofmap
    return np.asarray(nodes)


def geometry_degree(mesh: Mesh) -> int:
    """Polynomial degree of the geometry of a mesh with one type of cells. Local."""
    geometry = mesh.geometry
    return int((geometry.cmaps[0] if _HAS_LISTS else geometry.cmap).degree)


def cell_partitioner(ghosts: GhostMode) -> Any:
    """Partitioner with a ghost mode, for `dolfinx.mesh.create_mesh`. Local."""
    # Release 0.11 requires the largest number of cells at a facet. Remove the other call when 0.9
    # is dropped.
    try:
        return create_cell_partitioner(ghosts)
    except TypeError:
        return create_cell_partitioner(ghosts, 2)


def cpp_object(item: Any) -> Any:
    """C++ object of a Python object of DOLFINx, for functions that require it. Local."""
    # Spaces of boundary conditions and adjacency lists became Python classes in 0.10
    # and 0.11. Use the attribute directly when 0.10 is dropped.
    return getattr(item, "_cpp_object", item)


def index_map(comm: MPI.Comm, size: int, ghosts: GlobalInts, owners: Ints) -> IndexMap:
    """Create an index map of owned entries and of ghosts with their owners. Collective."""
    # Release 0.11 requires a tag of its messages. Remove the other call when 0.10 is dropped.
    try:
        return IndexMap(comm, size, ghosts, owners, _TAG_OF_INDEX_MAP)
    except TypeError:
        return IndexMap(comm, size, ghosts, owners)


def form_of_kernels(
    spaces: Sequence[fem.FunctionSpace],
    kernels: Sequence[tuple[int, Ints]],
    functions: Sequence[fem.Function],
    constants: Sequence[fem.Constant],
) -> fem.Form:
    """Form over cells with kernels that FFCx has not compiled. Collective.

    Args:
        spaces: Function spaces of the arguments of the form.
        kernels: Address of a kernel with FFCx's interface, and owned cells, for each integral.
        functions: Coefficients of the form, in the order of the kernels.
        constants: Constants of the form, in the order of the kernels.
    """
    # Maps of entities became a list in 0.10. Use that when 0.9 is dropped.
    has = np.arange(len(functions), dtype=np.int8)
    integrals = [(number, *given, has) for number, given in enumerate(kernels)]
    given = (
        [space._cpp_object for space in spaces],
        {fem.IntegralType.cell: integrals},
        [function._cpp_object for function in functions],
        [constant._cpp_object for constant in constants],
        False,
    )
    make = fem.forms.form_cpp_class(np.float64)
    mesh = [*spaces, *(function.function_space for function in functions)][0].mesh._cpp_object
    try:
        return fem.Form(make(*given, [], mesh))
    except TypeError:
        return fem.Form(make(*given, {}, mesh))


def kernel(integral: Any) -> tuple[int, bool]:
    """Address of FFCx's kernel of an integral, and whether it has a seventh argument.

    Local. The seventh argument is a pointer to data of the user.
    """
    # The seventh argument exists since FFCx 0.10. Drop the second value when 0.9 is dropped.
    function = integral.tabulate_tensor_float64
    address = int(_ffi.cast("uintptr_t", function))
    return address, len(_ffi.typeof(function).args) == 7


def shared(index_map: IndexMap) -> Ints:
    """Owned entries of an index map that are ghosts on other ranks. Collective."""
    if index_map.comm.size == 1:
        return np.empty(0, dtype=np.int32)
    # Release 0.11 requires a tag of its messages. Remove the other call when 0.10 is dropped.
    try:
        ranks = index_map.index_to_dest_ranks()
    except TypeError:
        ranks = index_map.index_to_dest_ranks(_TAG_OF_SHARED)
    owned = ranks.offsets[: index_map.size_local + 1]  # offsets of ghosts follow
    return np.flatnonzero(np.diff(owned)).astype(np.int32)


def order_of_gmsh(cell: str, num_nodes: int) -> list[int]:
    """Permutation from gmsh's to DOLFINx's order of the nodes of a cell. Local.

    Args:
        cell: Name of the cell in DOLFINx.
        num_nodes: Number of its nodes.
    """
    return list(_reader.cell_perm_array(CellType[cell], num_nodes))


def tagged_mesh(
    comm: MPI.Comm,
    cell: str,
    degree: int,
    x: Floats,
    cells: tuple[GlobalInts, GlobalInts],
    facets: tuple[GlobalInts, GlobalInts],
    ranks_of_cells: Callable[[Array, int], Ints],
) -> tuple[Mesh, MeshTags, MeshTags]:
    """Distribute a mesh with tags of cells and facets, which is on one rank. Collective.

    Args:
        comm: Communicator of the mesh.
        cell: Name of the cells.
        degree: Polynomial degree of their geometry.
        x: Positions of the nodes, shape ``(n, 3)``; none on the other ranks.
        cells: Rows of x of each cell in the order of DOLFINx, shape ``(c, k)``, and its tag.
        facets: Rows of x of each tagged facet, shape ``(f, l)``, and its tag.
        ranks_of_cells: Called on all ranks with the vertices of their cells, rows of x, shape
            ``(c, k)``, and the number of ranks; returns the owner of each.

    Returns:
        Mesh, cell tags and facet tags.
    """

    def partitioner(_comm: Any, num_ranks: int, types: Any, cells: Any) -> Any:
        vertices = np.asarray(cells[0]).reshape(-1, cell_num_vertices(types[0]))
        owners = ranks_of_cells(vertices, num_ranks).astype(np.int32)
        return cpp_object(adjacencylist(owners, np.arange(len(owners) + 1, dtype=np.int32)))

    def tags(name: str, dim: int, entities: GlobalInts, values: GlobalInts) -> MeshTags:
        vertices, own = distribute_entity_data(mesh, dim, entities, values.astype(np.int32))
        mesh.topology.create_connectivity(dim, 0)
        mesh.topology.create_connectivity(dim, tdim)
        lists = adjacencylist(vertices)
        found = meshtags_from_entities(mesh, dim, lists, own.astype(np.int32, copy=False))
        found.name = name
        return found

    tdim = cell_dim(CellType[cell])
    variant = basix.LagrangeVariant.equispaced
    element = basix.ufl.element("P", cell, degree, variant, shape=(tdim,), dtype=np.float64)
    chosen = partitioner if comm.size > 1 else None
    # The order of arguments changed in 0.10, their names did not.
    mesh = create_mesh(
        comm=comm, cells=cells[0], x=x[:, :tdim].copy(), e=element, partitioner=chosen
    )
    return mesh, tags("Cell tags", tdim, *cells), tags("Facet tags", tdim - 1, *facets)


# Modules of FFCx that this process has loaded, by folder of the cache and name.
_loaded: dict[tuple[str, str], Any] = {}


@contextmanager
def modules_loaded_once() -> Iterator[None]:
    """Context in which FFCx loads a module once in a process. Local.

    Otherwise FFCx lists all files of its cache, which may be thousands, twice for each form.
    """
    # All releases of FFCx so far need this. Remove it when one does not.
    jit: Any = import_module("ffcx.codegeneration.jit")
    look_up: Any = getattr(jit, "get_cached_module", None)

    def get_cached_module(name: str, objects: Any, folder: Any, *rest: Any) -> Any:
        module = _loaded.get((str(folder), name))
        if module is not None:
            return [getattr(module.lib, each) for each in objects], module
        found, module = look_up(name, objects, folder, *rest)
        if module is not None:
            _loaded[str(folder), name] = module
        return found, module

    if look_up is not None:
        jit.get_cached_module = get_cached_module
    try:
        yield
    finally:
        if look_up is not None:
            jit.get_cached_module = look_up


@contextmanager
def quicker_ffcx() -> Iterator[None]:
    """Context in which FFCx generates the same code in half to two thirds of the time. Local.

    - Elements return the same UFL cell each time, instead of a new one.
    - Nodes of an expression are found by hash, not by comparison with all nodes.
    - Two expressions are compared once per node, not once per path to a node.
    - The garbage collector of Python is off, as all expressions are in use.
    - Setuptools, which runs the compiler, reads the metadata of all installed packages once, not
      seven times for each form.

    See also `modules_loaded_once`.
    """
    # Needed for all releases so far. Remove each part that a later release does itself.
    cells: dict[Any, Any] = {}
    element: Any = getattr(basix.ufl, "_ElementBase", None)
    numberer = _value_numberer()
    expression: Any = import_module("ufl.core.expr").Expr
    given: Any = getattr(element, "cell", None), getattr(numberer, "get_node_symbols", None)
    equals: Any = expression.__eq__

    def cell(self: Any) -> Any:
        if self.cell_type not in cells:
            cells[self.cell_type] = given[0].fget(self)
        return cells[self.cell_type]

    def get_node_symbols(self: Any, expr: Any) -> Any:
        numbers = getattr(self.G, "e2i", None)
        return given[1](self, expr) if numbers is None else self.V_symbols[numbers[expr]]

    if isinstance(given[0], property):
        element.cell = property(cell)
    if given[1] is not None:
        numberer.get_node_symbols = get_node_symbols
    expression.__eq__ = _equal
    collects, metadata.entry_points = gc.isenabled(), _entry_points
    gc.disable()
    try:
        with modules_loaded_once():
            yield
    finally:
        metadata.entry_points = _entry_points.__wrapped__
        if collects:
            gc.enable()
        if isinstance(given[0], property):
            element.cell = given[0]
        if given[1] is not None:
            numberer.get_node_symbols = given[1]
        expression.__eq__ = equals


# Entry points of packages for setuptools, cached as no package is installed during a run.
_entry_points: Any = cache(metadata.entry_points)


def _equal(one: Any, other: Any) -> bool:
    """Whether two UFL expressions are equal, by the definition of UFL. Local."""
    if type(one) is not type(other) or hash(one) != hash(other):
        return False
    terminal: Any = import_module("ufl.core.terminal").Terminal
    left, seen = [(one, other)], {(id(one), id(other))}
    while left:
        a, b = left.pop()
        if a is b:
            continue
        if type(a) is not type(b) or len(a.ufl_operands) != len(b.ufl_operands):
            return False
        if isinstance(a, terminal) and a != b:
            return False
        for pair in zip(a.ufl_operands, b.ufl_operands, strict=True):
            key = id(pair[0]), id(pair[1])
            if key not in seen:
                seen.add(key)
                left.append(pair)
    # Equal expressions share their operands from now on.
    one.ufl_operands = other.ufl_operands
    return True


def _value_numberer() -> Any:
    """FFCx's class that numbers values of expressions, if it has one. Local."""
    try:
        return import_module("ffcx.ir.analysis.valuenumbering").ValueNumberer
    except (ImportError, AttributeError):
        return None


def vtx_writer() -> Any:
    """Class `dolfinx.io.VTXWriter`. Local.

    Raises:
        RuntimeError: DOLFINx was built without ADIOS2.
    """
    # This depends on the build options of DOLFINx, not on the release.
    writer = getattr(import_module("dolfinx.io"), "VTXWriter", None)
    if writer is None:
        raise RuntimeError(
            "expected a DOLFINx with ADIOS2 for VTX files; fields='xdmf' works without it"
        )
    return writer
