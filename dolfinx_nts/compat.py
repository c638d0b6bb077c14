"""Every difference between the DOLFINx releases this package runs on.

Features are detected, versions are never compared; each shim says what
changed, in which release, and when it can be deleted.
"""

from importlib import import_module
from typing import Any

from mpi4py import MPI

import cffi
import numpy as np
from dolfinx.common import IndexMap
from dolfinx.mesh import Geometry, GhostMode, Mesh, MeshTags, create_cell_partitioner, meshtags

from dolfinx_nts.common.arrays import GlobalInts, Ints

# The gmsh reader `dolfinx.io.gmshio` became `dolfinx.io.gmsh` in 0.10.
# Import it directly when 0.9 is dropped.
try:
    _reader = import_module("dolfinx.io.gmsh")
except ModuleNotFoundError:
    _reader = import_module("dolfinx.io.gmshio")

# `Geometry` has the attributes `dofmaps` and `cmaps`, one entry a cell type, since
# 0.11, which deprecates `dofmap` and `cmap`. Use them directly when 0.10 is dropped.
_HAS_LISTS = all(
    isinstance(getattr(Geometry, name, None), property) for name in ("cmaps", "dofmaps")
)

_ffi = cffi.FFI()

__all__ = [
    "cell_partitioner",
    "cpp_object",
    "geometry_degree",
    "geometry_nodes",
    "index_map",
    "kernel",
    "model_to_mesh",
    "shared",
    "vtx_writer",
]


def geometry_nodes(mesh: Mesh) -> Ints:
    """Nodes of the geometry of each local cell of a mesh with one type of cells."""
    nodes = mesh.geometry.dofmaps[0] if _HAS_LISTS else mesh.geometry.dofmap
    return np.asarray(nodes)


def geometry_degree(mesh: Mesh) -> int:
    """Degree of the cells of a mesh with one type of cells."""
    geometry = mesh.geometry
    return int((geometry.cmaps[0] if _HAS_LISTS else geometry.cmap).degree)


def cell_partitioner(ghosts: GhostMode) -> Any:
    """Partitioner of `dolfinx.mesh.create_mesh` with a ghost mode."""
    # 0.11 must be told how many cells share a facet. Always tell it when 0.9 is dropped.
    try:
        return create_cell_partitioner(ghosts)
    except TypeError:
        return create_cell_partitioner(ghosts, 2)


def cpp_object(item: Any) -> Any:
    """What stands behind an object of DOLFINx where C++ expects it."""
    # The space of a condition and an adjacency list are Python classes since 0.10 or
    # 0.11. Use the attribute directly when 0.10 is dropped.
    return getattr(item, "_cpp_object", item)


def index_map(comm: MPI.Comm, size: int, ghosts: GlobalInts, owners: Ints) -> IndexMap:
    """Index map with owned entries and ghosts. Collective."""
    # 0.11 must be told the tag of its messages, before it was 1202. Always tell it
    # when 0.10 is dropped.
    try:
        return IndexMap(comm, size, ghosts, owners, 1202)
    except TypeError:
        return IndexMap(comm, size, ghosts, owners)


def kernel(integral: Any) -> tuple[int, bool]:
    """Address of FFCx's kernel of an integral, and whether it takes data of the user's."""
    # It does since FFCx 0.10. Drop the second value when 0.9 is dropped.
    function = integral.tabulate_tensor_float64
    address = int(_ffi.cast("uintptr_t", function))
    return address, len(_ffi.typeof(function).args) == 7


def shared(index_map: IndexMap) -> Ints:
    """Owned entries that are ghosts of other ranks. Collective."""
    if index_map.comm.size == 1:
        return np.empty(0, dtype=np.int32)
    # 0.11 must be told the tag of its messages. Always tell it when 0.10 is dropped.
    try:
        ranks = index_map.index_to_dest_ranks()
    except TypeError:
        ranks = index_map.index_to_dest_ranks(1203)
    owned = ranks.offsets[: index_map.size_local + 1]  # then those of ghosts
    return np.flatnonzero(np.diff(owned)).astype(np.int32)


def model_to_mesh(model: Any, comm: MPI.Comm, rank: int) -> tuple[Mesh, MeshTags, MeshTags]:
    """Distribute a three-dimensional gmsh model as a DOLFINx mesh.

    Collective.

    Args:
        model: gmsh model, read on ``rank`` only.
        comm: Communicator of the mesh.
        rank: Rank on which ``model`` lives.

    Returns:
        Mesh, cell tags and facet tags; the facet tags are empty if the
        model has no physical surface.
    """
    # 0.9 returns three values, 0.10 a longer named tuple whose facet
    # tags are None without physical surfaces. Replace by attribute
    # access when 0.9 is dropped.
    mesh, cells, facets = _reader.model_to_mesh(model, comm, rank, gdim=3)[:3]
    if facets is None:
        none = np.empty(0, dtype=np.int32)
        facets = meshtags(mesh, mesh.topology.dim - 1, none, none)
    return mesh, cells, facets


def vtx_writer() -> Any:
    """Class `dolfinx.io.VTXWriter`.

    Raises:
        RuntimeError: This DOLFINx was built without ADIOS2.
    """
    # Not a matter of the release but of how DOLFINx was built.
    writer = getattr(import_module("dolfinx.io"), "VTXWriter", None)
    if writer is None:
        raise RuntimeError("expected a DOLFINx with ADIOS2 for VTX files; it writes XDMF without")
    return writer
