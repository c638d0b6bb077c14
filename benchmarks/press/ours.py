"""The scene by dolfinx_nts."""

import time
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem
from scipy.spatial import KDTree

import dolfinx_nts as nts
from benchmarks.peers.ours import version
from benchmarks.peers.scene import NU, RHO, E, Floats
from benchmarks.press.scene import MU, NUM_STEPS, Scene, facets
from dolfinx_nts.meshing.structured_blocks import add_body

__all__ = ["run", "version"]


def run(scene: Scene, method: str, swapped: bool) -> tuple[Floats, float, int]:
    """Run the scene, with all points for all terms of the energy, as the other codes do."""

    def build(model: Any) -> None:
        for name, cells, sides in (
            ("upper", scene.upper, {"contact": scene.outer, "end": scene.moved}),
            ("lower", scene.lower, {"contact": scene.top, "end": scene.held}),
        ):
            first = cells.min()
            surfaces = {side: facets(nodes) - first for side, nodes in sides.items()}
            X = scene.X[first : cells.max() + 1]
            add_body(model, name, X, cells - first, surfaces, "hexahedron")

    mesh, cells, tags, tag = nts.read_mesh(build, MPI.COMM_SELF)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(E, NU, RHO, one_point=())
    bodies = [nts.Body(V, cells, tag[name], rubber) for name in ("upper", "lower")]
    sides = [nts.Surface(V, tags, tag[f"{name}_contact"]) for name in ("upper", "lower")]
    pair = nts.ContactPair(
        *sides[:: -1 if swapped else 1],
        friction=nts.Coulomb(MU),
        method=method,
        enforcement=nts.LagrangeMultiplier(),
    )
    moved, across = fem.Constant(mesh, np.zeros(3)), V.sub(1).collapse()[0]
    everywhere = fem.locate_dofs_geometrical((V.sub(1), across), lambda x: x[1] > -1.0)
    bcs = [fem.dirichletbc(fem.Function(across), everywhere, V.sub(1))]
    for name, value in (("upper_end", moved), ("lower_end", np.zeros(3))):
        dofs = fem.locate_dofs_topological(V, 2, tags.find(tag[name]))
        bcs.append(fem.dirichletbc(value, dofs, V))

    def update(t: float) -> None:
        moved.value = scene.travel(round(t))

    stepper = nts.QuasiStatic(bodies, [pair], dt=1.0, bcs=bcs, update=update)
    place = KDTree(V.tabulate_dof_coordinates()).query(scene.X)[1]
    x, newton, start = [scene.X], 0, time.process_time()
    for step in stepper.run(until=NUM_STEPS):
        x.append(stepper.x[place])
        newton += step.newton_iterations
    return np.array(x), time.process_time() - start, newton
