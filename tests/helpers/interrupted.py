"""Scenes of runs with cut steps, and of runs that are stopped and resumed."""

from functools import partial

from mpi4py import MPI

import numpy as np

import dolfinx_nts as nts
from helpers.scenes import BLOCK_RUBBER, BLOCK_STEP, blocks


def layers(middle):
    """Owner of the cells by their position, the same in every call."""
    return (np.argsort(np.argsort(middle[:, 0])) % MPI.COMM_WORLD.size).astype(int)


# It falls on a corner of the lowest block, spins, and moves on.
TOOL = nts.RigidSphere((1.2, 1.2, 0.823), 0.3).moving(
    nts.Motion(lambda t: (-t, 0, -t), lambda t: (0, 5 * t, 0), (1.2, 1.2, 0.823))
)


def with_law(scheme, enforcement, friction, bodies, pairs, dt, method="node-to-segment"):
    """Return a stepper whose pairs have another law, with a tool if there is friction."""
    laws = enforcement or nts.LagrangeMultiplier(), friction, method
    pairs = [nts.ContactPair(p.nodes, p.segments, *laws) for p in pairs]
    if friction is not None and method == "node-to-segment":
        pairs.append(nts.ContactPair(pairs[0].segments, TOOL, *laws))
    return scheme(bodies, pairs, dt=dt)


# Relaxes within a step, and in about as long as the run.
BRANCHES = [(0.5, 0.5 * BLOCK_STEP), (0.8, 10 * BLOCK_STEP)]


def with_branches(scheme, bodies, pairs, dt):
    """Return a stepper whose bodies have viscous branches."""
    viscous = nts.SaintVenantKirchhoff(*BLOCK_RUBBER, branches=BRANCHES)
    for body in bodies:
        vars(body)["material"] = viscous
    return scheme(bodies, pairs, dt=dt)


def with_flow(scheme, bodies, pairs, dt):
    """Return a stepper whose bodies are elastic-plastic."""
    E, nu, rho = BLOCK_RUBBER
    metal = nts.J2Plasticity(E, nu, rho, yield_stress=0.02 * E, hardening=0.1 * E)
    for body in bodies:
        vars(body)["material"] = metal
    return scheme(bodies, pairs, dt=dt)


RESOLVED = nts.LagrangeMultiplier("resolved")
SCHEMES = {
    "multiplier": nts.EnergyMomentum,
    "stick": partial(with_law, nts.EnergyMomentum, None, nts.Coulomb(0.3)),
    "spring": partial(with_law, nts.Midpoint, nts.Penalty(), nts.Coulomb(0.3)),
    "alpha": partial(with_law, nts.GeneralizedAlpha, nts.LagrangeMultiplier("plastic"), None),
    "explicit": partial(with_law, nts.CentralDifference, nts.Penalty(), nts.Coulomb(0.3)),
    "strong": nts.EnergyMomentum,
    "resolved": partial(with_law, nts.EnergyMomentum, RESOLVED, None),
    "resolved mortar": partial(
        with_law, nts.EnergyMomentum, RESOLVED, nts.Coulomb(0.3), method="mortar"
    ),
    "branches": partial(with_branches, nts.EnergyMomentum),
    "plastic": partial(with_flow, nts.EnergyMomentum),
    "mortar": partial(with_law, nts.EnergyMomentum, None, nts.Coulomb(0.3), method="mortar"),
}


def scene(comm, scheme=nts.EnergyMomentum, **options):
    """Three blocks, whose contacts begin before and after the break."""
    dt = 0.1 * BLOCK_STEP if scheme is SCHEMES["explicit"] else BLOCK_STEP
    return blocks(comm, scheme, num_bodies=3, layers=layers_of(scheme), dt=dt, **options)


def layers_of(scheme):
    """Layers of cells that a block needs with a scheme."""
    return 2 if scheme in (SCHEMES["resolved"], SCHEMES["resolved mortar"]) else 1
