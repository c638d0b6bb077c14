"""A belt on a quarter of a pulley, tensioned at one end and moved at the other."""

from typing import NamedTuple

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

MU, ANGLE, RADIUS, THICKNESS = 0.3, np.pi / 2, 1.0, 0.02  # -, rad, m, m
TAIL, PULL, TRAVEL = 0.3, 1e3, 0.02  # m, N/m, m per unit of time


class Belt(NamedTuple):
    """Statics of the belt, and its contact with the pulley."""

    stepper: nts.QuasiStatic
    pair: nts.ContactPair


def belt(dt: float, enforcement: nts.LagrangeMultiplier | nts.Penalty | None = None) -> Belt:
    """A belt whose tension grows until t = 1, and that is moved over the pulley from then on."""
    arc = RADIUS * ANGLE

    def build(model):
        size = (2 * TAIL + arc, THICKNESS)
        parts.add_rectangle(model, "belt", corner=(0, 0), size=size, cells=(40, 2))

    data = nts.read_mesh(build, MPI.COMM_WORLD)
    x = data.mesh.geometry.x
    along, r = x[:, 0].copy(), RADIUS + x[:, 1]
    angle = np.clip((along - TAIL) / RADIUS, 0, ANGLE)
    before, after = np.fmin(along - TAIL, 0), np.fmax(along - TAIL - arc, 0)
    x[:, 0], x[:, 1] = -r * np.cos(angle) + after, r * np.sin(angle) + before
    V = fem.functionspace(data.mesh, ("Lagrange", 1, (2,)))
    body = nts.Body(V, data.cells, data.tag["belt"], nts.NeoHookean(E=1e7, nu=0.0, rho=1e3))
    left, inner = (nts.Surface(V, data.facets, data.tag[f"belt_{s}"]) for s in ("left", "bottom"))
    pulley = nts.RigidSphere(centre=(0, 0), radius=RADIUS)
    law = enforcement or nts.LagrangeMultiplier()
    pair = nts.ContactPair(inner, pulley, law, nts.Coulomb(MU), method="node-to-segment")
    slack = nts.Traction(left, lambda t: (0, -PULL / THICKNESS * min(t, 1.0)))
    right = fem.locate_dofs_topological(V, 1, data.facets.find(data.tag["belt_right"]))
    drawn = fem.Function(V)

    def update(t):
        drawn.x.array.reshape(-1, 2)[right] = (TRAVEL * max(t - 1, 0), 0)

    bcs = [fem.dirichletbc(drawn, right)]
    return Belt(nts.QuasiStatic([body], [pair], dt=dt, bcs=bcs, loads=[slack], update=update), pair)
