"""Every difference between the DOLFINx releases this package runs on.

Features are detected, versions are never compared; each shim says what
changed, in which release, and when it can be deleted.
"""

from importlib import import_module
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import Mesh, MeshTags, meshtags

# The gmsh reader `dolfinx.io.gmshio` became `dolfinx.io.gmsh` in 0.10.
# Import it directly when 0.9 is dropped.
try:
    _reader = import_module("dolfinx.io.gmsh")
except ModuleNotFoundError:
    _reader = import_module("dolfinx.io.gmshio")

__all__ = ["model_to_mesh", "vtx_writer"]


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
