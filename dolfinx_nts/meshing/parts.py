"""Bodies for a gmsh model: boxes, balls, bowls, rings, tori, rectangles, and mesh files.

Their cells are hexahedra or tetrahedra, in the plane quadrilaterals or triangles. Each function
adds one body with named surfaces to a gmsh model in memory, and `read_mesh` creates the mesh of all
bodies. Bodies do not share nodes. All functions are local: they are called on the rank with the
model.
"""

from dolfinx_nts.meshing.balls import add_bowl, add_hollow_ball, add_solid_ball
from dolfinx_nts.meshing.boxes import add_box, add_rectangle
from dolfinx_nts.meshing.files import add_mesh
from dolfinx_nts.meshing.rings import add_ring, add_torus

__all__ = [
    "add_bowl",
    "add_box",
    "add_hollow_ball",
    "add_mesh",
    "add_rectangle",
    "add_ring",
    "add_solid_ball",
    "add_torus",
]
