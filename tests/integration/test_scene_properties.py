"""Small random scenes of two bodies: a run conserves what it must, or stops.

The rows of the stress suite judge them: energy or ledger, momenta, no NaN.
"""

from mpi4py import MPI

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import dolfinx_nts as nts
from helpers.scenes import gathered
from stress.parts import box, rotation
from stress.rows import Case, Setup, run
from stress.world import Touch, World

scenes = settings(derandomize=True, database=None, deadline=None, max_examples=12)
HERE = np.eye(3)
LAWS = {
    "elastic": {},
    "plastic": {"enforcement": nts.LagrangeMultiplier("plastic")},
    "penalty": {"enforcement": nts.Penalty(1e4)},
    "friction": {"friction": nts.Coulomb(0.3)},
    "spring": {"friction": nts.Coulomb(0.3, eps_T=1e4)},
    "both": {"enforcement": nts.Penalty(1e4), "friction": nts.Coulomb(0.5)},
}


@st.composite
def draws(draw):
    """Numbers of a scene."""
    angle = st.floats(-3, 3)
    return {
        "cell": draw(st.sampled_from(["hexahedron", "tetrahedron"])),
        "cells": draw(st.integers(1, 3)),
        "turn": (draw(angle), draw(angle)),
        "at": (draw(st.floats(-0.4, 0.4)), draw(st.floats(-0.4, 0.4))),
        "velocity": (draw(st.floats(-2, 2)), draw(st.floats(-2, 2)), draw(st.floats(-3, -0.5))),
        "h": draw(st.sampled_from([0.002, 0.01, 0.03])),
        "law": draw(st.sampled_from(sorted(LAWS))),
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


def test_random_scenes_conserve_what_they_must_or_stop(comm):
    @scenes
    @given(draws())
    def check(numbers):
        outcome = run(Case("random", "numbers", str(numbers), lambda c: scene(c, numbers)), comm)
        wrong = outcome.wrong
        if outcome.row["outcome"] == "stopped":
            # Whatever it says, what was done until then is right.
            assert "the state is that of the last accepted step" in wrong
            row = outcome.row
            assert row["energy_error"] <= 1e-9 and row["momentum_error"] <= 1e-10
        else:
            assert not wrong, f"{numbers}: {wrong}"

    check()


def test_random_scenes_do_not_depend_on_where_they_are(comm):
    turn = rotation((0.3, 1, 0.5), 1.1)

    @settings(scenes, max_examples=5)
    @given(draws())
    def check(numbers):
        # Long runs amplify the last digit, and sets of exact friction may differ.
        numbers = numbers | {"h": 0.01, "law": "elastic"}
        x = []
        for motion in (HERE, turn):
            stepper = scene(comm, numbers, motion).stepper
            for _ in range(5):
                stepper.advance()
            # By number: each mesh has a partition of its own.
            x.append(gathered(stepper.u.function_space, stepper.x) @ motion)
        assert np.abs(x[0] - x[1]).max() <= 1e-9, numbers

    check()
