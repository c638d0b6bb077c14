"""Changes of contact by prescribed increments of nodes and obstacles."""

import numpy as np

from dolfinx_nts.common.arrays import Floats
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import PairKinematics, changes_by
from dolfinx_nts.contact.implicit.pair_forces import PairForces
from dolfinx_nts.fem.components import in_space

__all__ = ["prescribed_changes"]


def prescribed_changes(
    step: ContactStep, pairs: PairKinematics, increment: Floats
) -> tuple[Floats, Floats]:
    """Changes of gap, slip and force by prescribed increments, to first order. Collective.

    Args:
        step: Contact of the step, including the remaining motion of its obstacle.
        pairs: Pairs of its last evaluation.
        increment: Prescribed increments of the owned nodes, shape ``(n, d)`` [m].

    Returns:
        Changes of gaps and slips, shape ``(m, 3)`` [m], and of forces on the owned nodes for
        constant multipliers, shape ``(n, 3)`` [N].
    """
    frame, scatter = step.state.search.frame, step.candidates.scatter
    change: Floats = np.zeros((len(increment), 3))
    if not step.num_active:
        return np.zeros((len(pairs.node), 3)), change
    force, tangent, columns, slopes = PairForces.of(pairs, step.normal, step.friction)
    given, turn = frame.remaining(step.x)
    increments = scatter.forward(in_space(increment)) - given
    dofs, nodes = pairs.dofs, pairs.blocks.nodes
    changes = changes_by(pairs, increments[dofs].reshape(pairs.contact.gradient.shape))
    sloping = np.einsum("mid,mij,mj->md", columns, slopes, changes)
    sloping += np.cross(turn, force.reshape(-1, 3)).reshape(force.shape)
    turning = np.einsum("pij,pj->pi", tangent, increments[nodes].reshape(tangent.shape[:2]))
    for some, forces in ((dofs, sloping), (nodes, turning)):
        scatter.add(change, some, forces.reshape(*some.shape, 3))
    return changes, change
