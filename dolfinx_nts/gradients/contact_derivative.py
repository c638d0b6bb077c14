"""Derivatives of the contact forces and of the contact history of a solved step.

Pairs, active sets and segments are constant in a step. The force of a pair is lambda F(x_n, x),
with the discrete gradient F, which is symmetric in both ends of the step: its derivative with
respect to x_n is the tangent of the same kernel with exchanged ends.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dolfinx_nts.common.arrays import Floats, Ints
from dolfinx_nts.contact.implicit.contact_step import ContactStep
from dolfinx_nts.contact.implicit.contributions import ContactContribution, PairKinematics
from dolfinx_nts.contact.implicit.normal.penalty import PenaltyContact
from dolfinx_nts.contact.joint_state import members
from dolfinx_nts.contact.pair_state import PairState
from dolfinx_nts.fem.components import in_space, of_space
from dolfinx_nts.gradients.controls import ParameterControl
from dolfinx_nts.search.scatter import NodalScatter

__all__ = ["WIDTH", "ContactDerivative", "ContactMotion", "Histories", "of_members", "store"]

# Changes or costates of values of the histories of the nodes of each pair, ``(n, WIDTH)``: offset,
# gap and soft depth of springs first.
Histories = dict[PairState, Floats]
# Number of values of a node: with the part of the spring, slip, energy, traction and normal.
WIDTH = 12


class ContactMotion(NamedTuple):
    """Perturbations of positions, or their costates, nodal arrays ``(n, d)``.

    Attributes:
        start: At the start of the step.
        trial: In the trial motion of the search.
        points: At the positions at which points of mortar contact are chosen.
        end: At the end of the step.
        coefficients: Perturbations of coefficients of friction, ``(size,)``, with their controls.
    """

    start: Floats
    trial: Floats
    points: Floats
    end: Floats
    coefficients: Sequence[tuple[ParameterControl, Floats]] = ()

    @property
    def positions(self) -> tuple[Floats, ...]:
        """Perturbations of start, trial, points and end."""
        return self.start, self.trial, self.points, self.end


class _Rows:
    """Linear functions of nodal vectors, one for each of ``m`` rows. Collective.

    Args:
        scatter: Exchange of nodal values.
        dofs: Nodes of the rows, shape ``(m, k)``.
        values: Their coefficients, shape ``(m, 3 k)``.
    """

    def __init__(self, scatter: NodalScatter, dofs: Ints, values: Floats) -> None:
        self._scatter, self._dofs, self._values = scatter, dofs, values

    def of(self, vector: Floats) -> Floats:
        """Values of the functions, ``(m,)``, for a vector at local nodes, ``(l, 3)``. Local."""
        at = vector[self._dofs].reshape(self._values.shape)
        values: Floats = np.einsum("md,md->m", self._values, at)
        return values

    def add_to(self, total: Floats, weights: Floats) -> None:
        """Add the rows times weights ``(m,)`` to a nodal vector of the owned nodes, ``(n, 3)``."""
        rows = weights[:, None] * self._values
        self._scatter.add(total, self._dofs, rows.reshape(*self._dofs.shape, 3))


class _Blocks:
    """Sum of small matrices between nodes. Collective.

    Args:
        scatter: Exchange of nodal values.
        nodes: Nodes of the blocks, shape ``(p, k)``.
        values: Entries, shape ``(p, 3 k, 3 k)``.
    """

    def __init__(self, scatter: NodalScatter, nodes: Ints, values: Floats) -> None:
        self._scatter, self._nodes, self._values = scatter, nodes, values

    def add_product(self, total: Floats, vector: Floats, *, transposed: bool = False) -> None:
        """Add the product with a nodal vector ``(l, 3)`` to a vector of owned nodes, ``(n, 3)``."""
        indices = "pji,pj->pi" if transposed else "pij,pj->pi"
        at = vector[self._nodes].reshape(self._values.shape[:2])
        product = np.einsum(indices, self._values, at)
        self._scatter.add(total, self._nodes, product.reshape(*self._nodes.shape, 3))


class ContactDerivative:
    """Derivatives of the springs of one attempt at a step. Collective, as are its methods.

    Args:
        step: The accepted attempt, before its pairs accept their histories.
        last: Its last evaluation.
        scheme: Kernel of contact.
    """

    def __init__(self, step: ContactStep, last: ContactContribution, scheme: str) -> None:
        assert isinstance(step.normal, PenaltyContact)
        pairs, search = last.pairs, step.search
        node, segment = pairs.node, pairs.segment
        self._scatter = scatter = step.candidates.scatter
        self._node, self._members, self._ends = node, members(step.state), step.state.ends
        exchanged = search.pairing.exchanged(step.x)
        before = exchanged.kinematics(scheme, search.x_n, node, segment, None)
        multipliers = step.normal.lambda_N[node]

        def blocks_of(some: PairKinematics) -> _Blocks:
            return _Blocks(scatter, some.blocks.nodes, some.blocks.tangent(multipliers))

        def gap_of(some: PairKinematics) -> _Rows:
            return _Rows(scatter, some.dofs, some.contact.gradient)

        self._force = _Rows(scatter, pairs.dofs, pairs.contact.force)
        self._end, self._start = blocks_of(pairs), blocks_of(before)
        self._has_start = scheme != "static"
        self._gap, self._gap_n = gap_of(pairs), gap_of(before)
        self._matrix = step.normal.derivatives(pairs).matrix
        approach = np.where(
            search.approach.segment[node] < 0, segment, search.approach.segment[node]
        )
        ends = search.x_n, search.approach.x
        self._approach_n, self._approach = (
            gap_of(search.pairing.kinematics("static", x, node, approach, None)) for x in ends
        )

    def end_product(self, x: Floats, *, transposed: bool = False) -> Floats:
        """Derivative of the force with respect to the end of the step, times a nodal vector.

        Args:
            x: Nodal vector, shape ``(n, d)``.
            transposed: Whether the derivative is transposed.
        """
        at, total = self._at(x), self._zeros(x)
        self._end.add_product(total, at, transposed=transposed)
        first, second = (self._force, self._gap) if transposed else (self._gap, self._force)
        second.add_to(total, self._matrix[:, 0, 1] * first.of(at))
        return of_space(total, x.shape[1])

    def force_by(self, motion: ContactMotion, histories: Histories) -> Floats:
        """Perturbation of the force for a fixed end of the step, ``(n, d)`` [N]."""
        inputs, start = self._inputs(motion, histories), self._at(motion.start)
        inputs[:, 1] = 0.0
        total = self._zeros(motion.start)
        if self._has_start:
            self._start.add_product(total, start)
        self._force.add_to(total, np.einsum("mi,mi->m", self._matrix[:, 0], inputs))
        return of_space(total, motion.start.shape[1])

    def update(self, motion: ContactMotion, histories: Histories) -> None:
        """Replace the perturbations of the histories at the start by those at the end."""
        inputs = self._inputs(motion, histories)
        self._store(np.einsum("moi,mi->mo", self._matrix[:, 1:], inputs), histories)

    def slope(self, shape: tuple[int, int], histories: Histories) -> Floats:
        """Slope of the objective at the end of the step due to the histories, ``(n, d)``.

        Args:
            shape: Shape of the result.
            histories: Costates at the end of the step.
        """
        total = self._zeros(np.empty(shape))
        weights = np.einsum("mo,mo->m", self._matrix[:, 1:, 1], self._of_nodes(histories))
        self._gap.add_to(total, weights)
        return of_space(total, shape[1])

    def adjoint(self, costate: Floats, histories: Histories) -> ContactMotion:
        """Costates of the start of the step and of the trial motion (adjoint of `update`).

        Args:
            costate: Costate of the balance of forces, ``(n, d)``.
            histories: Costates at the end of the step, replaced by those at its start.
        """
        at = self._at(costate)
        outputs = np.column_stack([-self._force.of(at), self._of_nodes(histories)])
        inputs = np.einsum("moi,mo->mi", self._matrix, outputs)
        start, trial = self._zeros(costate), self._zeros(costate)
        if self._has_start:
            self._start.add_product(start, -at, transposed=True)
        self._gap_n.add_to(start, inputs[:, 0])
        self._approach_n.add_to(start, inputs[:, 5])
        self._approach.add_to(trial, -inputs[:, 5])
        self._store(inputs[:, 2:5], histories)
        d = costate.shape[1]
        none = np.zeros_like(costate)
        return ContactMotion(of_space(start, d), of_space(trial, d), none, none)

    def _inputs(self, motion: ContactMotion, histories: Histories) -> Floats:
        """Perturbations of the inputs of `SpringDerivatives`, shape ``(m, 6)``."""
        start, trial, end = map(self._at, (motion.start, motion.trial, motion.end))
        approach = self._approach_n.of(start) - self._approach.of(trial)
        gaps = self._gap_n.of(start), self._gap.of(end)
        return np.column_stack([*gaps, self._of_nodes(histories), approach])

    def _at(self, vector: Floats) -> Floats:
        """Nodal vector of the owned nodes, ``(n, d)``, at the nodes of the map, ``(l, 3)``."""
        return self._scatter.forward(in_space(vector))

    def _zeros(self, vector: Floats) -> Floats:
        return np.zeros((len(vector), 3))

    def _of_nodes(self, histories: Histories) -> Floats:
        """Values of the nodes of the pairs, shape ``(m, 3)``. Local."""
        return of_members(self._members, histories)[self._node, :3]

    def _store(self, values: Floats, histories: Histories) -> None:
        """Replace the values of all nodes: 0 at nodes without a pair. Local."""
        new = np.zeros((self._ends[-1], WIDTH))
        new[self._node, :3] = values
        store(self._members, new, histories)


def of_members(pairs: Sequence[PairState], histories: Histories) -> Floats:
    """Values of the nodes of several pairs, shape ``(n, WIDTH)``. Local."""
    return np.concatenate([histories[pair] for pair in pairs])


def store(pairs: Sequence[PairState], values: Floats, histories: Histories) -> None:
    """Store values of the nodes of several pairs, ``(n, WIDTH)``, pair by pair. Local."""
    first = 0
    for pair in pairs:
        last = first + len(pair.nodes.nodes)
        histories[pair], first = values[first:last], last
