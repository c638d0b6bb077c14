"""Meshes with named regions from gmsh, and functions that add bodies to a gmsh model."""

from dolfinx_nts.meshing.gmsh import MeshData, read_mesh
from dolfinx_nts.meshing.parts import (
    add_bowl,
    add_box,
    add_hollow_ball,
    add_rectangle,
    add_ring,
    add_solid_ball,
    add_torus,
)

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
