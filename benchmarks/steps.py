"""Cost of a step: one process (or one mpirun) measures a case, or compares several.

Run as ``python3 -m benchmarks.steps '[{"scene": ..., ...}]'``, which prints
the rows of ``steps.csv`` as JSON. Several cases take their steps in turn, so
that a machine which changes its speed does so for all; the peak of memory is
that of the process.
"""

import json
import resource
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx_nts as nts
from benchmarks.profile import CONTACT, Profile
from benchmarks.scenes import Scene, ball_on_plate, pile, sliding_block
from dolfinx_nts.fem.linear_forms import PackedForm

__all__ = ["Case", "measure"]


# Number of blocks into which the steps of a run are divided. Between blocks energies and steps of
# other runs are computed, which leave a cold cache.
_STRETCHES = 5


@dataclass(frozen=True)
class Case:
    """A model, and its steps that are measured.

    Attributes:
        scene: Name of the row.
        model: "ball on plate", or "sliding block" or "pile", which know no data of the former but
            n, h and friction.
        scheme: Key of `scenes.SCHEMES`.
        n: Cells along an edge of the ball.
        h: Step [s]; None: what central differences choose.
        t_start: Time from which on steps are measured [s].
        t_end: Time at the end [s].
        E: Young's modulus [Pa].
        rho: Density [kg/m^3].
        nu: Poisson's ratio.
        wall: Thickness of the ball [m].
        law: Name of the material.
        friction: Coefficient of friction, 0 for none.
        eps_T: StickSlip spring [N/m^3], 0 for exact stick.
        element: Key of `scenes.ELEMENTS`.
    """

    scene: str
    model: str = "ball on plate"
    scheme: str = "EM elastic"
    n: int = 6
    h: float | None = 0.01
    t_start: float = 0.0
    t_end: float = 0.2
    E: float = 1e5
    rho: float = 1e3
    nu: float = 0.4
    wall: float = 0.2
    law: str = "SaintVenantKirchhoff"
    friction: float = 0.0
    eps_T: float = 0.0
    element: str = "full"

    def build(self, comm: MPI.Comm) -> Scene:
        """Mesh and stepper. Collective."""
        law = None
        if self.friction:
            spring = {"eps_T": self.eps_T} if self.eps_T else {}
            law = nts.Coulomb(self.friction, **spring)
        if self.model == "sliding block":
            return sliding_block(comm, self.scheme, self.h or 1.0, n=self.n, friction=law)
        if self.model == "pile":
            return pile(comm, self.scheme, self.h, n=self.n, friction=law)
        return ball_on_plate(
            comm,
            self.scheme,
            self.h,
            n=self.n,
            E=self.E,
            rho=self.rho,
            nu=self.nu,
            wall=self.wall,
            law=self.law,
            friction=law,
            element=self.element,
        )


