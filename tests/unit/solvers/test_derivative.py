"""Derivative of a residual in a direction, in several precisions."""

import pytest

from dolfinx_nts.solvers import derivative
from helpers.scenes import blocks

pytestmark = pytest.mark.at_most_two_ranks


def test_rounding_is_judged_by_kernels_that_there_are(comm, rng, monkeypatch, agree):
    """Those that are soon compiled take ten times as long, and are used once at most."""
    made = []

    class Counted(derivative.NodalSum):
        def __init__(self, forms, V, kernels="double"):
            made.append(kernels)
            super().__init__(forms, V, kernels)

    monkeypatch.setattr(derivative, "NodalSum", Counted)
    stepper = blocks(comm).stepper
    bulk = stepper._bulk
    x = 1e-3 * rng.standard_normal((len(stepper.node_ids), 3))
    first = bulk.rounding(x)
    assert agree(made == ["single", "slow"])
    quick = blocks(comm).stepper._bulk
    made.clear()
    quick.action(x)
    assert agree(quick.rounding(x) == pytest.approx(first, rel=1e-6))
    assert agree(made == ["double", "single"])
