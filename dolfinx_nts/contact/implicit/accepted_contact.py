"""History and work of contact after an accepted attempt at a step."""

from dataclasses import replace

import numpy as np

from dolfinx_nts.common.arrays import Array, Floats
from dolfinx_nts.contact.history import ContactHistory, ContactWork
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution, PairKinematics
from dolfinx_nts.contact.implicit.mortar.mortar_pairing import MortarPairing
from dolfinx_nts.contact.joint_state import members
from dolfinx_nts.parallel import reductions

__all__ = ["contact_history", "contact_work"]


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
    body, by_body = members(step.state)[0].search.body, dict[str, Array]()
    if body is not None and isinstance(search.pairing, MortarPairing):
        partner, forces = search.pairing.on_bodies(pairs, last.force, body)
        by_body = {"partner": partner, "reaction": -forces}
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
        part=normal.part,
        area=search.pairing.area,
        force=-search.pairing.on_nodes(pairs, last.force),
        energy=history.energy + slip_energy,
        **slip,
        **by_body,
    )


def contact_work(step: ContactStep, last: ContactContribution, new: ContactHistory) -> ContactWork:
    """Work of the contact of a step on the bodies, by cause. Collective.

    Args:
        step: The attempt that is accepted, before its pairs accept their histories.
        last: Its last evaluation.
        new: History by `contact_history`.
    """
    old, pairs = step.state.history, last.pairs
    frame, ends = step.state.search.frame, (step.search.x_n, step.x)
    dx = frame.relative(*(x.take(pairs.dofs, axis=0) for x in ends))
    of_obstacle = 0.0
    if frame.moves:
        carried = frame.carried(*(x.take(step.state.nodes.nodes, axis=0) for x in ends))
        of_obstacle = float(np.vdot(new.force, carried))
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
            of_obstacle,
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
