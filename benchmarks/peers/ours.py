"""The scene by dolfinx_nts."""

import time
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem
from scipy.spatial import KDTree

import dolfinx_nts as nts
from benchmarks.peers.scene import MESH, NU, RHO, T_END, VELOCITY, E, H, Run, Scene

__all__ = ["run_explicit", "run_full", "run_implicit", "version"]


def version() -> str:
    """Version of the package."""
    return nts.__version__


def run_implicit(scene: Scene) -> Run:
    """Run the scene by the energy-momentum scheme."""
    return _run(scene, nts.EnergyMomentum, nts.LagrangeMultiplier(), H)


def run_full(scene: Scene) -> Run:
    """Run the scene with all points for all terms of the energy, as the other codes do."""
    return _run(scene, nts.EnergyMomentum, nts.LagrangeMultiplier(), H, one_point=())


def run_explicit(scene: Scene) -> Run:
    """Run the scene by central differences, with the step that they choose."""
    return _run(scene, nts.CentralDifference, nts.Penalty(), None)


def _run(
    scene: Scene, integrator: type, enforcement: object, dt: float | None, **options: Any
) -> Run:
    mesh, cells, facets, tag = nts.read_mesh(MESH, MPI.COMM_SELF)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    rubber = nts.SaintVenantKirchhoff(E, NU, RHO, **options)
    ball, plate = (nts.Body(V, cells, tag[name], rubber) for name in ("ball", "plate"))
    contact = nts.ContactPair(
        nodes=nts.Surface(V, facets, tag["ball_outer"]),
        segments=nts.Surface(V, facets, tag["plate_top"]),
        enforcement=enforcement,
        method="node-to-segment",
    )
    stepper = integrator([ball, plate], [contact], dt=dt)
    stepper.set_velocity(ball, VELOCITY)
    place = KDTree(V.tabulate_dof_coordinates()).query(scene.X)[1]

    def state() -> tuple[np.ndarray, np.ndarray]:
        return stepper.x[place], stepper.v.x.array.reshape(-1, 3)[place]

    states, cpu, newton = [state()], 0.0, 0.0
    steps = stepper.run(until=T_END)
    while True:
        before = time.process_time()
        step = next(steps, None)
        cpu += time.process_time() - before
        if step is None:
            break
        newton += getattr(step, "newton_iterations", np.nan)
        states.append(state())
    x, v = (np.array(some) for some in zip(*states, strict=True))
    is_explicit = integrator is nts.CentralDifference
    return Run(x, v, cpu, newton, has_lumped_mass=is_explicit, has_one_point=not options)
