"""Cost of a step: one process (or one mpirun) measures one case.

Run as ``python3 -m benchmarks.steps '{"scene": ..., ...}'``, which prints the
row of ``steps.csv`` as JSON. The driver starts one for each case, so that
the peak of memory is that of the case.
"""

import json
import resource
import sys
import time
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx_nts as nts
from benchmarks.profile import CONTACT, Profile
from benchmarks.scenes import Scene, ball_on_plate

__all__ = ["Case", "measure"]


@dataclass(frozen=True)
class Case:
    """Ball on plate, and the steps that are measured.

    Attributes:
        scene: Name of the row.
        scheme: Key of `scenes.SCHEMES`.
        n: Cells along an edge of the ball.
        h: Step [s]; None: what central differences choose.
        t_start: Time from which on steps are measured [s].
        t_end: Time at the end [s].
        ranks: Number of ranks.
        E: Young's modulus [Pa].
        rho: Density [kg/m^3].
        friction: Coefficient of friction, 0 for none.
        eps_T: Tangential spring [N/m^3], 0 for exact stick.
        element: Key of `scenes.ELEMENTS`.
    """

    scene: str
    scheme: str = "EM elastic"
    n: int = 6
    h: float | None = 0.01
    t_start: float = 0.0
    t_end: float = 0.2
    ranks: int = 1
    E: float = 1e5
    rho: float = 1e3
    friction: float = 0.0
    eps_T: float = 0.0
    element: str = "full"

    def build(self, comm: MPI.Comm) -> Scene:
        """Mesh and stepper. Collective."""
        law = None
        if self.friction:
            spring = {"eps_T": self.eps_T} if self.eps_T else {}
            law = nts.Coulomb(self.friction, **spring)
        return ball_on_plate(
            comm,
            self.scheme,
            self.h,
            n=self.n,
            E=self.E,
            rho=self.rho,
            friction=law,
            element=self.element,
        )


class Counters:
    """What a stepper has counted so far.

    Args:
        stepper: Implicit or explicit.
    """

    def __init__(self, stepper: Any) -> None:
        """Remember where the parts are."""
        self.bulk = stepper._bulk
        self._solver = getattr(stepper, "_solver", None)  # explicit steps have none

    def now(self) -> dict[str, int]:
        """Residuals, actions, tangents, Krylov iterations, whole factorisations."""
        if self._solver is None:
            counts = (self.bulk.internal.num_assemblies, 0, 0, 0, 0)
        else:
            bulk, solver = self.bulk, self._solver
            counts = (
                bulk.num_residuals,
                bulk.num_actions,
                bulk.num_tangents,
                solver.num_iterations,
                solver.num_direct,
            )
        names = ("residuals", "actions", "tangents", "krylov_iterations", "direct")
        return dict(zip(names, counts, strict=True))

    def residual_seconds(self, stepper: Any) -> float:
        """CPU time of one evaluation of the forces of the bulk."""
        evaluate = self.bulk.internal.assemble if self._solver is None else self.bulk.residual
        u = stepper.u.x.array
        accepted, seconds = u.copy(), []
        for _ in range(203 if u.size < 50_000 else 23):
            # Of a state that has not changed, less would be done.
            u *= 1 + 1e-15
            start = time.process_time()
            evaluate()
            seconds.append(time.process_time() - start)
        u[:] = accepted
        return float(np.mean(seconds[3:]))


def measure(case: Case, comm: MPI.Comm) -> dict[str, Any]:
    """Row of ``steps.csv``. Collective."""
    profile = Profile()
    scene = case.build(comm)
    stepper, diagnostics = scene.stepper, nts.Diagnostics(scene.stepper)
    stepper.timings = profile
    counters = Counters(stepper)
    energy = diagnostics.balance().total_energy
    drift, cpu, wall, newton = 0.0, 0.0, 0.0, 0
    skip = round(case.t_start / stepper.dt)
    steps = round(case.t_end / stepper.dt) - skip
    before = counters.now()
    seldom = max(1, steps // 20)  # energies cost a step of central differences, and its cache
    for step in range(skip + steps):
        if step == skip:
            profile.seconds.clear()
            before = counters.now()
            cpu = wall = 0.0
            newton = 0
        comm.barrier()
        start = time.process_time(), time.perf_counter()
        report = stepper.advance()
        cpu += time.process_time() - start[0]
        wall += time.perf_counter() - start[1]
        newton += report.newton_iterations
        if (step + 1) % seldom == 0:
            drift = max(drift, abs(diagnostics.balance().total_energy / energy - 1))
    counts = {name: value - before[name] for name, value in counters.now().items()}
    seconds = {name: comm.allreduce(value) / comm.size for name, value in profile.seconds.items()}
    mean = comm.allreduce(wall) / comm.size
    residual = comm.allreduce(counters.residual_seconds(stepper), op=MPI.MAX)
    cpu, wall = comm.allreduce(cpu, op=MPI.MAX), comm.allreduce(wall, op=MPI.MAX)
    velocity = diagnostics.body_velocity(scene.body)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    seconds["the rest"] = mean - sum(seconds.values())
    return {
        "scene": case.scene,
        "scheme": case.scheme,
        "element": case.element,
        "n": case.n,
        "dofs": 3 * stepper.u.function_space.dofmap.index_map.size_global,
        "ranks": comm.size,
        "h": stepper.dt,
        "steps": steps,
        "cpu_seconds": cpu,
        "wall_seconds": wall,
        "cpu_seconds_per_step": cpu / steps,
        "wall_seconds_per_step": wall / steps,
        "residual_seconds": residual,
        "residuals_per_step": cpu / steps / residual,
        "contact_share": sum(seconds.get(name, 0.0) for name in CONTACT) / mean,
        "newton_iterations": newton,
        **counts,
        "peak_mb": comm.allreduce(peak, op=MPI.MAX),
        "active": report.num_active,
        "energy_drift": drift,
        "v_y": velocity[1],
        "v_z": velocity[2],
        "strain_energy": diagnostics.strain_energy(),
        **{f"share: {name}": value / mean for name, value in sorted(seconds.items())},
    }


if __name__ == "__main__":
    row = measure(Case(**json.loads(sys.argv[1])), MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        print("ROW", json.dumps(row))
