"""Error of runs: one process computes a series of steps of one discretisation.

Run as ``python3 -m benchmarks.errors '{"problem": ..., ...}'``, which prints the
values and costs as JSON; `references` turns them into rows of ``errors.csv``.
"""

import json
import sys
import time
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx_nts as nts
from benchmarks.problems import PROBLEMS
from benchmarks.scenes import Scene

__all__ = ["Series", "run"]

_LOOKS = 50  # at the energy, which costs more than a step of central differences


@dataclass(frozen=True)
class Series:
    """The same problem with several steps.

    Attributes:
        problem: Key of `PROBLEMS`.
        scheme: Key of `scenes.SCHEMES`.
        n: Cells, see the problem.
        h: Steps [s]; of central differences parts of what they choose.
        t_end: Time at the end [s]; 0 for that of the problem.
        h_reference: Step of the run that the displacements are compared
            with, of the same scheme [s]; 0 for none.
        element: Key of `scenes.ELEMENTS`.
    """

    problem: str
    scheme: str
    n: int
    h: tuple[float, ...]
    t_end: float = 0.0
    h_reference: float = 0.0
    element: str = "default"

    def build(self, comm: MPI.Comm, h: float) -> Scene:
        """Scene with a step. Collective."""
        explicit = self.scheme == "central differences"
        build = PROBLEMS[self.problem].build
        scene = build(comm, self.scheme, None if explicit else h, n=self.n, element=self.element)
        if explicit:
            scene.stepper.dt *= h
        return scene


def run(series: Series, comm: MPI.Comm) -> list[dict[str, Any]]:
    """Values at the end and cost of each run. Collective."""
    rows: list[dict[str, Any]] = []
    problem, reference = PROBLEMS[series.problem], None
    for h in (*([series.h_reference] if series.h_reference else []), *series.h):
        scene = series.build(comm, h)
        stepper, diagnostics = scene.stepper, nts.Diagnostics(scene.stepper)
        h, t_end = stepper.dt, series.t_end or scene.t_end
        before, drift, cpu = diagnostics.balance(), 0.0, 0.0
        steps = stepper.run(until=t_end)
        seldom = max(1, int(t_end / h) // _LOOKS)
        while True:
            start = time.process_time()
            if next(steps, None) is None:
                break
            cpu += time.process_time() - start
            scene.record()
            if problem.conserves and (stepper.step % seldom == 0 or stepper.t >= t_end):
                change = diagnostics.balance().total_energy / before.total_energy - 1
                drift = change if abs(change) > abs(drift) else drift
        values = scene.judge() | ({"energy drift": drift} if problem.conserves else {})
        u = stepper.u.x.array[: 3 * stepper.u.function_space.dofmap.index_map.size_local]
        is_reference = bool(series.h_reference) and reference is None
        if is_reference:
            reference = u.copy()
        elif reference is not None:
            square = comm.allreduce(np.array([np.sum((u - reference) ** 2), float(u.size)]))
            values["displacement"] = float(np.sqrt(3 * square[0] / square[1]))
        rows.append(
            {
                "problem": series.problem,
                "scheme": series.scheme,
                "element": series.element,
                "n": series.n,
                "h": h,
                "is_reference": is_reference,
                "dofs": 3 * stepper.u.function_space.dofmap.index_map.size_global,
                "cpu_seconds": cpu,
                "active": diagnostics.active_nodes(),
                "values": values,
                "exact": {**problem.exact, "energy drift": 0.0, "displacement": 0.0},
            }
        )
    return rows


if __name__ == "__main__":
    result = run(Series(**json.loads(sys.argv[1])), MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        print("ROW", json.dumps(result))
