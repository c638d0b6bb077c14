"""Cost of an impact in two dimensions, and as one layer of hexahedra in plane strain.

    python3 -m benchmarks.plane [CELLS...]

Prints a table with a row for each number of cells along an edge; 25, 50 and 100 take a minute.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import meshing

__all__ = ["Cost", "main", "measure"]

_FREE, _STEPS = 8, 12  # steps before and while the cost is taken


@dataclass(frozen=True)
class Cost:
    """Cost of steps in contact.

    Attributes:
        unknowns: Unknown displacements.
        iterations: Krylov iterations of a step.
        seconds: CPU time of a step [s].
        speed: Velocity of the upper block at the end, per metre of thickness the same [m/s].
    """

    unknowns: int
    iterations: float
    seconds: float
    speed: float


def scene(n: int, dim: int) -> tuple[nts.Body, nts.EnergyMomentum]:
    """Make a block of n x n cells that strikes a wider one of n x n / 4 cells, both free.

    Args:
        n: Cells along an edge of the upper block, 1 m.
        dim: 2, or 3 for one layer of cells that cannot move along z.
    """
    add = meshing.add_rectangle if dim == 2 else meshing.add_box

    def build(model: Any) -> None:
        for name, corner, size, cells in (
            ("low", (-1.0, -0.5), (2.0, 0.5), (n, n // 4)),
            ("up", (-0.45, 0.02), (1.0, 1.0), (n, n)),
        ):
            layer = {"corner": corner, "size": size, "cells": cells}
            if dim == 3:
                layer = {"corner": (*corner, 0), "size": (*size, 1 / n), "cells": (*cells, 1)}
            add(model, name, **layer)

    mesh, tags, facets, tag = nts.read_mesh(build, MPI.COMM_SELF)
    V = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
    rubber = nts.SaintVenantKirchhoff(E=1e5, nu=0.3, rho=1e3)
    low, up = (nts.Body(V, tags, tag[name], rubber) for name in ("low", "up"))
    sides = ("up_bottom", "low_top") if dim == 2 else ("up_front", "low_back")
    pair = nts.ContactPair(
        *(nts.Surface(V, facets, tag[side]) for side in sides),
        enforcement=nts.LagrangeMultiplier(),
        method="node-to-segment",
    )
    bcs = []
    if dim == 3:
        z, _ = V.sub(2).collapse()
        everywhere = fem.locate_dofs_geometrical((V.sub(2), z), lambda x: x[2] > -1)
        bcs = [fem.dirichletbc(fem.Function(z), everywhere, V.sub(2))]
    stepper = nts.EnergyMomentum([low, up], [pair], dt=0.2 / n, bcs=bcs)
    stepper.set_velocity(
        up, lambda x: np.array([0.8 - 0.6 * x[1], -1.2 + 0.6 * x[0], 0 * x[0]][:dim])
    )
    return up, stepper


def measure(n: int, steps: int = _STEPS) -> tuple[Cost, Cost]:
    """Measure both models with alternating steps, so that both see the same machine load.

    Args:
        n: Cells along an edge.
        steps: Steps that are measured.

    Returns:
        Cost in two dimensions, and of the layer.
    """
    scenes = [scene(n, dim) for dim in (2, 3)]
    seconds = [0.0, 0.0]
    for _ in range(_FREE):
        for _, stepper in scenes:
            stepper.advance()
    before = [stepper._solver.num_iterations for _, stepper in scenes]
    for _ in range(steps):
        for number, (_, stepper) in enumerate(scenes):
            start = time.process_time()
            stepper.advance()
            seconds[number] += time.process_time() - start
    costs = [
        Cost(
            stepper.u.x.array.size,
            (stepper._solver.num_iterations - first) / steps,
            spent / steps,
            nts.Diagnostics(stepper).body_velocity(body)[1],
        )
        for (body, stepper), first, spent in zip(scenes, before, seconds, strict=True)
    ]
    return costs[0], costs[1]


def main(sizes: Sequence[int]) -> None:
    """Print the table."""
    print("| cells | unknowns | Krylov iterations | CPU time of a step [ms] | ratio |")
    print("|---" * 5 + "|")
    for n in sizes:
        plane, layer = measure(n)
        print(
            f"| {n * n + n * (n // 4)} | {plane.unknowns}, {layer.unknowns} "
            f"| {plane.iterations:.1f}, {layer.iterations:.1f} "
            f"| {1e3 * plane.seconds:.1f}, {1e3 * layer.seconds:.1f} "
            f"| {layer.seconds / plane.seconds:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main([int(n) for n in sys.argv[1:]] or [25, 50, 100])
