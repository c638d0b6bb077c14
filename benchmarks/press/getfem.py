"""The section of the scene in GetFEM, see `benchmarks.peers.getfem`."""

import time
from typing import Any

import getfem as gf
import numpy as np

from benchmarks.peers.getfem import version
from benchmarks.peers.scene import NU, E, Floats
from benchmarks.press.scene import MU, NUM_STEPS, Scene

__all__ = ["run", "version"]

# Augmentation parameter per area, and largest distance at contact [m].
_AUGMENTATION, _RELEASE = 50 * E, 0.05
_TOLERANCE = 1e-12
_OUTER, _TOP, _HELD, _MOVED = 1, 2, 3, 4  # regions


def _mesh(scene: Scene) -> tuple[Any, Floats]:
    """Mesh with the regions, and the nodes in the plane, shape ``(n, 2)`` [m]."""
    mesh, transformation = gf.Mesh("empty", 2), gf.GeoTrans("GT_QK(2,1)")
    section = scene.X[:, [0, 2]]
    for cell in scene.cells[:, [0, 1, 4, 5]]:
        mesh.add_convex(transformation, section[cell].T)
    sides = ((_OUTER, scene.outer), (_TOP, scene.top), (_HELD, scene.held), (_MOVED, scene.moved))
    for region, nodes in sides:
        points = mesh.pid_from_coords(section[nodes[:, 0]].T)
        faces = [
            face
            for face in mesh.outer_faces().T
            if np.isin(mesh.pid_in_faces(face[:, None]), points).all()
        ]
        mesh.set_region(region, np.array(faces).T)
    return mesh, section


def _model(mesh: Any, swapped: bool) -> tuple[Any, Any, Any]:
    """Model of a step, its finite elements and integration methods; the model needs both alive."""
    elements = gf.MeshFem(mesh, 2)
    elements.set_fem(gf.Fem("FEM_QK(2,1)"))
    cells, sides = (gf.MeshIm(mesh, gf.Integ(f"IM_GAUSS_PARALLELEPIPED(2,{k})")) for k in (3, 5))
    model = gf.Model("real")
    model.add_fem_variable("u", elements)
    model.add_fem_data("u0", elements)
    lame = [E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))]
    data = {
        "moduli": lame,
        "r": _AUGMENTATION,
        "mu": MU,
        "one": 1.0,
        "no": [0, 0],
        "travel": [0, 0],
    }
    for name, value in data.items():
        model.add_initialized_data(name, value)
    model.add_finite_strain_elasticity_brick(cells, "SaintVenant Kirchhoff", "u", "moduli")
    model.add_Dirichlet_condition_with_simplification("u", _HELD, "no")
    model.add_Dirichlet_condition_with_simplification("u", _MOVED, "travel")
    slave, master = (_TOP, _OUTER) if swapped else (_OUTER, _TOP)
    contact = model.add_integral_large_sliding_contact_brick_raytracing(
        "r", _RELEASE, "mu", "one", 0
    )
    model.add_filtered_fem_variable("p", elements, slave)
    add = model.add_slave_contact_boundary_to_large_sliding_contact_brick
    add(contact, sides, slave, "u", "p", "u0")
    add = model.add_master_contact_boundary_to_large_sliding_contact_brick
    add(contact, cells, master, "u", "u0")
    return model, elements, (cells, sides)


def run(scene: Scene, method: str, swapped: bool) -> tuple[Floats, float, int]:
    """Run the scene."""
    gf.util_trace_level(1)
    mesh, section = _mesh(scene)
    model, elements, _methods = _model(mesh, swapped)
    dofs = elements.basic_dof_nodes()[:, ::2].T
    place = [int(np.abs(dofs - X).sum(axis=1).argmin()) for X in section]
    x, newton, start = [scene.X], 0, time.process_time()
    for step in range(1, NUM_STEPS + 1):
        model.set_variable("travel", scene.travel(step)[[0, 2]])
        model.set_variable("u0", model.variable("u"))
        newton += int(model.solve("max_res", _TOLERANCE, "max_iter", 60, "lsearch", "simplest")[0])
        now = scene.X.copy()
        now[:, [0, 2]] += model.variable("u").reshape(-1, 2)[place]
        x.append(now)
    return np.array(x), time.process_time() - start, newton
