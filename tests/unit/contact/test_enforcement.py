"""Rules of the multipliers: eligible nodes, reference gap, active set."""

import numpy as np
import pytest

from dolfinx_nts.contact.enforcement import LagrangeMultiplier, Penalty
from dolfinx_nts.contact.springs import spring_energy, spring_force
from reference.bulk import taylor_order

pytestmark = pytest.mark.serial

NAN = np.nan
SIZE = 0.5  # of the segment; an active node stays near within 1 % of it

# gap_n, gap_trial, active before, eligible under elastic impact
CASES = {
    "open and stays open": (0.1, 0.05, False, False),
    "open and passes less deep than it was open": (0.1, -0.05, False, False),
    "open and passes deeper than it was open": (0.05, -0.1, False, True),
    "touches": (0.0, 0.1, False, True),
    "touches up to round-off": (1e-16, 1e-16, False, True),
    "nearly touches": (1e-8, 1e-8, False, False),
    "penetrates and leaves": (-0.01, 0.2, False, True),
    "penetrates": (-0.01, -0.02, False, True),
    "was active and is near": (0.004, 0.01, True, True),
    "near but was not active": (0.004, 0.01, False, False),
    "was active and is far": (0.006, 0.01, True, False),
    "has no segment": (NAN, NAN, False, False),
    "has no segment but was active": (NAN, NAN, True, False),
    "has no segment in the trial state": (0.1, NAN, False, False),
}


def eligible(enforcement, case):
    gap_n, gap_trial, active, _ = CASES[case]
    flags = enforcement.eligible(
        np.array([gap_n]), np.array([gap_trial]), np.array([SIZE]), np.array([active])
    )
    assert flags.dtype == bool
    assert flags.shape == (1,)
    return bool(flags[0])


@pytest.mark.parametrize("case", CASES)
def test_elastic_impact_stops_nodes_at_the_nearer_side(case):
    assert eligible(LagrangeMultiplier(), case) == CASES[case][3]


@pytest.mark.parametrize("impact", ["elastic", "plastic"])
def test_active_set_solves_the_complementarity(impact, rng):
    # At 0 <= -lambda, excess >= 0 with product 0 the set does not change,
    # whatever the weight; pulling or penetrating nodes do change it.
    enforcement = LagrangeMultiplier(impact)
    weight = rng.uniform(0.1, 1e6, 3)
    touching = enforcement.active(np.array([-1.0, -1e-3, -1e5]), np.zeros(3), weight)
    assert touching.all()
    apart = enforcement.active(np.zeros(3), np.array([1.0, 1e-9, 0.0]), weight)
    assert not apart.any()
    assert not enforcement.active(np.array([2.0]), np.zeros(1), weight[:1]).any()
    assert enforcement.active(np.zeros(1), np.array([-1e-9]), weight[:1]).all()


@pytest.mark.parametrize("e", [0.0, 0.3, 1.0])
def test_restitution_holds_nodes_within_half_a_step_of_the_surface(e, rng):
    law, travel = LagrangeMultiplier("restitution", e), -0.2
    gap, none = rng.uniform(0.2, 0.4, 50), np.zeros(50, dtype=bool)
    held = none
    for _ in range(3):
        arrives = law.eligible(gap, gap + travel, np.full(50, SIZE), none) & ~held
        gap += travel * np.where(arrives, law.part, ~held)
        held = held | arrives
    assert held.all()
    assert np.abs(gap).max() <= 0.1


def test_other_impacts_are_refused():
    with pytest.raises(ValueError, match="'resolved' or 'restitution', given 'soft'"):
        LagrangeMultiplier("soft")
    with pytest.raises(ValueError, match="given 1"):
        LagrangeMultiplier(1)


# Gaps at both ends of a step: outside, touching, inside, no motion.
GAPS = [(0.2, -0.1), (-0.1, 0.2), (-0.1, -0.3), (0.0, -0.1), (-0.1, 0.0), (0.1, 0.2), (0.0, 0.0)]
GAPS += [(-0.2, -0.2), (-0.2, -0.2 + 1e-14), (1e-14, -1e-14), (0.1, 0.1)]
EPS_N = 7.0


@pytest.mark.parametrize("gaps", GAPS, ids=str)
def test_spring_works_with_the_change_of_its_energy(gaps):
    # lambda (g_{n+1} - g_n) = U_{n+1} - U_n with U = eps min(g, 0)^2 / 2
    stiffness = np.array([EPS_N])
    gap_n, gap = (np.array([g]) for g in gaps)
    lambda_N, _ = spring_force(gap_n, gap, stiffness)
    energies = [spring_energy(g, stiffness) for g in (gap_n, gap)]
    assert energies[0] == EPS_N * min(gaps[0], 0) ** 2 / 2
    rounding = 1e2 * np.finfo(float).eps * EPS_N * 0.1
    np.testing.assert_allclose(lambda_N * (gap - gap_n), energies[1] - energies[0], atol=rounding)
    assert lambda_N <= 0
    assert -lambda_N <= EPS_N * max(0, *(-g for g in gaps)) + rounding


@pytest.mark.parametrize("gaps", GAPS, ids=str)
@pytest.mark.parametrize("share", [0.6, 1.0])
def test_spring_with_a_larger_weight_of_the_end_dissipates_and_never_pulls(gaps, share):
    stiffness = np.array([EPS_N])
    gap_n, gap = (np.array([g]) for g in gaps)
    lambda_N, _ = spring_force(gap_n, gap, stiffness, share)
    stored = spring_energy(gap, stiffness) - spring_energy(gap_n, stiffness)
    assert lambda_N * (gap - gap_n) >= stored - 1e-12
    assert lambda_N <= 0
    if max(gaps) < 0:
        expected = EPS_N * ((1 - share) * gaps[0] + share * gaps[1])
        np.testing.assert_allclose(lambda_N, expected, rtol=1e-12)


@pytest.mark.parametrize("gaps", GAPS[:3] + GAPS[7:9], ids=str)
@pytest.mark.parametrize("share", [0.5, 0.6])
def test_slope_of_the_spring_has_a_second_order_remainder(gaps, share):
    stiffness = np.array([EPS_N])
    gap_n, gap = (np.array([g]) for g in gaps)

    def force(at):
        return spring_force(gap_n, at, stiffness, share)[0]

    _, slope = spring_force(gap_n, gap, stiffness, share)
    if gaps[0] < 0 and gaps[1] < 0:  # linear: no remainder at all
        np.testing.assert_allclose(force(gap + 0.01) - force(gap), 0.01 * slope, rtol=1e-10)
    else:
        assert taylor_order(force, gap, np.array([1.0]), slope) > 1.9


@pytest.mark.parametrize("eps_N", [0.0, -1.0, np.nan, np.inf])
def test_impossible_springs_are_refused(eps_N):
    with pytest.raises(ValueError, match=f"penalty eps_N > 0, given {eps_N}"):
        Penalty(eps_N)


def test_a_subclass_of_springs_is_refused_as_its_force_would_have_no_effect():
    with pytest.raises(TypeError, match="given Softer: the force of a spring cannot be extended"):
        type("Softer", (Penalty,), {})