class Run:
    """A case whose steps are measured. Collective, as its methods.

    Args:
        case: The case.
        comm: Communicator.
        profile: Takes the time of its phases; one for all runs of a process.
    """

    def __init__(self, case: Case, comm: MPI.Comm, profile: Profile) -> None:
        """Build the scene and advance to the first measured step."""
        self._case, self._comm, self._profile = case, comm, profile
        self._scene = case.build(comm)
        self._stepper = stepper = self._scene.stepper
        stepper.timings = profile
        self._diagnostics = nts.Diagnostics(stepper)
        self._energy = self._diagnostics.balance().total_energy
        skipped = round(case.t_start / stepper.dt)
        self._steps = round(case.t_end / stepper.dt) - skipped
        self._bulk = stepper._bulk
        self._solver = getattr(stepper, "_solver", None)  # explicit steps have none
        self._stretch = max(1, -(-self._steps // _STRETCHES))
        self._seconds: dict[str, float] = {}
        self._counts: Counter[str] = Counter()
        self._cpu = self._wall = self._drift = 0.0
        self._done = self._newton = self._active = 0
        self._residuals: list[float] = []
        self._ffcx_residuals: list[float] = []
        # Forces of the bulk as DOLFINx assembles them, by the kernels of FFCx.
        self._ffcx = PackedForm(self._bulk._residual._bodies.form) if self._solver else None
        self._forces = np.zeros_like(stepper.u.x.array)
        if self._solver:
            # Compilation on demand is not part of a step.
            zero = np.zeros((len(stepper.node_ids), stepper.u.x.block_size))
            self._bulk.rounding(zero)
            self._bulk.action(zero)
        for _ in range(skipped):
            stepper.advance()

    @property
    def is_over(self) -> bool:
        """Whether all steps have been measured."""
        return self._done == self._steps

    def advance(self) -> None:
        """Measure some steps."""
        steps = min(self._stretch, self._steps - self._done)
        self._done += steps
        self._profile.seconds = self._seconds
        before = self._work()
        self._comm.barrier()
        start = time.process_time(), time.perf_counter()
        for _ in range(steps):
            report = self._stepper.advance()
            self._newton += report.newton_iterations
            self._active = report.num_active
        self._cpu += time.process_time() - start[0]
        self._wall += time.perf_counter() - start[1]
        self._counts += self._work() - before
        self._profile.seconds = {}
        energy = self._diagnostics.balance().total_energy
        # At rest there is no energy at the start, and supports do work.
        drift = abs(energy / self._energy - 1) if self._energy else np.nan
        self._drift = float(np.maximum(self._drift, drift))
        evaluate = self._bulk.forces if self._solver else self._bulk.internal.assemble
        self._residuals += self._seconds_of(evaluate)
        if self._ffcx is not None:
            self._ffcx_residuals += self._seconds_of(partial(self._ffcx.assemble, self._forces))

    def _work(self) -> "Counter[str]":
        """Residuals, actions, tangents, Krylov iterations, whole factorisations."""
        bulk, solver = self._bulk, self._solver
        if solver is None:
            return Counter(residuals=bulk.internal.num_assemblies)
        residuals, actions = bulk.num_assembled
        return Counter(
            residuals=residuals,
            actions=actions,
            tangents=solver.tangent.num_assembled,
            krylov_iterations=solver.num_iterations,
            direct=solver.num_direct,
        )

    def _seconds_of(self, evaluate: Callable[[], Any]) -> list[float]:
        """CPU times of evaluations of the forces of the bulk."""
        u = self._stepper.u.x.array
        accepted, seconds, warm = u.copy(), [], 1 if u.size > 50_000 else 3
        for _ in range(2 * warm if self._solver else 10 * warm):
            # For an unchanged state less work would be done.
            u *= 1 + 1e-15
            start = time.process_time()
            evaluate()
            seconds.append(time.process_time() - start)
        u[:] = accepted
        return seconds[warm:]

    def row(self) -> dict[str, Any]:
        """Row of ``steps.csv``."""
        case, comm, steps, stepper = self._case, self._comm, self._steps, self._stepper
        shares = {name: comm.allreduce(value) / comm.size for name, value in self._seconds.items()}
        mean = comm.allreduce(self._wall) / comm.size
        shares["remainder"] = mean - sum(shares.values())
        residual, ffcx = (
            comm.allreduce(float(np.mean(seconds or np.nan)), op=MPI.MAX)
            for seconds in (self._residuals, self._ffcx_residuals)
        )
        cpu, wall = (comm.allreduce(value, op=MPI.MAX) for value in (self._cpu, self._wall))
        velocity = self._diagnostics.body_velocity(self._scene.body)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        counts = ("residuals", "actions", "tangents", "krylov_iterations", "direct")
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
            "ffcx_residuals_per_step": cpu / steps / ffcx,
            "contact_share": sum(shares.get(name, 0.0) for name in CONTACT) / mean,
            "newton_iterations": self._newton,
            **{name: self._counts[name] for name in counts},
            "peak_mb": comm.allreduce(peak, op=MPI.MAX),
            "active": self._active,
            "energy_drift": self._drift,
            "v_y": velocity[1],
            "v_z": velocity[2],
            "strain_energy": self._diagnostics.strain_energy(),
            **{f"share: {name}": value / mean for name, value in sorted(shares.items())},
        }


def measure(cases: Sequence[Case], comm: MPI.Comm) -> list[dict[str, Any]]:
    """Rows of ``steps.csv``; steps are taken in turn. Collective."""
    profile = Profile()
    runs = [Run(case, comm, profile) for case in cases]
    left = runs
    while left:
        for run in left:
            run.advance()
        left = [run for run in left if not run.is_over]
    return [run.row() for run in runs]


if __name__ == "__main__":
    rows = measure([Case(**case) for case in json.loads(sys.argv[1])], MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        print("ROW", json.dumps(rows))
