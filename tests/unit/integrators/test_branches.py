"""Viscous branches: relaxation, cyclic loss, ledger, momenta, cut steps and restart."""

import numpy as np
import pytest
from dolfinx import fem

import dolfinx_nts as nts
from helpers.boxed import CLOSED, RHO, Box, Ledger, swirl

pytestmark = pytest.mark.at_most_two_ranks

BRANCHES = [(0.8, 0.03), (0.5, 0.4)]
SHEAR = 1.0e3 / 2.6


def rubber(branches=BRANCHES, **options):
    return nts.SaintVenantKirchhoff(1.0e3, 0.3, RHO, branches=branches, **options)


def alpha(*arguments, **options):
    return nts.GeneralizedAlpha(*arguments, rho_inf=0.5, **options)


def norm_of_stress(E, nu=0.3):
    return E / (2 * (1 + nu))


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("scheme", [nts.EnergyMomentum, nts.Midpoint, alpha])
def test_branches_only_take_energy_and_all_of_it_is_accounted_for(comm, cell, scheme):
    box = Box(comm, cell, rubber())
    stepper = scheme([box.body], dt=0.02)
    stepper.set_velocity(box.body, swirl)
    ledger = Ledger(stepper)
    ledger.run(10)
    works = [report.damping_work for report in ledger.reports]
    assert max(works) < 0
    assert sum(works) < -0.01 * ledger.start.kinetic_energy
    assert ledger.error <= CLOSED
    if scheme is not nts.EnergyMomentum:
        return
    # Of the energy nothing but the dissipation is lost.
    assert abs(ledger.gained - sum(works)) <= 1e-10 * ledger.scale
    start, end = ledger.start, ledger.diagnostics.balance()
    for name in ("linear_momentum", "angular_momentum"):
        before, after = getattr(start, name), getattr(end, name)
        np.testing.assert_allclose(after, before, atol=1e-11 * np.linalg.norm(before))
