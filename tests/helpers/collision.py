"""A collision and its balances."""

import numpy as np

import dolfinx_nts as nts


def collide(stepper, num_steps):
    """Balances at both ends, work of contact, and the most active nodes in a step. Collective."""
    diagnostics, given, active = nts.Diagnostics(stepper), 0.0, 0
    first = diagnostics.balance()
    for _ in range(num_steps):
        report = stepper.advance()
        given += sum(report.contact_work)
        active = max(active, report.num_active)
    return first, diagnostics.balance(), given, active


def check_balances(first, last, given, tol=1e-11):
    """Energy without the contribution of contact, and both momenta, are conserved."""
    energy = last.total_energy - last.contact_energy
    assert abs(energy - first.total_energy - given) < 10 * tol * first.total_energy
    for name in ("linear_momentum", "angular_momentum"):
        before, after = getattr(first, name), getattr(last, name)
        assert np.linalg.norm(after - before) < tol * np.linalg.norm(before)
