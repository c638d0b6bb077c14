r"""Energy of springs that lose their segments or change their points, returned as an impulse.

A node that slides over a rim, or leaves a corner, loses its segment while its spring is still
compressed. Without a segment the spring cannot do work in the next step, and its energy :math:`E`
would be lost. In mortar contact the points of a node change with every step, and with them its
mean gap: where it is larger at the new points, the spring is compressed less, and the difference of
its energies would be lost. At the end of that step all such springs act once more, as an impulse
:math:`J p`, where :math:`p` contains their forces on both sides at the current positions:

.. math:: v^+ = v + J M^{-1} p, \qquad
   J \, p \cdot v + \tfrac12 J^2 \, p \cdot M^{-1} p = E,

with the smaller solution in magnitude, which changes the motion least.

Forces of a spring have no resultant and no moment. The impulse therefore conserves both momenta
and, with the consistent mass, the energy.
"""

import logging
from collections.abc import Sequence

import numpy as np
from dolfinx import fem

from dolfinx_nts.common.arrays import Floats, indices
from dolfinx_nts.contact.history import ContactWork
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution
from dolfinx_nts.contact.joint_state import JointState
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.components import of_space
from dolfinx_nts.integrators.rates import ConsistentMass
from dolfinx_nts.model.bodies import Body
from dolfinx_nts.parallel import reductions
from dolfinx_nts.search.mortar.facet_candidates import FacetCandidates
from dolfinx_nts.solvers.bulk import Bulk

__all__ = ["ReleasedSprings"]

_logger = logging.getLogger("dolfinx_nts")

# Relative change of the energy of a spring at new points [-] that counts as round-off. Smaller:
# springs whose points move along a plane give impulses of round-off; larger: this fraction of the
# energy of a spring may be lost in a step.
_ROUNDING = 1e-12
# Loss relative to the kinetic energy of all bodies [-] above which there is a warning. Smaller:
# warnings of irrelevant losses; larger: no warning of losses that are visible in the energy ledger.
_NEGLIGIBLE = 1e-9


