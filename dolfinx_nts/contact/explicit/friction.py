"""Friction by springs, evaluated at one state: for explicit steps."""

from typing import Any

import numpy as np

from dolfinx_nts import _kernels
from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.friction.laws import FrictionLaw
from dolfinx_nts.contact.friction.limits import Limits, round_off
from dolfinx_nts.contact.friction.mortar_slip import NodalFrames, mean_slip
from dolfinx_nts.contact.friction.traction import slip_energy, spring_model, transport
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.search.candidates import Candidates
from dolfinx_nts.search.points import NodalPoints
from dolfinx_nts.search.shared_segments import shared_points

__all__ = ["Friction", "SpringFriction"]


class Friction:
    """Friction of the nodes of a pair in explicit steps. This base class has none. Local."""

    def add_to(
        self,
        springs: _kernels.Springs,
        candidates: Candidates,
        x_n: Floats,
        x: Floats,
        segment: Ints,
        lambda_N: Floats,
        dt: float,
        area_fraction: Floats,
    ) -> dict[str, Any]:
        """Add friction to force and energy of normal springs; return history entries.

        Args:
            springs: The normal springs of ``m`` nodes; force and energy are changed.
            candidates: Candidates within the search radius.
            x_n: Positions of the owned nodes at t_n, shape ``(n, 3)`` [m].
            x: Positions with ghosts at the end of the step, shape ``(l, 3)`` [m].
            segment: Candidates of the evaluated nodes, or -1, shape ``(c,)``.
            lambda_N: Stiffness times gap of the evaluated nodes; the ``m`` nodes with a negative
                value have springs, in the same order, shape ``(c,)`` [N].
            dt: Length of the step [s].
            area_fraction: Fraction of the area of each node of the surface on which the segments
                may press, shape ``(n,)`` [-].
        """
        return {}

    def without_contact(self) -> dict[str, Any]:
        """Entries of `ContactHistory` without contact, by name."""
        return {}


class SpringFriction(Friction):
    """Friction with a spring at each node.

    Args:
        state: State of the contact pair.
        law: Law of friction of the pair.
    """

    def __init__(self, state: PairState, law: FrictionLaw) -> None:
        """Store the state; its stiffness is chosen later. Collective, as is the first area."""
        self._state, self._law = state, law
        _ = state.nodes.positive_area

    def add_to(
        self,
        springs: _kernels.Springs,
        candidates: Candidates,
        x_n: Floats,
        x: Floats,
        segment: Ints,
        lambda_N: Floats,
        dt: float,
        area_fraction: Floats,
    ) -> dict[str, Any]:
        state, law, old = self._state, self._law, self._state.history
        assert state.eps_T is not None
        inside = lambda_N < 0
        segment, p, node = segment[inside], -lambda_N[inside], springs.node
        points, x_n = NodalPoints(springs.dofs[:, 0]), candidates.scatter.forward(x_n)
        negligible = round_off(law)
        if not len(node):
            return self.without_contact()
        slip = of_rows = candidates.slip(law.law, points, x_n, x, segment)
        shares = None
        if springs.num_nodes < len(node):
            # Nodes with several segments slip by the mean of their slips.
            node, start = np.unique(node, return_index=True)
            start, p = np.append(start, len(springs.node)), np.add.reduceat(p, start)
            shared = shared_points(springs.dofs[start[:-1], 0], springs.dofs, segment, start)
            frames = NodalFrames.of(shared, of_rows)
            slip, shares = mean_slip(shared, of_rows, frames), shared.shares
        eps_T = state.eps_T[node]
        t_n = transport(old.traction[node], old.normal[node], slip.frame_n, slip.normal_n)
        trial = t_n + eps_T[:, None] * slip.value
        area = area_fraction * state.nodes.positive_area
        limits = Limits(law, state.nodes, dt, lambda: area, old.slip, negligible)
        size = np.linalg.norm(trial, axis=1)
        judged, limit = limits.of_springs(node, p, size, eps_T, old.sliding[node])
        slides = _kernels.slides(judged.force, trial, trial, trial, np.zeros(len(node), dtype=bool))
        model = spring_model(limit, trial, p, eps_T, trial, slides)
        t = model.explicit + p[:, None] * model.direction
        on_rows, stored = t, np.einsum("mi,mi->m", t, t) / (2 * eps_T)
        if shares is not None:
            of_shares = shares.start, shares.point, frames.weights
            on_rows = _kernels.spread_tractions(*of_shares, t, len(springs.node))
            stored = shares.spread(stored, len(springs.node))
        force, energy = springs.force, springs.energy
        force -= np.einsum("mi,mij->mj", on_rows, of_rows.gradient).reshape(force.shape)
        energy += stored
        lasting = slip.value - (t - t_n) / eps_T[:, None]
        values: dict[str, Any] = {
            **self.without_contact(),
            "sliding": np.zeros(len(old.slip), dtype=bool),
            "normal": np.zeros_like(old.normal),
            "traction": np.zeros_like(old.traction),
        }
        values["slip"][node] += np.where(slides, np.linalg.norm(lasting, axis=1), 0.0)
        values["dissipation"][node] = np.einsum("mi,mi->m", t_n + t, lasting) / 2
        values["sliding"][node], values["normal"][node] = slides, slip.normal
        values["traction"][node] = np.einsum("mi,mij->mj", t, slip.frame)
        return values

    def without_contact(self) -> dict[str, Any]:
        """Accumulated slip; the energy of springs without contact is dissipated."""
        history = self._state.history
        released = slip_energy(history.traction, self._state.eps_T)
        return {"slip": history.slip.copy(), "dissipation": released}
