"""Meshes: from gmsh, and shapes of hexahedra or tetrahedra for it."""

from dolfinx_nts.meshing.gmsh import (
    MeshData,
    add_bowl,
    add_box,
    add_hollow_ball,
    add_ring,
    add_solid_ball,
    add_torus,
    read_mesh,
)

__all__ = [
    "MeshData",
    "add_bowl",
    "add_box",
    "add_hollow_ball",
    "add_ring",
    "add_solid_ball",
    "add_torus",
    "read_mesh",
]