class ReleasedSprings:
    """Returns the energy of springs that lost their contact points to the bodies. Collective.

    Args:
        bodies: The bodies.
        bulk: Their supports and rigid motions.
        v: Velocity of the bodies [m/s].
        free: 1 where the displacement of an owned node is unknown, otherwise 0, ``(n, d)``; None if
            all are unknown.
    """

    def __init__(
        self, bodies: Sequence[Body], bulk: Bulk, v: fem.Function, free: Floats | None
    ) -> None:
        self._bulk, self._v, self._free = bulk, v, free
        self._mass = ConsistentMass(bodies, fem.Function(v.function_space))
        # Energy of the springs of each pair that is returned to the bodies, and that is lost [J].
        self._energies: dict[PairState | JointState, float] = {}
        self._lost: dict[PairState | JointState, float] = {}
        # Largest loss of a pair in one step that was reported [J].
        self._reported = 0.0
        # Forces of the springs on the owned nodes [N].
        self._force: Floats = np.zeros((bulk.num_owned // bulk.rigid.dim, 3))

    def collect(self, step: ContactStep, last: ContactContribution) -> None:
        """Collect the springs of a pair that lost their segments, or energy at new points.

        The energy of springs whose last segment is not a candidate any more is lost; `give_back`
        warns of it.

        Args:
            step: The attempt that is accepted, before its pairs accept their histories.
            last: Its last evaluation.
        """
        state, candidates, history = step.state, step.candidates, step.state.history
        if state.eps_N is None:
            return
        surplus = step.normal.surplus_energy(last.pairs)
        surplus[surplus <= _ROUNDING * history.energy[last.pairs.node]] = 0.0
        energy = step.normal.released_energy(last.pairs.node)
        node = indices(energy > 0)
        if not reductions.anywhere(self._bulk.comm, len(node) > 0 or bool(surplus.any())):
            return
        pairs, scatter = last.pairs, candidates.scatter
        stiffness = history.part * state.eps_N
        size = np.sqrt(2 * surplus * stiffness[pairs.node])
        forces = size[:, None] * pairs.contact.gradient
        scatter.add(self._force, pairs.dofs, forces.reshape(*pairs.dofs.shape, 3))
        # Joint candidates identify the pair of a key by its position in the array of all nodes.
        segment = candidates.find(history.key)[node]
        node, segment = node[segment >= 0], segment[segment >= 0]
        points = step.search.points.take(node)
        gradient = candidates.contact("static", points, step.x, step.x, segment).gradient
        # Springs push along the gradients of their gaps; their force follows from their energy.
        size = np.sqrt(2 * energy[node] * stiffness[node])
        size[~np.isfinite(gradient).all(axis=1)] = 0.0
        gradient = np.nan_to_num(gradient)
        nodes = candidates.segments
        if isinstance(candidates, FacetCandidates):  # facets of degree 2, or smooth patches
            nodes = candidates.facet_nodes
        dofs = points.dofs(nodes.take(segment, axis=0))
        forces = (size[:, None] * gradient).reshape(*dofs.shape, 3)
        scatter.add(self._force, dofs, forces)
        taken = np.zeros(len(energy), dtype=bool)
        taken[node[size > 0]] = True
        sums = np.array([surplus.sum() + energy[taken].sum(), energy[~taken].sum()])
        sums = reductions.total(self._bulk.comm, sums)
        self._energies[state], self._lost[state] = map(float, sums)

    def give_back(self, u: Floats, t: float) -> dict[PairState | JointState, ContactWork]:
        """Change the velocity by the impulse of the collected springs.

        Args:
            u: Displacement at the end of the step, at the owned nodes, shape ``(n, d)`` [m].
            t: Time at the end of the step [s], for the warning of lost energy.

        Returns:
            Energy given to the bodies by the springs of each pair.
        """
        energies, lost = self._energies, self._lost
        self._energies, self._lost = {}, {}
        if not self._push(u, sum(energies.values())):
            lost = {state: lost[state] + energy for state, energy in energies.items()}
            energies = {}
        self._warn(lost, t)
        return {state: ContactWork(facet_change=each) for state, each in energies.items()}

    def _warn(self, lost: dict[PairState | JointState, float], t: float) -> None:
        """Warn of the largest loss of a pair, and again if a loss is twice as large. Collective."""
        state = max(lost, key=lost.__getitem__, default=None)
        if state is None or lost[state] <= 2 * self._reported:
            return
        v = self._v.x.array[: self._bulk.num_owned]
        kinetic = reductions.total(self._bulk.comm, float(self._mass.times(v) @ v)) / 2
        if lost[state] <= _NEGLIGIBLE * kinetic:
            return
        self._reported = lost[state]
        if self._bulk.comm.rank == 0:
            _logger.warning(
                "at t = %g s, springs of contact between %s have lost an energy of %.3g J, as they "
                "lost their segments or changed their contact points: neither side can move, or "
                "no segment is near any more; shorter steps lose less",
                *(t, state.pair.between, lost[state]),
            )

    def force_and_energy(self) -> tuple[Floats, float]:
        """Forces of the collected springs on the owned nodes, ``(n, 3)`` [N], and energy [J].

        They are not given back. Local.
        """
        force, energy = self._force.copy(), sum(self._energies.values())
        self._energies, self._lost = {}, {}
        self._force[:] = 0.0
        return force, energy

    def impulse(self, u: Floats, v: Floats, force: Floats, energy: float) -> Floats | None:
        """Change of the velocity by springs that return their energy. Collective.

        Args:
            u: Displacement at the owned nodes, shape ``(n, d)`` [m].
            v: Velocity at the owned dofs, shape ``(d n,)`` [m/s].
            force: Forces of the springs, shape ``(n, 3)`` [N].
            energy: Their energy [J].

        Returns:
            The change, shape ``(d n,)`` [m/s]; None if neither side can move.
        """
        forces, d = of_space(force, u.shape[1]).ravel(), u.shape[1]
        rigid, comm = self._bulk.rigid, self._bulk.comm
        rigid.begin(u)
        unknown = 1.0 if self._free is None else self._free.ravel()

        def admissible(values: Floats) -> Floats:
            return rigid.nearest_free((unknown * values).reshape(-1, d)).ravel()

        change = self._mass.solve(forces, admissible)
        momentum = self._mass.times(change)
        # The velocity field of a rotating rigid body is rigid only up to the order of the scheme.
        sums = np.array([momentum @ change, momentum @ v])
        square, speed = map(float, reductions.total(comm, sums))
        if square <= 0:
            return None
        root = np.copysign(np.sqrt(speed**2 + 2 * square * energy), speed)
        impulse: Floats = 2 * energy / (speed + root) * change
        return impulse

    def _push(self, u: Floats, energy: float) -> bool:
        """Add the impulse that gives the bodies an energy [J] to the velocity. Collective.

        Returns:
            False if neither side can move.
        """
        if not energy:
            return True
        v = self._v.x.array
        change = self.impulse(u, v[: u.size], self._force, energy)
        self._force[:] = 0.0
        if change is None:
            return False
        v[: u.size] += change
        self._v.x.scatter_forward()
        return True
