"""Application of the coupled contact solution to one contact pair."""

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.implicit.coupled.coupled_friction import CoupledSolution
from dolfinx_nts.contact.implicit.pair_forces import contribution_of
from dolfinx_nts.fem.components import in_space

__all__ = ["apply_solution", "predict_slips"]


def apply_solution(
    step: ContactStep, contribution: ContactContribution, found: CoupledSolution
) -> ContactContribution:
    """Apply contact, stick and slip of the coupled solution, with its forces. Collective.

    Args:
        step: Contact with multipliers, without tie and without tangential springs.
        contribution: Its last evaluation.
        found: Coupled solution for its pairs.

    Returns:
        The contribution with these states.
    """
    pairs, active = contribution.pairs, found.presses
    node, d = pairs.node, found.force.shape[1]
    forces, slip = np.zeros((len(node), 3)), np.zeros((len(node), 2))
    forces[:, :d] = -found.force * active[:, None]
    slip[:, : d - 1] = found.motion[:, 1:]
    step.normal.active[node], step.normal.lambda_N[node] = active, forces[:, 0]
    assert step.friction.coupled is not None
    step.friction.coupled.set_states(pairs, found.slides, active, forces, slip)
    step.count_active(node)
    return contribution_of(pairs, step.normal, step.friction, d, contribution.changed)


def predict_slips(step: ContactStep, contribution: ContactContribution, du: Floats) -> None:
    """Update the predicted slips for increments ``(n, d)`` [m] of the owned nodes. Collective."""
    coupled = step.friction.coupled
    if coupled is not None and step.state.pair.friction is not None and step.num_active:
        pairs = contribution.pairs
        m, _, d = pairs.gradients.shape
        du = step.candidates.scatter.forward(in_space(du)).take(pairs.dofs, axis=0)
        change = np.einsum("mid,md->mi", pairs.gradients[:, 1:], du.reshape(m, d))
        coupled.predict(pairs, change)
