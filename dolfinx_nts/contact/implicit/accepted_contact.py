"""History and work of contact after an accepted attempt at a step."""

from dataclasses import replace

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats, Ints
from dolfinx_nts.contact.history import ContactHistory, ContactWork
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution, PairKinematics
from dolfinx_nts.contact.joint_state import members
from dolfinx_nts.parallel import reductions

__all__ = ["contact_history", "contact_work", "obstacle_work"]


def contact_history(step: ContactStep, last: ContactContribution) -> ContactHistory:
    """Contact state for the history of the pair. Collective.

    Args:
        step: An attempt that has found equilibrium.
        last: Its last evaluation.
    """
    pairs, search, normal, friction = last.pairs, step.search, step.normal, step.friction
    n = len(normal.active)
    key = np.full(n, -1, dtype=np.int64)
    found = search.segment >= 0
    key[found] = step.candidates.key[search.segment[found]]
    energy, offset = normal.energy(pairs)
    slip_energy, slip = friction.accepted(pairs, step.x)
    first, by_body = members(step.state)[0], dict[str, Array]()
    if (body := first.passes.sharing_bodies(first.pair)) is not None:
        partner, reaction = _reactions(step, last, body)
        by_body = {"partner": partner, "reaction": reaction}
    history = ContactHistory.at(
        n,
        pairs.node,
        normal=pairs.contact.gradient[:, :3],
        energy=energy,
        offset=offset,
    )
    return replace(
        history,
        key=key,
        shared=search.shared.sums(step.candidates.key),
        active=normal.active.copy(),
        sliding=normal.active & friction.sliding,
        lambda_N=normal.lambda_N.copy(),
        gap=search.gap.copy(),
        soft_depth=normal.soft_depth,
        part=normal.stiffness_fraction,
        area=search.pairing.area,
        dual_fraction=search.dual_fraction,
        force=-search.pairing.on_nodes(pairs, last.force),
        energy=history.energy + slip_energy,
        **slip,
        **by_body,
    )


def _reactions(step: ContactStep, last: ContactContribution, body: Ints) -> tuple[Ints, Floats]:
    """Reactions to the force of each pair on the bodies of its segments. Collective.

    Arguments as for `contact_history`; ``body`` is the body of each owned node.

    Returns:
        Bodies on which the pair of each node acts, or -1, shape ``(n, w)``, and the reactions,
        ``(n, w, 3)`` [N].
    """
    pairs, scatter, n = last.pairs, step.candidates.scatter, len(step.normal.active)
    of_map = scatter.forward(np.tile(body[:, None].astype(np.float64), 3))[:, 0].astype(np.int64)
    forces = last.force.reshape(*pairs.dofs.shape, 3)
    row, column = (step.search.pairing.on_segments(pairs) & forces.any(axis=2)).nonzero()
    width = 1 + int(of_map.max(initial=0))
    key, entry = np.unique(row * width + of_map[pairs.dofs[row, column]], return_inverse=True)
    of_pair, number = np.divmod(key, width)
    place = np.arange(len(key)) - np.searchsorted(of_pair, of_pair)
    most = reductions.largest(scatter.index_map.comm, float(place.max(initial=0)))
    shape, node = (n, 1 + int(most)), pairs.node[of_pair]
    partner, reaction = np.full(shape, -1, dtype=np.int32), np.zeros((*shape, 3))
    partner[node, place] = number
    np.add.at(reaction, (node[entry], place[entry]), -forces[row, column])
    return partner, reaction


def obstacle_work(step: ContactStep, force: Floats) -> float:
    """Work of a moving obstacle in a step, on this rank [J]. Local.

    Args:
        step: The attempt that is accepted.
        force: Forces on the nodes, shape ``(n, 3)`` [N].
    """
    frame, nodes = step.state.search.frame, step.state.nodes.nodes
    if not frame.moves:
        return 0.0
    carried = frame.carried(*(x.take(nodes, axis=0) for x in (step.search.x_n, step.x)))
    return float(np.vdot(force, carried))


def contact_work(
    step: ContactStep, last: ContactContribution, new: ContactHistory, mean: Floats
) -> ContactWork:
    """Work of the contact of a step on the bodies, by cause. Collective.

    Args:
        step: The attempt that is accepted, before its pairs accept their histories.
        last: Its last evaluation.
        new: History by `contact_history`.
        mean: Forces on the nodes that do the work of an obstacle, shape ``(n, 3)`` [N].
    """
    old, pairs = step.state.history, last.pairs
    frame, ends = step.state.search.frame, (step.search.x_n, step.x)
    dx = frame.relative(*(x.take(pairs.dofs, axis=0) for x in ends))
    work = _scheme_work(step, pairs, dx.reshape(pairs.contact.force.shape))
    # Pairs that were active on the same segment, inactive, and active on another segment.
    same = step.search.pairing.is_same(pairs)
    kind = np.where(old.active[pairs.node], np.where(same, 0, 2), 1)
    stays, arrives, moves = np.bincount(kind, work, minlength=3)
    normal = step.normal
    lost = normal.released_energy(pairs.node).sum() + normal.surplus_energy(pairs).sum()
    parts = np.array(
        [
            stays,
            arrives,
            moves - lost,
            old.energy.sum() - new.energy.sum(),
            -new.dissipation.sum(),
            obstacle_work(step, mean),
        ]
    )
    return ContactWork(*reductions.total(step.state.nodes.V.mesh.comm, parts).tolist())


def _scheme_work(step: ContactStep, pairs: PairKinematics, dx: Floats) -> Floats:
    """Work of pairs that is neither stored in springs nor dissipated, shape ``(m,)`` [J]. Local.

    ``dx`` is the displacement of the pairs in the step, shape ``(m, d)`` [m].
    """
    work: Floats = -step.normal.lambda_N[pairs.node] * (pairs.contact.force * dx).sum(axis=1)
    work -= step.friction.scheme_work(pairs, dx)
    work += step.normal.stored(pairs)
    return work
