"""The ball on the plate in GetFEM, where it is installed (``python3-getfem``).

Contact by ray tracing with multipliers (augmented Lagrangian, large
sliding), St. Venant-Kirchhoff material, trapezoidal rule, GetFEM's own
Newton method and direct solver. Run as ``python3 -m benchmarks.peer STEPS``;
prints the row of ``steps.csv`` as JSON. Knows nothing of DOLFINx: its PETSc
and GetFEM want different libraries of the same solver.
"""

import json
import resource
import sys
import time
from pathlib import Path
from typing import Any

import getfem as gf
import gmsh
import numpy as np

MESH = Path(__file__).parents[1] / "meshes" / "ball_plate.msh"
E, NU, RHO, H = 1e5, 0.4, 1e3, 0.01
# Of the augmentation, per area; a few times a cell, as GetFEM advises.
AUGMENTATION, RELEASE = E, 0.3
# Relative to the force of inertia, with which GetFEM compares the equation of
# contact too: at 1e-8 it sees no contact.
TOLERANCE = 1e-14
BALL, OUTER, TOP = 1, 2, 3  # regions


def read_mesh() -> Any:
    """Mesh of hexahedra with the regions of the contact."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(MESH))
    tags, x, _ = gmsh.model.mesh.getNodes()
    place = np.empty(int(tags.max()) + 1, dtype=int)
    place[tags] = np.arange(len(tags))
    x = x.reshape(-1, 3)
    groups = gmsh.model.getPhysicalGroups()
    names = {gmsh.model.getPhysicalName(*group): group for group in groups}

    def elements(name: str, size: int) -> Any:
        dim, group = names[name]
        nodes = [
            gmsh.model.mesh.getElements(dim, entity)[2][0]
            for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, group)
        ]
        return place[np.concatenate(nodes)].reshape(-1, size)

    mesh = gf.Mesh("empty", 3)
    transformation = gf.GeoTrans("GT_QK(3,1)")
    for name in ("ball", "plate"):
        # From gmsh's order of the vertices to that of a tensor product.
        for cell in elements(name, 8)[:, [0, 1, 3, 2, 4, 5, 7, 6]]:
            convex = mesh.add_convex(transformation, x[cell].T)
            if name == "ball":
                mesh.extend_region(BALL, np.array([[int(np.ravel(convex)[0])], [-1]]))
    boundary = mesh.outer_faces()
    for region, name in ((OUTER, "ball_outer"), (TOP, "plate_top")):
        points = mesh.pid_from_coords(x[np.unique(elements(name, 4))].T)
        faces = [
            face for face in boundary.T if np.isin(mesh.pid_in_faces(face[:, None]), points).all()
        ]
        mesh.set_region(region, np.array(faces).T)
    gmsh.finalize()
    return mesh


def build(mesh: Any) -> tuple[Any, Any, Any]:
    """Model of one step, method of integration, finite elements."""
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
    return model, volume, elements


def run(steps: int) -> dict[str, Any]:
    """Row of ``steps.csv``."""
    gf.util_trace_level(1)
    mesh = read_mesh()
    model, volume, elements = build(mesh)
    inside = elements.basic_dof_on_region(BALL)
    v = np.zeros(elements.nbdof())
    for dof in np.asarray(inside, dtype=int):
        v[dof] = (0.0, 1.0, -1.0)[dof % 3]
    u, a = np.zeros_like(v), np.zeros_like(v)

    def energy() -> float:
        model.set_variable("v0", v)
        strain = "(Id(3)+Grad_u)'*(Id(3)+Grad_u)/2-Id(3)/2"
        psi = f"moduli(1)/2*sqr(Trace({strain}))+moduli(2)*Norm_sqr({strain})"
        return float(gf.asm_generic(volume, 0, f"{psi}+rho/2*Norm_sqr(v0)", -1, model))

    start, cpu, wall, newton, drift = energy(), 0.0, 0.0, 0, 0.0
    for _ in range(steps):
        before = time.process_time(), time.perf_counter()
        for name, value in (("u0", u), ("v0", v), ("a0", a)):
            model.set_variable(name, value)
        model.set_variable("u", u + H * v)
        iterations = model.solve("max_res", TOLERANCE, "max_iter", 50, "lsearch", "simplest")[0]
        new = model.variable("u")
        rate = 4 / H**2 * (new - u - H * v) - a
        v, a, u = v + H / 2 * (a + rate), rate, new
        newton += int(iterations)
        cpu += time.process_time() - before[0]
        wall += time.perf_counter() - before[1]
        drift = max(drift, abs(energy() / start - 1))
    return {
        "scene": "first 20 steps",
        "scheme": "GetFEM",
        "element": "full",
        "n": 6,
        "dofs": elements.nbdof(),
        "ranks": 1,
        "h": H,
        "steps": steps,
        "cpu_seconds": cpu,
        "wall_seconds": wall,
        "cpu_seconds_per_step": cpu / steps,
        "wall_seconds_per_step": wall / steps,
        "newton_iterations": newton,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "energy_drift": drift,
    }


if __name__ == "__main__":
    print("ROW", json.dumps(run(int(sys.argv[1]))))
