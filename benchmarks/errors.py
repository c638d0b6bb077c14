"""Error of runs: one process computes a series of steps of one discretisation.

Run as ``python3 -m benchmarks.errors '{"scene": ..., ...}'``, which prints the
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
from benchmarks.scenes import BAR_SPEED, Scene, ball_on_plate, bar_on_wall, pressed_block

__all__ = ["Series", "run"]

_LOOKS = 50  # at the energy, which costs more than a step of central differences


@dataclass(frozen=True)
class Series:
    """The same scene with several steps.

    Attributes:
        scene: ``"ball"``, ``"stiff ball"``, ``"bar"`` or ``"block"``.
        scheme: Key of `scenes.SCHEMES`.
        n: Cells along an edge of the ball, or along the bar.
        t_end: Time at the end [s].
        h: Steps [s]; of central differences parts of what they choose.
        h_reference: Step of the run that the displacements are compared
            with, of the same scheme [s]; 0 for none.
        element: Key of `scenes.ELEMENTS`.
    """

    scene: str
    scheme: str
    n: int
    t_end: float
    h: tuple[float, ...]
    h_reference: float = 0.0
    element: str = "full"

    def build(self, comm: MPI.Comm, h: float) -> Scene:
        """Scene with a step. Collective."""
        explicit = self.scheme == "central differences"
        given = None if explicit else h
        if self.scene == "bar":
            scene = bar_on_wall(comm, self.scheme, given, cells=self.n, element=self.element)
        elif self.scene == "block":
            scene = pressed_block(comm, self.scheme, h)
        else:
            E = {"ball": 1e5, "stiff ball": 1e7}[self.scene]
            scene = ball_on_plate(comm, self.scheme, given, n=self.n, E=E, element=self.element)
        if explicit:
            scene.stepper.dt *= h
        return scene


def run(series: Series, comm: MPI.Comm) -> list[dict[str, Any]]:
    """Values at the end and cost of each run. Collective."""
    rows: list[dict[str, Any]] = []
    reference = None
    for h in (*([series.h_reference] if series.h_reference else []), *series.h):
        scene = series.build(comm, h)
        stepper, diagnostics = scene.stepper, nts.Diagnostics(scene.stepper)
        h = stepper.dt
        before, drift, cpu = diagnostics.balance(), 0.0, 0.0
        steps = stepper.run(until=series.t_end)
        seldom = max(1, int(series.t_end / h) // _LOOKS)
        while True:
            start = time.process_time()
            if next(steps, None) is None:
                break
            cpu += time.process_time() - start
            if stepper.step % seldom and stepper.t < series.t_end:
                continue
            change = diagnostics.balance().total_energy / before.total_energy - 1
            drift = change if abs(change) > abs(drift) else drift
        velocity = diagnostics.body_velocity(scene.body)
        u = scene.stepper.u.x.array[: 3 * stepper.u.function_space.dofmap.index_map.size_local]
        values = {} if series.scene == "block" else {"energy drift": drift}
        if series.scene == "bar":
            values["rebound"] = velocity[2] / BAR_SPEED
        elif series.scene != "block":
            values |= {"v_y": velocity[1], "v_z": velocity[2]}
        is_reference = bool(series.h_reference) and reference is None
        if is_reference:
            reference = u.copy()
        elif reference is not None:
            square = comm.allreduce(np.array([np.sum((u - reference) ** 2), float(u.size)]))
            values["displacement"] = float(np.sqrt(3 * square[0] / square[1]))
        rows.append(
            {
                "scene": series.scene,
                "scheme": series.scheme,
                "element": series.element,
                "n": series.n,
                "h": h,
                "is_reference": is_reference,
                "dofs": 3 * stepper.u.function_space.dofmap.index_map.size_global,
                "cpu_seconds": cpu,
                "active": diagnostics.active_nodes(),
                "values": values,
            }
        )
    return rows


if __name__ == "__main__":
    result = run(Series(**json.loads(sys.argv[1])), MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        print("ROW", json.dumps(result))
