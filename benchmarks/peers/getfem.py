"""The scene in GetFEM, where it is installed (``python3-getfem``).

Contact by ray tracing with multipliers (augmented Lagrangian, large sliding), St.
Venant-Kirchhoff material, trapezoidal rule, GetFEM's own Newton method and direct solver. Knows
nothing of DOLFINx: its PETSc and GetFEM want different libraries of the same solver.
"""

import subprocess
import time
from typing import Any

import getfem as gf
import numpy as np

from benchmarks.peers.scene import NU, RHO, E, H, Run, Scene, num_steps

__all__ = ["run", "version"]

# Augmentation parameter per area; a few times the stiffness of a cell, as GetFEM advises.
AUGMENTATION, RELEASE = E, 0.3
# Tolerance relative to the inertia force, which GetFEM also uses for the contact equation: at 1e-8
# it detects no contact.
TOLERANCE = 1e-14
OUTER, TOP = 1, 2  # regions


def version() -> str:
    """Version of the Debian package, as GetFEM does not report its own."""
    query = ["dpkg-query", "-W", "-f", "${Version}", "python3-getfem"]
    return subprocess.run(query, capture_output=True, text=True, check=False).stdout.split("+")[0]


def _mesh(scene: Scene) -> Any:
    """Mesh of hexahedra with the regions of the contact."""
    mesh = gf.Mesh("empty", 3)
    transformation = gf.GeoTrans("GT_QK(3,1)")
    # From gmsh's order of the vertices to that of a tensor product.
    for cell in scene.cells[:, [0, 1, 3, 2, 4, 5, 7, 6]]:
        mesh.add_convex(transformation, scene.X[cell].T)
    boundary = mesh.outer_faces()
    for region, facets in ((OUTER, scene.outer), (TOP, scene.top)):
        points = mesh.pid_from_coords(scene.X[np.unique(facets)].T)
        faces = [
            face for face in boundary.T if np.isin(mesh.pid_in_faces(face[:, None]), points).all()
        ]
        mesh.set_region(region, np.array(faces).T)
    return mesh


def _model(mesh: Any) -> tuple[Any, Any]:
    """Model of one step, and finite elements."""
    elements = gf.MeshFem(mesh, 3)
    elements.set_fem(gf.Fem("FEM_QK(3,1)"))
    volume = gf.MeshIm(mesh, gf.Integ("IM_GAUSS_PARALLELEPIPED(3,3)"))
    model = gf.Model("real")
    model.add_fem_variable("u", elements)
    for name in ("u0", "v0", "a0"):
        model.add_fem_data(name, elements)
    for name, value in (("rho", RHO), ("h", H), ("r", AUGMENTATION)):
        model.add_initialized_data(name, value)
    lame = [E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))]
    model.add_initialized_data("moduli", lame)
    model.add_finite_strain_elasticity_brick(volume, "SaintVenant Kirchhoff", "u", "moduli")
    model.add_linear_term(volume, "rho*(4/(h*h)*(u-u0-h*v0)-a0).Test_u")
    contact = model.add_integral_large_sliding_contact_brick_raytracing("r", RELEASE)
    model.add_filtered_fem_variable("p", elements, OUTER)
    add = model.add_slave_contact_boundary_to_large_sliding_contact_brick
    add(contact, volume, OUTER, "u", "p")
    model.add_master_contact_boundary_to_large_sliding_contact_brick(contact, volume, TOP, "u")
    return model, elements


def run(scene: Scene) -> Run:
    """Run the scene."""
    gf.util_trace_level(1)
    model, elements = _model(_mesh(scene))
    # Each node has three dofs in a row.
    dofs = elements.basic_dof_nodes()[:, ::3].T
    place = [int(np.abs(dofs - X).sum(axis=1).argmin()) for X in scene.X]
    v = np.zeros((len(dofs), 3))
    v[place] = scene.start
    v = v.ravel()
    u, a = np.zeros_like(v), np.zeros_like(v)
    states, cpu, newton = [(u, v)], 0.0, 0
    for _ in range(num_steps):
        before = time.process_time()
        for name, value in (("u0", u), ("v0", v), ("a0", a)):
            model.set_variable(name, value)
        model.set_variable("u", u + H * v)
        iterations = model.solve("max_res", TOLERANCE, "max_iter", 50, "lsearch", "simplest")[0]
        new = model.variable("u")
        rate = 4 / H**2 * (new - u - H * v) - a
        v, a, u = v + H / 2 * (a + rate), rate, new
        newton += int(iterations)
        cpu += time.process_time() - before
        states.append((u, v))
    displacement, velocity = (
        np.array(some).reshape(num_steps + 1, -1, 3)[:, place] for some in zip(*states, strict=True)
    )
    return Run(scene.X + displacement, velocity, cpu, newton)
