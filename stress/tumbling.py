"""A free rigid body tumbles about its intermediate axis for 10 000 steps: does round-off add up?

    python3 -m stress.tumbling [STEPS]

Writes ``docs/tables/tumbling.md`` after 10 000 steps; takes a minute. Fails if energy or angular
momentum drift, or the body stretches.
"""

import argparse
import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

__all__ = ["ANGULAR_MOMENTUM", "ENERGY", "SPINS", "STRETCH", "Drift", "table", "tumble", "wrong"]

# Admissible drifts, relative to the values at the start [-].
ENERGY, ANGULAR_MOMENTUM, STRETCH = 1e-10, 1e-11, 1e-11
# Step [s] and spin [rad/s]: along x, the intermediate axis, with a small one across it.
SPINS = [(0.03, (5.0, 0.01, 0.02)), (0.1, (5.0, 0.5, 0.3))]
# Edges of the brick [m] and its density [kg/m^3].
_SIZES, _RHO = np.array([1.0, 2.0, 0.5]), 2.0
_NUM_STEPS = 10_000
_STEPS_OF_A_LOOK = 10
_TABLE = Path(__file__).parents[1] / "docs" / "tables" / "tumbling.md"
_HEADER = """\
| step [s] | spin [rad/s] | steps | turned over | energy | angular momentum | stretch |
|---|---|---|---|---|---|---|"""
_logger = logging.getLogger("stress")


class Drift(NamedTuple):
    """Drift of energy and momentum in a run of a tumbling body.

    Attributes:
        num_turns: Number of flips: its intermediate axis changes to the other side of the
            angular momentum.
        energy: Largest change, relative to the energy [-].
        angular_momentum: Largest change of the vector, relative to its length [-].
        stretch: Largest entry of F^T F - 1 [-].
    """

    num_turns: int
    energy: float
    angular_momentum: float
    stretch: float


def tumble(dt: float, spin: Sequence[float], num_steps: int) -> Drift:
    """Let a brick tumble in space, on one rank.

    Args:
        dt: Step [s].
        spin: At the start, shape ``(3,)`` [rad/s].
        num_steps: Number of steps.
    """
    shape = {"corner": -_SIZES / 2, "size": _SIZES, "cells": (1, 2, 1)}
    mesh, cells, _, tag = nts.read_mesh(
        lambda model: parts.add_box(model, "brick", **shape), MPI.COMM_SELF
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    brick = nts.RigidBody(V, cells, tag["brick"], _RHO)
    stepper = nts.EnergyMomentum([brick], dt=dt)
    stepper.set_velocity(brick, lambda X: np.cross(spin, X.T).T)
    diagnostics, X = nts.Diagnostics(stepper), V.tabulate_dof_coordinates()
    start = diagnostics.balance()
    size, side = np.linalg.norm(start.angular_momentum), 1.0
    num_turns, drifts = 0, np.zeros(3)
    for step in range(1, num_steps + 1):
        stepper.advance()
        if step % _STEPS_OF_A_LOOK and step < num_steps:
            continue
        now, turn = diagnostics.balance(), np.linalg.lstsq(X, stepper.x, rcond=None)[0].T
        if side * turn[:, 0] @ now.angular_momentum < -0.5 * size:
            num_turns, side = num_turns + 1, -side
        drift = np.linalg.norm(now.angular_momentum - start.angular_momentum) / size
        change = abs(now.total_energy / start.total_energy - 1)
        drifts = np.maximum(drifts, [change, drift, np.abs(turn.T @ turn - np.eye(3)).max()])
    return Drift(num_turns, *drifts.tolist())


def wrong(drift: Drift) -> str:
    """Names of the drifts above their bounds, or ""."""
    limits = {"energy": ENERGY, "angular_momentum": ANGULAR_MOMENTUM, "stretch": STRETCH}
    values = drift._asdict()
    found = [name for name, limit in limits.items() if not values[name] <= limit]
    return "; ".join(f"{name} {values[name]:.1e} > {limits[name]:g}" for name in found)


def table(drifts: Sequence[Drift], num_steps: int) -> str:
    """Markdown table of the runs of `SPINS`."""
    lines = [_HEADER]
    for (dt, spin), drift in zip(SPINS, drifts, strict=True):
        cells = [f"{dt:g}", ", ".join(f"{part:g}" for part in spin), str(num_steps)]
        cells += [f"{drift.num_turns} times", *(f"{value:.0e}" for value in drift[1:])]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> int:
    """Run each spin; return the number of spins with drift."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("steps", nargs="?", type=int, default=_NUM_STEPS)
    num_steps = parser.parse_args().steps
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    logging.getLogger("dolfinx_nts").setLevel(logging.ERROR)
    drifts = [tumble(dt, spin, num_steps) for dt, spin in SPINS]
    _logger.info("%s", table(drifts, num_steps))
    found = [text for text in map(wrong, drifts) if text]
    for text in found:
        _logger.error("tumbling: %s", text)
    if num_steps == _NUM_STEPS and not found:
        _TABLE.write_text(f"{table(drifts, num_steps)}\n", encoding="utf-8")
    return len(found)


if __name__ == "__main__":
    sys.exit(min(main(), 1))
