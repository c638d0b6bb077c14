"""Models of gmsh, and volumes and areas of the meshes read from them."""

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import MeshTags

from dolfinx_nts.meshing.gmsh import MeshData

ROUNDING = 1e3 * np.finfo(float).eps  # round-off of a sum over some hundred cells

BOX = {"corner": (0, 0, 0), "size": (1, 1, 1), "cells": (2, 2, 2)}


def measure(data: MeshData, name: str | None = None, kind: str = "dx") -> float:
    """Volume ("dx") or surface area ("ds") of a region, or of everything."""
    region = data.cells if kind == "dx" else data.facets
    form = ufl.Measure(kind, domain=data.mesh, subdomain_data=region)
    where = form if name is None else form(data.tag[name])
    local = fem.assemble_scalar(fem.form(fem.Constant(data.mesh, 1.0) * where))
    return float(data.mesh.comm.allreduce(local))


def count(data: MeshData, tags: MeshTags, name: str) -> int:
    """Number of cells or facets of a region, summed over ranks without ghosts."""
    owned = tags.indices < data.mesh.topology.index_map(tags.dim).size_local
    return int(data.mesh.comm.allreduce(np.count_nonzero(tags.values[owned] == data.tag[name])))
