"""Cost of the impact of a ball on a plate as a body of revolution, and in space.

    python3 -m benchmarks.rings [CELLS...]

Prints a table with a row for each number of cells along the radius of the ball; 8, 16 and 20 take
some minutes.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts

__all__ = ["Impact", "impact", "main"]

_RADIUS, _GAP, _HEIGHT, _WIDTH = 0.5, 0.01, 0.3, 0.8  # of ball, gap and plate [m]
_SPEED, _DT, _END = 2.0, 0.002, 0.3  # m/s, s, s


@dataclass(frozen=True)
class Impact:
    """Result of an impact, from approach to rebound.

    Attributes:
        unknowns: Unknown displacements.
        seconds: CPU time of a step in contact [s].
        mass: Mass of the ball [kg].
        greatest: Greatest contact force [N].
        rebound: Velocity of the ball afterwards over that before [-].
    """

    unknowns: int
    seconds: float
    mass: float
    greatest: float
    rebound: float


def _build(model: Any, size: float, dim: int) -> None:
    """Add ball and plate to a gmsh model, in space or as half sections."""
    occ = model.occ
    if dim == 3:
        ball = occ.addSphere(0, _GAP + _RADIUS, 0, _RADIUS)
        plate = occ.addCylinder(0, -_HEIGHT, 0, 0, _HEIGHT, 0, _WIDTH)
    else:
        disc = occ.addDisk(0, _GAP + _RADIUS, 0, _RADIUS, _RADIUS)
        right = occ.addRectangle(0, 0, 0, 1, 2)
        ((_, ball),), _ = occ.intersect([(2, disc)], [(2, right)])
        plate = occ.addRectangle(0, -_HEIGHT, 0, _WIDTH, _HEIGHT)
    occ.synchronize()
    for name, entity in (("ball", ball), ("plate", plate)):
        model.addPhysicalGroup(dim, [entity], name=name)
    model.mesh.setSize(model.getEntities(0), size)
    model.mesh.generate(dim)


def impact(
    n: int, dim: int, *, rigid: bool = False, law: Literal["plastic", "resolved"] = "plastic"
) -> Impact:
    """Let a ball with n cells along its radius strike a plate on a smooth floor.

    Args:
        n: Cells along the radius.
        dim: 2 for bodies of revolution, 3 for tetrahedra in space.
        rigid: Whether the ball does not deform, and the plate gives the nodes.
        law: Impact of the nodes, see `nts.LagrangeMultiplier`.
    """
    data = nts.read_mesh(lambda model: _build(model, _RADIUS / n, dim), MPI.COMM_SELF)
    if dim == 2:
        nts.axisymmetric(data.mesh)
    V = fem.functionspace(data.mesh, ("Lagrange", 1, (dim,)))
    rubber = nts.NeoHookean(E=1e5, nu=0.3, rho=1e3)
    ball, plate = (nts.Body(V, data.cells, data.tag[name], rubber) for name in ("ball", "plate"))
    if rigid:
        ball = nts.RigidBody(V, data.cells, data.tag["ball"], rubber.rho)
    lower = nts.boundary_of(ball, where=lambda x: x[1] < _RADIUS)
    top = nts.boundary_of(plate, where=lambda x: x[1] > -1e-9)
    surfaces = (top, lower) if rigid else (lower, top)
    dofs = fem.locate_dofs_geometrical(V, lambda x: x[1] < 1e-9 - _HEIGHT)
    clamp = fem.dirichletbc(np.zeros(dim), dofs, V)
    pair = nts.ContactPair(*surfaces, nts.LagrangeMultiplier(law), method="node-to-segment")
    stepper = nts.EnergyMomentum([ball, plate], [pair], dt=_DT, bcs=[clamp])
    down = np.zeros(dim)
    down[1] = -_SPEED
    stepper.set_velocity(ball, down)
    diagnostics, seconds, forces = nts.Diagnostics(stepper), [], [0.0]
    axis = 0 if dim == 2 else 1  # rings have the axial component alone
    while stepper.t < _END - _DT / 2:
        start = time.process_time()
        step = stepper.advance()
        if step.num_active:
            seconds.append(time.process_time() - start)
        forces.append(abs(float(diagnostics.contact_force()[axis])))
    velocity = float(diagnostics.body_velocity(ball)[axis])
    mass = diagnostics.bodies()["ball"].mass
    unknowns = stepper.u.x.array.size
    return Impact(unknowns, float(np.mean(seconds)), mass, max(forces), velocity / _SPEED)


def main(sizes: Sequence[int]) -> None:
    """Print the table."""
    heads = "cells in R", "unknowns", "greatest force [N]", "rebound", "CPU time of a step [ms]"
    print(f"| {' | '.join(heads)} | ratio |")
    print("|---" * 6 + "|")
    for n in sizes:
        rings, space = impact(n, 2), impact(n, 3)
        print(
            f"| {n} | {rings.unknowns}, {space.unknowns} "
            f"| {rings.greatest:.0f}, {space.greatest:.0f} "
            f"| {rings.rebound:.3f}, {space.rebound:.3f} "
            f"| {1e3 * rings.seconds:.2f}, {1e3 * space.seconds:.1f} "
            f"| {space.seconds / rings.seconds:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main([int(n) for n in sys.argv[1:]] or [8, 16, 20])
