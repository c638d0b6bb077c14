"""Small random scenes of two bodies: a run conserves energy and momenta, or stops.

The rows of the stress suite judge them: energy or ledger, momenta, no NaN.
"""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_nts as nts
from helpers.once import once
from helpers.scene import gathered
from stress.parts import box, rotation
from stress.rows import Case, Setup, run
from stress.world import Touch, World

pytestmark = pytest.mark.at_most_two_ranks

HERE = np.eye(3)
LAWS = {
    "elastic": {},
    "plastic": {"enforcement": nts.LagrangeMultiplier("plastic")},
    "penalty": {"enforcement": nts.Penalty(1e4)},
    "friction": {"friction": nts.Coulomb(0.3)},
    "spring": {"friction": nts.Coulomb(0.3, eps_T=1e4)},
    "both": {"enforcement": nts.Penalty(1e4), "friction": nts.Coulomb(0.5)},
}


# A spring with all energy of contact slides over an edge, below the adjacent facet.
KINK = {
    "cell": "hexahedron",
    "cells": 1,
    "turn": (1.5, 0.0),
    "at": (0.0, 0.0),
    "velocity": (0.0, 1.0, -0.75),
    "h": 0.01,
    "law": "penalty",
}


def drawn(seed):
    """Numbers of a scene, whatever other tests have been run."""
    rng = np.random.default_rng(seed)
    return {
        "cell": str(rng.choice(["hexahedron", "tetrahedron"])),
        "cells": int(rng.integers(1, 4)),
        "turn": tuple(rng.uniform(-3, 3, 2)),
        "at": tuple(rng.uniform(-0.4, 0.4, 2)),
        "velocity": (*rng.uniform(-2, 2, 2), rng.uniform(-3, -0.5)),
        "h": float(rng.choice([0.002, 0.01, 0.03])),
        "law": sorted(LAWS)[seed % len(LAWS)],
    }


def scene(comm: MPI.Comm, numbers, motion=HERE) -> Setup:
    """Box that flies against a plate. Collective."""
    upper = box((0.5, 0.4, 0.3), (numbers["cells"],) * 3).at(-0.25, -0.2, -0.15)
    upper = upper.turned(rotation((1, 0.2, 0), numbers["turn"][0]))
    upper = upper.turned(rotation((0, 1, 0.3), numbers["turn"][1]))
    upper = upper.at(*numbers["at"], 0.02 - upper.X[:, 2].min())
    lower = box((1.2, 1.2, 0.3), (3, 3, 1)).at(-0.6, -0.6, -0.3)
    parts = {
        "upper": upper.turned(motion).flying(*(motion @ numbers["velocity"])),
        "lower": lower.turned(motion),
    }
    touch = Touch("upper.all", "lower.top", LAWS[numbers["law"]])
    stepper = World(comm, parts, numbers["cell"]).stepper([touch], numbers["h"])
    return Setup(stepper, 10 * numbers["h"], ledger=numbers["law"] != "elastic")


@pytest.mark.parametrize(
    "numbers",
    # One case of each law on several ranks.
    [
        once(KINK, id="kink"),
        *(once(drawn(n), id=f"{n}") for n in range(5)),
        *map(drawn, range(5, 11)),
    ],
)
def test_random_scenes_conserve_their_invariants_or_stop(comm, numbers):
    outcome = run(Case("random", "numbers", str(numbers), lambda c: scene(c, numbers)), comm)
    if outcome.row["outcome"] == "stopped":
        # Whatever the error, the accepted steps must be correct.
        assert "the state is that of the last accepted step" in outcome.wrong
        assert outcome.row["energy_error"] <= 1e-9 and outcome.row["momentum_error"] <= 1e-10
    else:
        assert not outcome.wrong


@pytest.mark.serial
@pytest.mark.parametrize("seed", range(4))
def test_random_scenes_do_not_depend_on_where_they_are(comm, seed):
    # Long runs amplify the last digit, and sets of exact friction may differ.
    numbers = drawn(seed) | {"h": 0.01, "law": "elastic"}
    x = []
    for motion in (HERE, rotation((0.3, 1, 0.5), 1.1)):
        stepper = scene(comm, numbers, motion).stepper
        for _ in range(5):
            stepper.advance()
        # Tolerances by number of ranks: each mesh has its own partition.
        x.append(gathered(stepper.u.function_space, stepper.x) @ motion)
    assert np.abs(x[0] - x[1]).max() <= 1e-9
